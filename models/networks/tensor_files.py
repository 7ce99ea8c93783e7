"""Writing tensors with a JSON header, whole or not at all: checkpoints and state files of trainings."""

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
    """Write a safetensors file whose metadata holds the header as JSON.

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
        atomic_write_bytes(path, save(on_cpu, metadata={"bendtrack": json.dumps(header)}))
    except (SafetensorError, OSError) as error:
        raise CheckpointError(f"{path}: cannot be written ({reason(error)})") from error
