"""Networks converted to OpenVINO: from images to positions, with `heatmaps.decode` as the last layer.

How engines are built, checked and written is in `export.py`; how they run in `inference/runtime.py`.
"""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor, nn

from ..inference.coarse_to_fine import CoarseToFineEstimator
from ..inference.crops import END_SIDE
from ..inference.runtime import PARTS, OpenVINOEndRegressor, OpenVINOPredictor, load_openvino
from .cascade import Cascade
from .end_regressor import EndRegressionNetwork
from .heatmap_network import HeatmapNetwork, Maps
from .heatmaps import decode


def compiled_networks(
    network: Cascade, candidates: int, workers: int = 1, threads: int = 1
) -> CoarseToFineEstimator:
    """Locator and refiner compiled for the CPU in float32, without files.

    Parameters
    ----------
    network : Cascade
    candidates : int
        As `CoarseToFineEstimator`'s.
    workers, threads : int
        As `OpenVINOPredictor`'s.
    """
    network = network.float().cpu().eval()
    with quiet_converters():
        models = [
            with_decoding(converted(getattr(network, part)), n)
            for part, n in candidates_of_parts(candidates).items()
        ]
    locator, refiner = (OpenVINOPredictor(model, workers, threads) for model in models)
    return CoarseToFineEstimator(locator, refiner, candidates)


def candidates_of_parts(of_locator: int) -> dict[str, int]:
    """Positions per keypoint that each part returns: the locator several, the refiner one."""
    return dict(zip(PARTS, (of_locator, 1), strict=True))


def compiled_end_regressor(
    network: EndRegressionNetwork, workers: int = 1, threads: int = 1
) -> OpenVINOEndRegressor:
    """An end regressor compiled for the CPU, without a file; arguments as `OpenVINOEndRegressor`'s."""
    return OpenVINOEndRegressor(converted_end_regressor(network), network.pairs, workers, threads)


def converted_end_regressor(network: EndRegressionNetwork) -> Any:
    """An end regressor for any number of images."""
    openvino = load_openvino()
    shape = (3, END_SIDE, END_SIDE)
    example = torch.zeros((2, *shape), dtype=torch.uint8)
    with quiet_converters():
        return openvino.convert_model(
            network, example_input=example, input=[openvino.PartialShape([-1, *shape])]
        )


def with_decoding(maps: Any, peaks: int) -> Any:
    """A network from images to positions, `peaks` of them per keypoint."""
    openvino = load_openvino()
    heads = [result.input_value(0) for result in maps.get_results()]
    k = heads[0].get_partial_shape()[1].get_length()
    example = (torch.zeros(2, k, 16, 16), torch.zeros(2, k, 2, 16, 16), torch.zeros(2, k, 3, 16, 16))
    decoding = openvino.convert_model(_Decoding(peaks), example_input=example)
    for parameter, head in zip(decoding.get_parameters(), heads, strict=True):
        parameter.output(0).replace(head)
    return openvino.Model(decoding.get_results(), maps.get_parameters(), "bendtrack")


class _Decoding(nn.Module):
    """From maps to positions: `heatmaps.decode` as a network's last layer."""

    def __init__(self, peaks: int) -> None:
        super().__init__()
        self.peaks = peaks

    def forward(self, heat: Tensor, offset: Tensor, spread: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        found = decode(Maps(heat, offset, spread), self.peaks)
        return found.xy, found.likelihood, found.covariance


class _AsTuple(nn.Module):
    def __init__(self, network: HeatmapNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> tuple[Tensor, ...]:
        return tuple(self.network(images))


def converted(network: HeatmapNetwork) -> Any:
    """A network up to its maps, for images of any size and number."""
    openvino = load_openvino()
    example = torch.zeros((2, 3, 64, 64), dtype=torch.uint8)
    return openvino.convert_model(
        _AsTuple(network), example_input=example, input=[openvino.PartialShape([-1, 3, -1, -1])]
    )


@contextmanager
def quiet_converters() -> Iterator[None]:
    """No output of the converters on the terminal."""
    loggers = [logging.getLogger(name) for name in ("nncf", "torch.utils.cpp_extension")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    try:
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
