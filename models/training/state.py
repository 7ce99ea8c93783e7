"""A training that is not finished, on disk: what is learning, and the schedule. safetensors and JSON."""

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
from safetensors.torch import load_file
from torch import Tensor

from ...tracker.atomic import atomic_write_text
from ...tracker.errors import TrainingError
from ..networks.tensor_files import write_tensors
from .optimisation import NetworkOptimiser
from .schedule import Schedule

STATE_FILE = "training-state.safetensors"

# Raised when the state's contents or the networks' layers change.
FORMAT = 5


@dataclass
class TrainingState:
    """What a training knows besides its learners.

    Attributes
    ----------
    identity : hash of settings and labels; another one cannot be resumed
    step, elapsed_s, schedule : where it stands
    rows : of training.csv
    best, best_step : averaged weights with the lowest held-out error, and when
    targets : (N, K, 2) px, the positions trained on
    start : what the first weights were
    taken : their keypoint for each of ours that they knew
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


def save_state(path: Path, state: TrainingState, learners: Mapping[str, NetworkOptimiser]) -> None:
    """Write a state, whole or not at all."""
    tensors = {f"best.{n}": v for n, v in (state.best or {}).items()}
    for part, learner in learners.items():
        tensors |= {f"{part}.network.{n}": v for n, v in learner.network.state_dict().items()}
        tensors |= {f"{part}.average.{n}": v for n, v in learner.average.state_dict().items()}
        for index, values in learner.optimizer.state_dict()["state"].items():
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


def load_state(path: Path, learners: Mapping[str, NetworkOptimiser], identity: str) -> TrainingState:
    """Read a state, and what the learners had learnt into them.

    Raises
    ------
    TrainingError
        Damaged, or of a training with other settings or labels.
    """
    try:
        with safe_open(path, "pt") as file:
            header: dict[str, Any] = json.loads(file.metadata()["bendtrack"])
        tensors = load_file(path)
    except (SafetensorError, OSError, KeyError, TypeError, ValueError) as error:
        raise TrainingError(f"--resume: expected a training state in {path}, got a damaged file") from error
    if header.get("format") != FORMAT:
        raise TrainingError(
            f"--resume: expected a training state of format {FORMAT}, got {header.get('format')},"
            " of another version of bendtrack; train again without --resume"
        )
    if header["identity"] != identity:
        raise TrainingError(
            "--resume: expected the settings and labels that the training was started with, got others;"
            " train again without --resume"
        )
    for part, learner in learners.items():
        own = _under(f"{part}.", tensors)
        learner.network.load_state_dict(_under("network.", own))
        learner.average.load_state_dict(_under("average.", own))
        moments: dict[int, dict[str, Tensor]] = {}
        weights = list(learner.network.parameters())
        for name, value in _under("optimizer.", own).items():
            index, key = name.split(".", 1)
            weight = weights[int(index)]
            # In the order in which its weight lies in memory: a step in one pass takes both as they lie.
            laid_out = torch.empty_like(weight).copy_(value) if value.shape == weight.shape else value
            moments.setdefault(int(index), {})[key] = laid_out
        learner.optimizer.load_state_dict({**learner.optimizer.state_dict(), "state": moments})
    return TrainingState(
        identity=identity,
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
    """Write training.csv into a training's folder, whole or not at all."""
    lines = [",".join(rows[0]), *(",".join(str(value) for value in row.values()) for row in rows)]
    atomic_write_text(folder / "training.csv", "\n".join(lines) + "\n")


def _under(prefix: str, tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    return {n.removeprefix(prefix): v for n, v in tensors.items() if n.startswith(prefix)}
