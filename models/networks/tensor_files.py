"""Tensors with a JSON header and a checksum over both: checkpoints and state files of trainings.

Written whole or not at all, and read only if they are what was written. The checksum is in `inference.checksum`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor

from ...tracker.atomic import atomic_write_bytes
from ...tracker.errors import CheckpointError, reason
from ..inference.checksum import HEADER, check_checksum, with_checksum, with_place_for_checksum


def write_tensors(path: Path, tensors: Mapping[str, Tensor], header: Mapping[str, Any]) -> None:
    """Write a safetensors file whose metadata holds the header as JSON, and in it the file's checksum.

    Parameters
    ----------
    path : Path
    tensors : mapping from str to tensor
    header : mapping
        JSON-ready.

    Raises
    ------
    CheckpointError
        The file cannot be written, for example on a full disk.
    """
    on_cpu = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    try:
        # safetensors' own `save_file` writes files that only their owner can read.
        data = save(on_cpu, metadata={HEADER: with_place_for_checksum(dict(header))})
        atomic_write_bytes(path, with_checksum(data))
    except (SafetensorError, OSError) as error:
        raise CheckpointError(f"{path}: cannot be written ({reason(error)})") from error


def read_tensors(path: Path) -> dict[str, Tensor]:
    """Read the tensors of a file that `write_tensors` wrote, once its checksum is found to be right.

    Parameters
    ----------
    path : Path

    Returns
    -------
    dict from str to tensor

    Raises
    ------
    DamagedFileError
        The file is not what was written.
    SafetensorError, OSError
        It cannot be read.
    """
    check_checksum(path)
    return load_file(path)
