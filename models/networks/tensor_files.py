"""Writing tensors with a JSON header, whole or not at all: checkpoints and trainings that are not finished."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import save
from torch import Tensor

from ...tracker.atomic import atomic_write_bytes
from ...tracker.errors import CheckpointError, reason


def write_tensors(path: Path, tensors: Mapping[str, Tensor], header: Mapping[str, Any]) -> None:
    """Write a safetensors file whose metadata holds the header.

    Raises
    ------
    CheckpointError
        The file cannot be written; the library has an error of its own for a full disk.
    """
    own = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    try:
        # The library's own writing of files keeps them from everyone else who uses the folder.
        atomic_write_bytes(path, save(own, metadata={"bendtrack": json.dumps(header)}))
    except (SafetensorError, OSError) as error:
        raise CheckpointError(f"{path}: cannot be written ({reason(error)})") from error
