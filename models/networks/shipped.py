"""The networks that come with bendtrack: pretrained on rendered actuators, what `train` starts from and `angle` looks
with. How they were made is in `weights/README.md`; knows nothing of torch.
"""

from __future__ import annotations

import shutil
from pathlib import Path

from platformdirs import user_cache_path

from ...tracker.atomic import atomic_path
from ...tracker.errors import BendtrackError, WeightsError, reason
from ...tracker.hashing import file_sha256
from ..inference.metadata import WEIGHTS_FILE

WEIGHTS = Path(__file__).parent.parent / "weights"


def actuator_file(backbone: str) -> Path:
    """Where the network with this backbone lies that comes with bendtrack, present or not."""
    return WEIGHTS / f"actuator-{backbone}" / WEIGHTS_FILE


def shipped_network(backbone: str) -> Path:
    """`actuator_file` of a backbone for which there is one.

    Raises
    ------
    WeightsError
        There is none.
    """
    file = actuator_file(backbone)
    if not file.is_file():
        there = ", ".join(sorted(path.name.removeprefix("actuator-") for path in WEIGHTS.glob("actuator-*")))
        raise WeightsError(
            f"actuator weights: expected a backbone that they come with ({there or 'none'}), got {backbone};"
            " `bendtrack pretrain` makes others"
        )
    return file


def working_copy(backbone: str) -> Path:
    """A copy of the shipped network in the user's cache folder, where engines can be compiled beside it.

    The package itself may not be writable, or be shared by machines with other processors.

    Returns
    -------
    The copy's folder.

    Raises
    ------
    WeightsError
        There is no such network.
    BendtrackError
        The cache folder cannot be written.
    """
    file = shipped_network(backbone)
    folder = user_cache_path("bendtrack") / file_sha256(file)[:16] / file.parent.name
    if not (folder / WEIGHTS_FILE).is_file():
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with atomic_path(folder / WEIGHTS_FILE) as copy:
                shutil.copyfile(file, copy)
        except OSError as error:
            raise BendtrackError(
                f"expected a cache folder that can be written, got {folder} ({reason(error)}); XDG_CACHE_HOME names"
                " another"
            ) from error
    return folder
