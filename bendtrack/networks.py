"""A trained network made ready to track with: compiled first where that was not done yet, then loaded.

Which network of a project is meant is in `model_folders.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from .reporting import SILENT, Reporter
from .tracker.errors import BendtrackError, MissingPackageError
from .tracker.extras import training_packages_needed
from .tracker.video import video_stem

if TYPE_CHECKING:
    from .models.detector import NetworkDetector
    from .models.inference.runtime import EngineError
    from .tracker.angle import AngleDefinition
    from .tracker.project import Project as ProjectFolder
    from .tracker.types import Detector, Frames


def load_network(
    folder: Path,
    engine: str = "auto",
    device: str = "auto",
    threads: int | None = None,
    *,
    low_latency: bool = False,
    self_training: bool = True,
    reporter: Reporter = SILENT,
) -> NetworkDetector:
    """Load a network, compiled for this machine.

    Parameters
    ----------
    folder : Path
        The checkpoint's file or folder. The compiled network is written next to it, once.
    engine : str
        "auto", "openvino-int8", "openvino" or "torch". "auto" takes the fastest that is exact.
    device : str
        "auto", "cpu" or "cuda". "auto" takes a GPU where there is one.
    threads : int or None
        Cores for the network; None takes all.
    low_latency : bool
        Whether all cores work on one frame (low latency) instead of each on one of its own (more frames a second).
    self_training : bool
        Whether a pretrained network may adapt to an actuator that nobody has labelled.
    reporter : Reporter
        Is told of the compilation.

    Returns
    -------
    NetworkDetector
        A `Detector` for `tracker.tracking.track`.

    Raises
    ------
    BendtrackError
        An engine or a device that is not known.
    CheckpointError
        The checkpoint cannot be read, or the engine or the device asked for is not there.
    MissingPackageError
        The network is not compiled for this machine, and torch, which that needs, is not installed.
    """
    from .models.detector import CHOICES, DEVICES, NetworkDetector
    from .models.inference.metadata import read_metadata, weights_file
    from .models.inference.runtime import EngineError
    from .models.inference.stages import StageSettings

    for option, value, choices in (("--engine", engine, CHOICES), ("--device", device, DEVICES)):
        if value not in choices:
            raise BendtrackError(f"{option}: expected {', '.join(choices)}, got '{value}'")
    file = weights_file(folder)
    read_metadata(file)  # a file that is no network is not compiled

    def load(require_compiled: bool) -> NetworkDetector:
        with training_packages_needed(f"'{folder.name}' with engine torch"):
            return NetworkDetector.load(
                folder,
                engine=engine,
                device=device,
                threads=threads,
                low_latency=low_latency,
                stages=StageSettings(self_training=self_training),
                require_compiled=require_compiled,
            )

    try:
        return load(require_compiled=True)
    except EngineError as error:
        compiled = _compile(folder, reporter, error)
    # What was compiled just now is whole; what could not be compiled is done by torch, and was said.
    return load(require_compiled=compiled)


def measured_angle(
    project: ProjectFolder, network: NetworkDetector, reporter: Reporter = SILENT
) -> AngleDefinition:
    """Say which angle a network measures: the one that it was trained for.

    Parameters
    ----------
    project : tracker.project.Project
        The project whose settings may name another angle.
    network : NetworkDetector
        The network.
    reporter : Reporter
        Is warned where the two differ.

    Returns
    -------
    AngleDefinition
        The network's own.
    """
    definition = network.metadata.definition
    angle = project.settings.angle_definition(definition.sign)
    signs = {"auto": definition.sign, "+": 1, "-": -1}
    if angle != definition or signs[project.settings.angle.sign] != definition.sign:
        reporter.warn(
            f"bendtrack.toml names another angle than '{network.name}' was trained for, which is measured"
            f" ({definition.name}, {', '.join(definition.points)}, sign {definition.sign:+d});"
            " train again for the new one"
        )
    return definition


def sign_for(project: ProjectFolder, network: NetworkDetector, video: Path) -> int:
    """Give the sign of the angle in a video: its actuator's, as it was when the network was trained.

    Parameters
    ----------
    project : tracker.project.Project
        Which knows the actuator of each video.
    network : NetworkDetector
        The network.
    video : Path
        The video file.

    Returns
    -------
    int
        +1 or -1; the network's own for an actuator that it was not trained on.
    """
    signs = network.metadata.training.get("signs")
    own = signs.get(project.actuator_of(video_stem(video))) if isinstance(signs, dict) else None
    return own if own in (1, -1) else network.metadata.definition.sign


class Localizer:
    """Finds the actuator in a video that nobody has labelled (`tracker.batch.Localize`).

    Parameters
    ----------
    network : NetworkDetector
        A network that knows actuators in general.
    """

    def __init__(self, network: NetworkDetector) -> None:
        self._network = network

    def __call__(
        self, probe_frames: Frames, progress: Callable[[int, int | None], None]
    ) -> tuple[Detector, AngleDefinition]:
        """Give the network for this video, and the angle to measure.

        Parameters
        ----------
        probe_frames : (N, H, W, 3) uint8 RGB
            Frames spread over the video.
        progress : callable
            Called with the number of steps done and to be done, where the network adapts to this actuator first.

        Raises
        ------
        VideoError
            No actuator can be seen.
        MissingPackageError
            A pretrained network needs torch for this.
        """
        with training_packages_needed("measuring without labels"):
            own = self._network.for_video(probe_frames, progress)
        return own, own.metadata.definition


def _compile(folder: Path, reporter: Reporter, why: EngineError) -> bool:
    """Build the fast engines of a network next to it; False where that fails, which is said."""
    from .models.inference.checksum import DamagedFileError, check_checksum
    from .models.inference.metadata import weights_file
    from .models.inference.runtime import built_from
    from .tracker.hashing import file_sha256

    file = weights_file(folder)
    # A damaged network would be compiled like any other.
    if not check_checksum(file) and built_from(file) not in (None, file_sha256(file)):
        reporter.warn(
            f"{file}: not the file that was compiled before, and from a version of bendtrack that recorded no"
            " checksum: it may be damaged; train again if you did not replace it"
        )
    if why.damaged:
        reporter.warn(f"{why}; it is compiled again")
    with training_packages_needed(f"'{folder.name}' is not compiled for this machine yet, which"):
        from .models.export import build_beside

    reporter.say(f"Compiling '{folder.name}' for the CPU (once)")
    try:
        record = build_beside(folder)
    except (MissingPackageError, DamagedFileError):
        raise
    except (BendtrackError, OSError) as error:
        reporter.warn(f"'{folder.name}' could not be compiled and will be slower: {error}")
        return False
    for name, check in record.engines.items():
        drift = f"{name}: {check.drift_px:.3f} px and {check.drift_deg:.3f}° from float32"
        reporter.detail(drift if check.passed else f"{drift}: refused")
    for name, reason in record.skipped.items():
        reporter.say(f"{name} is not built: {reason}")
    return True
