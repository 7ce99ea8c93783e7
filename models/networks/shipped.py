"""The shipped networks, pretrained on rendered actuators: `train` starts from one, and `angle` uses it without labels.

Only their files; no torch here. How they were made is in `weights/README.md`.
"""

from __future__ import annotations

import shutil
from pathlib import Path

from platformdirs import user_cache_path

from ...tracker.atomic import atomic_path
from ...tracker.errors import BendtrackError, WeightsError, reason
from ...tracker.hashing import file_sha256
from ..inference.checksum import check_checksum
from ..inference.metadata import WEIGHTS_FILE

WEIGHTS = Path(__file__).parent.parent / "weights"


def actuator_file(backbone: str) -> Path:
    """Path of the shipped network with this backbone, whether there is one or not."""
    return WEIGHTS / f"actuator-{backbone}" / WEIGHTS_FILE


def shipped_network(backbone: str) -> Path:
    """Path of the shipped network with this backbone.

    Raises
    ------
    WeightsError
        None is shipped.
    """
    file = actuator_file(backbone)
    if not file.is_file():
        shipped = ", ".join(
            sorted(path.name.removeprefix("actuator-") for path in WEIGHTS.glob("actuator-*"))
        )
        raise WeightsError(
            f"actuator weights: expected a backbone that they come with ({shipped or 'none'}), got {backbone};"
            " `bendtrack pretrain` makes others"
        )
    return file


def working_copy(backbone: str) -> Path:
    """Copy a shipped network into the user's cache folder, where engines can be compiled next to it.

    The package itself may not be writable, or be shared by machines with other processors.

    Parameters
    ----------
    backbone : str

    Returns
    -------
    Path
        The copy's folder.

    Raises
    ------
    WeightsError
        No network with this backbone is shipped.
    DamagedFileError
        The shipped file is damaged.
    BendtrackError
        The cache folder cannot be written.

    Notes
    -----
    A copy that is damaged is replaced.
    """
    file = shipped_network(backbone)
    sha256 = file_sha256(file)
    folder = user_cache_path("bendtrack") / sha256[:16] / file.parent.name
    copy = folder / WEIGHTS_FILE
    if not copy.is_file() or file_sha256(copy) != sha256:
        check_checksum(file)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with atomic_path(copy) as temporary:
                shutil.copyfile(file, temporary)
        except OSError as error:
            raise BendtrackError(
                f"expected a cache folder that can be written, got {folder} ({reason(error)}); XDG_CACHE_HOME names"
                " another"
            ) from error
    return folder
