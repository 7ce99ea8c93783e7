"""A project as a Python program works with it: frames, labels, network, angles.

What it does is done by the rooms: `labeling` for frames and labels, `training.py` for networks, `tracker.batch` for
videos. The folder itself, and what bendtrack.toml may say, is `tracker.project`.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from . import model_folders, training
from .measuring import network_line
from .networks import load_network, measured_angle, sign_for
from .reporting import SILENT, Reporter
from .tracker.batch import Batch, VideoOutcome, check_writable, listed_videos, track_batch, unreadable
from .tracker.errors import BendtrackWarning, VideoError
from .tracker.project import Project as ProjectFolder

if TYPE_CHECKING:
    from .labeling.frame_extraction import ExtractionReport
    from .labeling.interop.exporting import ExportReport
    from .labeling.interop.importing import ImportReport
    from .models.evaluation import Evaluation
    from .tracker.project_settings import ProjectSettings
    from .tracker.results import AngleTable
    from .tracker.types import LabelledFrame
    from .training import TrainedNetwork

KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")
"""Two points on the fixed end, two on the moving end: the least that a two-vector angle needs."""


def new_project(
    path: str | Path, *, keypoints: Sequence[str] = KEYPOINTS, angle: str | None = None
) -> Project:
    """Make a new project in a folder that does not exist or is empty.

    Parameters
    ----------
    path : str or Path
        The project's folder.
    keypoints : sequence of str
        Names of the points to label, from the fixed end to the moving end.
    angle : str or None
        "two-vector", "three-point", "chord" or "arc-fit"; None takes two-vector, or three-point for three keypoints.

    Returns
    -------
    Project
        The new project.

    Raises
    ------
    ProjectError
        The folder has something in it, or keypoints and angle do not fit.

    Examples
    --------
    >>> import bendtrack as bt
    >>> project = bt.new_project("my-study")  # doctest: +SKIP
    """
    return Project(ProjectFolder.create(path, keypoints=keypoints, angle=angle))


def open_project(path: str | Path) -> Project:
    """Open a project.

    Parameters
    ----------
    path : str or Path
        The project's folder, with bendtrack.toml in it.

    Returns
    -------
    Project
        The project.

    Raises
    ------
    ProjectError
        Not a project, or a mistake in its bendtrack.toml.

    Examples
    --------
    >>> import bendtrack as bt
    >>> table = bt.open_project("my-study").track("a.mp4")  # doctest: +SKIP
    """
    return Project(ProjectFolder.open(path))


class Project:
    """A project: videos are labelled, a network is trained, and tracks them. `open_project` and `new_project` give one.

    Parameters
    ----------
    folder : tracker.project.Project
        The folder on disk.
    reporter : Reporter
        Is told what goes on; the default is silent.
    """

    def __init__(self, folder: ProjectFolder, reporter: Reporter = SILENT) -> None:
        self.folder = folder
        self._reporter = reporter

    def __repr__(self) -> str:
        return f"<bendtrack project {str(self.path)!r}>"

    @property
    def path(self) -> Path:
        """The project's folder."""
        return self.folder.root

    @property
    def settings(self) -> ProjectSettings:
        """What bendtrack.toml says, validated."""
        return self.folder.settings

    @property
    def keypoints(self) -> tuple[str, ...]:
        """Names of the K keypoints, in the order of every array."""
        return self.folder.keypoints

    @property
    def labels(self) -> list[LabelledFrame]:
        """All labelled frames, read anew: pictures, and points `xy` (K, 2) px, NaN where not labelled."""
        from .labeling.store import LabelStore

        return LabelStore.of(self.folder).read()

    @property
    def models(self) -> list[str]:
        """Names of the trained networks, the newest last."""
        return [path.name for path in model_folders.finished(self.folder)]

    def add_frames(
        self,
        videos: str | Path | Sequence[str | Path],
        *,
        count: int = 30,
        by: str | None = None,
        pressure: Sequence[str | Path] = (),
        actuator: str | None = None,
    ) -> ExtractionReport:
        """Choose frames to label that span the whole range of motion, and save them as pictures in labeled-data/.

        Parameters
        ----------
        videos : str, Path or sequence of them
            Files, folders of videos, or patterns such as ``day1/*.mp4``.
        count : int
            New pictures of each actuator, over all its videos.
        by : str or None
            What they are spread over: "pressure", "appearance" or "time". None takes pressure where there are logs,
            else appearance.
        pressure : sequence of str or Path
            Pressure logs on the videos' clock: one for each video, in their order, or one folder in which a log has
            its video's name.
        actuator : str or None
            The actuator that the videos show; None leaves what bendtrack.toml says.

        Returns
        -------
        ExtractionReport
            New pictures of each video, what failed, what is worth a look.

        Raises
        ------
        VideoError
            Nothing is there. A video that cannot be read is in the report's `failed`.
        LabelError
            `count` or `by` cannot be, or logs do not fit the videos.
        PressureLogError
            A log cannot be read.
        """
        from .labeling.frame_extraction import extract_frames
        from .labeling.video_scan import SampleBy

        return extract_frames(
            self.folder,
            listed_videos(_several(videos)),
            count=count,
            by=None if by is None else SampleBy(by),
            pressure_logs=pressure,
            actuator=actuator,
            counting=self._reporter.counting,
        )

    def import_labels(
        self,
        source: str | Path,
        *,
        format: str | None = None,
        images: str | Path | None = None,
        videos: Sequence[str | Path] = (),
        overwrite: bool = False,
    ) -> ImportReport:
        """Take over the labels of DeepLabCut, COCO, SLEAP or Lightning Pose.

        Parameters
        ----------
        source : str or Path
            A project, a folder with labeled-data/, or a label file.
        format : str or None
            "dlc", "coco", "sleap" or "lightning-pose"; None recognises it.
        images : str, Path or None
            Folder of the pictures that the labels name; None looks next to the labels.
        videos : sequence of str or Path
            Videos to take pictures from that the source lacks.
        overwrite : bool
            Whether the source counts where both label a frame.

        Returns
        -------
        ImportReport
            How many frames, and what was left out.

        Raises
        ------
        LabelError
            The source cannot be read.
        """
        from .labeling.interop.formats import open_labels
        from .labeling.interop.importing import import_source

        found = open_labels(source, format, images)
        return import_source(found, self.folder, videos=videos, overwrite=overwrite)

    def export(
        self, out: str | Path, *, format: str | None = None, videos: Sequence[str | Path] = ()
    ) -> ExportReport:
        """Write the labels in the format of DeepLabCut, COCO, SLEAP or Lightning Pose.

        Parameters
        ----------
        out : str or Path
            A folder that is new or empty; for SLEAP a new .slp file.
        format : str or None
            "dlc", "coco", "sleap" or "lightning-pose"; None takes sleap for a name that ends in .slp, else dlc.
        videos : sequence of str or Path
            Video files that the export may name.

        Returns
        -------
        ExportReport
            How many frames and pictures.

        Raises
        ------
        LabelError
            Nothing to export, or `out` is there already.
        OSError
            `out` cannot be written.
        """
        from .labeling.interop.formats import export_labels

        return export_labels(self.folder, out, format, videos=videos)

    def train(
        self,
        name: str | None = None,
        *,
        backbone: str | None = None,
        init: str | None = None,
        max_minutes: float | None = None,
        seed: int | None = None,
        held_out: float | None = None,
        resume: bool = False,
        overwrite: bool = False,
        started_s: float | None = None,
    ) -> TrainedNetwork:
        """Train a network on the labels, judge it on the frames held out, and write all of it into models/<name>/.

        Ctrl-C saves where it stands; `resume` goes on from there.

        Parameters
        ----------
        name : str or None
            Of the network; None takes the first of model, model-2, ... that is free, or the latest to resume.
        backbone : str or None
            "resnet18", "resnet34" or "resnet50".
        init : str or None
            What it starts from: "auto", "actuator" (the network that comes with bendtrack), "imagenet", "random", or a
            weights file.
        max_minutes : float or None
            All of it ends within so many minutes, judging and figures included.
        seed : int or None
            Everything random follows from it.
        held_out : float or None
            Share of the frames that is not trained on but judged.
        resume : bool
            Whether to go on with a training that was stopped.
        overwrite : bool
            Whether a network of this name may be replaced.
        started_s : float or None
            `time.monotonic()` from which `max_minutes` count; None begins now.

        Returns
        -------
        TrainedNetwork
            Its folder, and its errors on the frames held out.

        Raises
        ------
        LabelError
            There are no labels.
        TrainingError
            The name is taken, nothing is there to resume, or the loss is not finite.
        WeightsError
            The starting weights cannot be had.
        StoppedTraining
            Ctrl-C (a KeyboardInterrupt).

        Notes
        -----
        What is None is taken from [training] in bendtrack.toml, or else has the default of `models.TrainingSettings`.
        """
        options = {
            "backbone": backbone,
            "init": init,
            "max_minutes": max_minutes,
            "seed": seed,
            "held_out": held_out,
        }
        given = {key: value for key, value in options.items() if value is not None}
        if resume:
            folder = model_folders.folder_to_resume(self.folder, name)
            settings = training.stored_settings(folder, given)
        else:
            settings = training.planned_settings(self.folder, given)
            if name is None:
                for stopped in model_folders.unfinished(self.folder):
                    self._reporter.warn(
                        f"'{stopped.name}' is being trained by another process"
                        if model_folders.in_use(stopped)
                        else f"'{stopped.name}' is a training that was stopped; --resume goes on with it"
                    )
            folder = model_folders.new_folder(self.folder, name, overwrite)
        return training.train_network(
            self.folder, folder, settings, resume=resume, started_s=started_s, reporter=self._reporter
        )

    def evaluate(self, model: str | None = None, *, folds: int | None = None) -> Evaluation:
        """Judge a network on labels that it was not trained on; write evaluation.json and figures.

        Parameters
        ----------
        model : str or None
            Name of the network; None takes the newest.
        folds : int or None
            Cross-validation: so many networks are trained, each judged on what it has not seen.

        Returns
        -------
        Evaluation
            `error_px` (N, K) px and `angle_error_deg` (N,) degrees of N frames; `summary()` puts them together.

        Raises
        ------
        CheckpointError
            There is no such network.
        LabelError
            There are no labels that it was not trained on.
        """
        training.refuse_both(model, folds)
        if folds is not None:
            return training.cross_validated(self.folder, folds, self._reporter)
        return training.evaluate_network(
            self.folder, model_folders.chosen(self.folder, model, self._reporter), self._reporter
        )

    @overload
    def track(self, videos: str | Path, **options: Any) -> AngleTable: ...

    @overload
    def track(self, videos: Sequence[str | Path], **options: Any) -> list[AngleTable]: ...

    def track(
        self, videos: str | Path | Sequence[str | Path], **options: Any
    ) -> AngleTable | list[AngleTable]:
        """Measure the bending angle over time, and write tables and figures into results/.

        A video is skipped that is up to date: same video, network and settings. Its table is read from disk.

        Parameters
        ----------
        videos : str, Path or sequence of them
            One video file; or several files, folders of videos and patterns.
        **options : object
            As `track_each`'s.

        Returns
        -------
        AngleTable or list of AngleTable
            One table for one video file, a list for several.

        Raises
        ------
        CheckpointError
            There is no such network.
        VideoError
            A video cannot be read; raised when all the others are done. One that is damaged is tracked as far as it
            goes, with a `BendtrackWarning`.

        Examples
        --------
        >>> import bendtrack as bt
        >>> table = bt.open_project("my-study").track("a.mp4")  # doctest: +SKIP
        >>> table.time_s, table.angle_deg, table.angle_sd_deg  # doctest: +SKIP
        """
        outcomes = list(self.track_each(_several(videos), **options))
        for outcome in outcomes:
            for warning in outcome.warnings:
                self._reporter.warn(warning)
            if outcome.problem is not None and outcome.table is not None:
                warnings.warn(f"{outcome.video}: {outcome.problem}", BendtrackWarning, stacklevel=2)
        failed = [f"{outcome.video}: {outcome.problem}" for outcome in outcomes if outcome.table is None]
        if failed:
            raise VideoError("; ".join(failed))
        tables = [outcome.table for outcome in outcomes if outcome.table is not None]
        if isinstance(videos, str | Path) and len(tables) == 1 and not Path(videos).is_dir():
            return tables[0]
        return tables

    def track_each(
        self,
        videos: Sequence[str | Path],
        *,
        model: str | None = None,
        out: Path | None = None,
        overlay: bool = False,
        force: bool = False,
        engine: str = "auto",
        device: str = "auto",
        threads: int | None = None,
    ) -> Iterator[VideoOutcome]:
        """Track videos one after the other, as `track` does, and tell of each as soon as it is done.

        Parameters
        ----------
        videos : sequence of str or Path
            Files, folders of videos, or patterns.
        model : str or None
            Name of the network; None takes the newest.
        out : Path or None
            Folder of the results; None is the project's results/.
        overlay : bool
            Whether a video is written too with what was found drawn on it (`<video>.overlay.mp4`).
        force : bool
            Whether videos are tracked again that are up to date.
        engine, device, threads
            As `measuring.measure`'s.

        Yields
        ------
        VideoOutcome
            Table, files, warnings and problem of each video in order.

        Raises
        ------
        CheckpointError
            There is no such network.
        VideoError
            Nothing is where a video is expected.
        """
        paths = listed_videos(videos)
        folder = out or self.folder.results_dir
        check_writable(folder)
        chosen = model_folders.chosen(self.folder, model, self._reporter)
        if failed := unreadable(paths):  # before seconds go into loading and compiling
            yield from failed
            return
        network = load_network(chosen, engine, device, threads, reporter=self._reporter)
        batch = Batch(
            network,
            measured_angle(self.folder, network, self._reporter),
            folder,
            min_likelihood=self.settings.tracking.min_likelihood,
            overlay=overlay,
            force=force,
            counting=self._reporter.counting,
            sign_of=partial(sign_for, self.folder, network) if self.settings.angle.sign == "auto" else None,
        )
        self._reporter.say(network_line(network))
        yield from track_batch(batch, paths)


def _several(videos: str | Path | Sequence[str | Path]) -> list[str | Path]:
    return [videos] if isinstance(videos, str | Path) else list(videos)
