"""The state file of an unfinished training: weights, optimisers and schedule, in safetensors with a JSON header.

What a state means is known to `trainer` and to `pretraining.pretrainer`; here it is written and read.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from torch import Tensor

from ...tracker.atomic import atomic_write_text
from ...tracker.errors import CheckpointError, TrainingError
from ..networks.tensor_files import read_tensors, write_tensors
from .optimisation import NetworkOptimiser
from .schedule import Schedule

STATE_FILE = "training-state.safetensors"

FORMAT = 5
"""Raised when the state's contents or the networks' layers change."""


@dataclass
class TrainingState:
    """Everything of a training that changes, besides weights and optimisers.

    Attributes
    ----------
    identity : str
        Hash of settings and labels; a training with another one cannot be resumed from this state.
    step : int
        Steps taken.
    elapsed_s : float
        Seconds that they took.
    schedule : Schedule
    rows : list of dict
        Rows of training.csv.
    best : dict from str to tensor, or None
        Averaged weights with the lowest held-out error.
    best_step : int
        The step after which they were saved.
    targets : (N, K, 2) float array
        Positions trained on, px.
    start : str
        The initial weights, from `initialisation.resolve_init`.
    mapping : dict from str to str
        Their keypoint for each of ours that they knew.
    """

    identity: str
    step: int
    elapsed_s: float
    schedule: Schedule
    rows: list[dict[str, float]]
    best: dict[str, Tensor] | None
    best_step: int
    targets: NDArray[np.float64]
    start: str
    mapping: dict[str, str]


def save_state(path: Path, state: TrainingState, optimisers: Mapping[str, NetworkOptimiser]) -> None:
    """Write a state file, whole or not at all.

    Parameters
    ----------
    path : Path
    state : TrainingState
    optimisers : mapping from str to NetworkOptimiser
        Each network with its optimiser, by its name in a cascade.

    Raises
    ------
    CheckpointError
        The file cannot be written.
    """
    tensors = {f"best.{n}": v for n, v in (state.best or {}).items()}
    for part, optimiser in optimisers.items():
        tensors |= {f"{part}.network.{n}": v for n, v in optimiser.network.state_dict().items()}
        tensors |= {f"{part}.average.{n}": v for n, v in optimiser.average.state_dict().items()}
        for index, values in optimiser.optimizer.state_dict()["state"].items():
            tensors |= {f"{part}.optimizer.{index}.{n}": torch.as_tensor(v) for n, v in values.items()}
    tensors["targets"] = torch.from_numpy(state.targets)
    header = {
        "format": FORMAT,
        "identity": state.identity,
        "step": state.step,
        "elapsed_s": state.elapsed_s,
        "schedule": asdict(state.schedule),
        "rows": state.rows,
        "best_step": state.best_step,
        "start": state.start,
        "taken": state.mapping,
    }
    write_tensors(path, tensors, header)


def load_state(path: Path, optimisers: Mapping[str, NetworkOptimiser], identity: str) -> TrainingState:
    """Read a state file, and load its weights and moments into the networks and optimisers.

    Parameters
    ----------
    path : Path
    optimisers : mapping from str to NetworkOptimiser
        Each network with its optimiser, by its name in a cascade; loaded in place.
    identity : str
        Of the training that is resumed.

    Returns
    -------
    TrainingState

    Raises
    ------
    TrainingError
        The file is damaged, or of a training with other settings or labels.
    """
    try:
        with safe_open(path, "pt") as file:
            header: dict[str, Any] = json.loads(file.metadata()["bendtrack"])
        tensors = read_tensors(path)
    except (CheckpointError, SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
        raise TrainingError(
            f"--resume: expected a training state in {path}, got a damaged file; train again without --resume"
        ) from error
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        found = header.get("format") if isinstance(header, dict) else None
        raise TrainingError(
            f"--resume: expected a training state of format {FORMAT}, got {found},"
            " of another version of bendtrack; train again without --resume"
        )
    if header.get("identity") != identity:
        raise TrainingError(
            "--resume: expected the settings and labels that the training was started with, got others;"
            " train again without --resume"
        )
    try:
        return _loaded(header, tensors, optimisers)
    except (RuntimeError, LookupError, TypeError, ValueError) as error:
        raise TrainingError(
            f"--resume: expected a training state in {path}, got one whose contents do not fit this network;"
            " train again without --resume"
        ) from error


def _loaded(
    header: Mapping[str, Any], tensors: dict[str, Tensor], optimisers: Mapping[str, NetworkOptimiser]
) -> TrainingState:
    """Load weights and moments into the networks and optimisers, and give the rest."""
    for part, optimiser in optimisers.items():
        own = _under(f"{part}.", tensors)
        optimiser.network.load_state_dict(_under("network.", own))
        optimiser.average.load_state_dict(_under("average.", own))
        moments: dict[int, dict[str, Tensor]] = {}
        weights = list(optimiser.network.parameters())
        for name, value in _under("optimizer.", own).items():
            index, key = name.split(".", 1)
            weight = weights[int(index)]
            # In its weight's memory format: the fused step reads both in the order in which they lie in memory.
            laid_out = torch.empty_like(weight).copy_(value) if value.shape == weight.shape else value
            moments.setdefault(int(index), {})[key] = laid_out
        optimiser.optimizer.load_state_dict({**optimiser.optimizer.state_dict(), "state": moments})
    return TrainingState(
        identity=header["identity"],
        step=header["step"],
        elapsed_s=header["elapsed_s"],
        schedule=Schedule(**header["schedule"]),
        rows=header["rows"],
        best=_under("best.", tensors) or None,
        best_step=header["best_step"],
        start=header["start"],
        mapping=header["taken"],
        targets=tensors["targets"].numpy(),
    )


def write_rows(folder: Path, rows: Sequence[Mapping[str, float]]) -> None:
    """Write training.csv into a folder, whole or not at all; `rows` is not empty."""
    lines = [",".join(rows[0]), *(",".join(str(value) for value in row.values()) for row in rows)]
    atomic_write_text(folder / "training.csv", "\n".join(lines) + "\n")


def _under(prefix: str, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """The tensors whose names begin with a prefix, without it."""
    return {n.removeprefix(prefix): v for n, v in tensors.items() if n.startswith(prefix)}
