"""The words that all parts share: frozen dataclasses of arrays, flags, and the Detector protocol.

Glossary (holds everywhere in bendtrack; a docstring only says where it differs)

image       RGB uint8 (H, W, 3), as displayed: the container's rotation is already applied.
position    float px, (x, y), x right, y down. (0, 0) is the *centre* of the top-left pixel, always of
            the full decoded frame, whatever was cropped or resized inside.
K, T, N     number of keypoints (in the project's order), of frames of a video, of frames of a batch.
time_s      seconds from the first frame's presentation time; never frame / fps.
angle_deg   degrees; sign and definition in `angle.py`. pressure_kpa: kPa.
likelihood  in [0, 1].
covariance  px^2, (..., 2, 2), of a position.
missing     NaN, and a `Flag` that says why.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating[Any]]
ImageArray = NDArray[np.uint8]
IntArray = NDArray[np.int_]
BoolArray = NDArray[np.bool_]

Frames = Sequence[ImageArray] | ImageArray
"""RGB frames of one size, N of (H, W, 3) uint8, apart or as one array."""


class Flag(StrEnum):
    """Why a row of an angle table is missing or to be doubted. One flag a row, the first that applies.

    NONE                the row is sound (an empty cell in the table)
    PASSED_OVER         live only: dropped, a newer frame was there already: everything but its time is NaN
    UNDECODABLE         the frame could not be decoded: everything but its time is NaN
    COINCIDENT_POINTS   two neighbouring points of the angle's chain fall together: the angle is NaN
    OUT_OF_FRAME        a keypoint of the angle lies outside the frame: positions kept, angle NaN
    DAMAGED             decoded with an error, or from a frame that is missing or not sound; or its picture does not
                        fit those before and after, or its time is not in order: all values kept
    LOW_LIKELIHOOD      a keypoint of the angle has a likelihood under the threshold: all values kept
    JUMP                without labels only: the frames before and after have another angle: all values kept
    """

    NONE = ""
    PASSED_OVER = "passed_over"
    UNDECODABLE = "undecodable"
    COINCIDENT_POINTS = "coincident_points"
    OUT_OF_FRAME = "out_of_frame"
    DAMAGED = "damaged"
    LOW_LIKELIHOOD = "low_likelihood"
    JUMP = "jump"


@dataclass(frozen=True)
class Detections:
    """What a detector found in a batch of frames.

    Attributes
    ----------
    xy : ndarray of float
        (N, K, 2) float64, px of the full frame.
    likelihood : ndarray of float
        (N, K) float64 in [0, 1].
    covariance : ndarray of float
        (N, K, 2, 2) float64, px^2.
    """

    xy: FloatArray
    likelihood: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        n, k = self.likelihood.shape
        if self.xy.shape != (n, k, 2) or self.covariance.shape != (n, k, 2, 2):
            raise ValueError(
                f"expected xy (N, K, 2), likelihood (N, K), covariance (N, K, 2, 2), "
                f"got {self.xy.shape}, {self.likelihood.shape}, {self.covariance.shape}"
            )


class Correlation(NamedTuple):
    """Two points whose errors go together, because one measurement gives both.

    Attributes
    ----------
    first, second : str
        Names of the keypoints.
    coefficient : float
        Of correlation of their errors in the same direction, -1 to 1.
    """

    first: str
    second: str
    coefficient: float


class Detector(Protocol):
    """Anything that finds keypoints in frames: a network, a compiled engine, an oracle in a test."""

    @property
    def keypoints(self) -> tuple[str, ...]:
        """Names of the K keypoints, in the order of the arrays."""

    @property
    def batch_size(self) -> int:
        """Number of frames that `detect` should be given at once."""

    @property
    def provenance(self) -> Mapping[str, Any]:
        """JSON-ready settings and hashes: two detectors with equal provenance give equal detections."""

    def detect(self, frames: Frames) -> Detections:
        """Find the keypoints in frames. There may be fewer than `batch_size`.

        Parameters
        ----------
        frames : Frames
            N frames, N <= `batch_size`.

        Returns
        -------
        Detections
            Keypoints of the N frames.
        """


@runtime_checkable
class TrainedDetector(Detector, Protocol):
    """A detector that knows how its errors go together, for the angle's standard deviation."""

    @property
    def correlations(self) -> Sequence[Correlation]:
        """Pairs of keypoints whose errors go together."""

    @property
    def label_variance_px2(self) -> float:
        """Variance of each point that its labels' errors leave, the same in all frames, px^2; 0 without labels."""


@runtime_checkable
class ReportingDetector(Protocol):
    """A detector that says what it decided for the video at hand, which `provenance` cannot know before."""

    @property
    def findings(self) -> Mapping[str, Any]:
        """JSON-ready; recorded in the results, and no part of what makes them up to date."""


@runtime_checkable
class FilmCalibratedDetector(Protocol):
    """A detector whose likelihoods are calibrated once more when all frames of a film are known."""

    def film_calibrated(self, found: Detections) -> tuple[Detections, Mapping[str, Any]]:
        """Calibrate likelihoods for a film.

        Parameters
        ----------
        found : Detections
            Of all its frames, NaN where one could not be decoded.

        Returns
        -------
        found : Detections
        findings : mapping of str to Any
            JSON-ready, what was found out about the film.
        """


@runtime_checkable
class VideoDetector(Detector, Protocol):
    """A detector that is more accurate, or faster, when it is given the frames of one video in order."""

    @property
    def workers(self) -> int:
        """Number of chunks of a video that can be processed in parallel."""

    def chunk_frames(self, size_wh: tuple[int, int], frames: int | None) -> int:
        """Frames in a chunk, for a video of `frames` frames (None: unknown) of size `size_wh` px.

        Parameters
        ----------
        size_wh : tuple of (int, int)
            Width and height of the frames, px.
        frames : int or None
            Number of frames in the video, None where unknown.

        Returns
        -------
        int
            Number of frames in a chunk.
        """

    def follow(self) -> Detector:
        """A new detector for consecutive frames, which may use its detections in the frames before.

        Returns
        -------
        Detector
            A detector that is given the chunk's frames in order.
        """


@runtime_checkable
class DropAwareDetector(Detector, Protocol):
    """A detector for one video that must know of dropped frames, which it is not given."""

    def skip_frames(self, count: int) -> None:
        """Announce that the next `count` frames of the video were dropped.

        Parameters
        ----------
        count : int
            Number of frames.
        """


@dataclass(frozen=True)
class LabelledFrame:
    """One frame with the keypoints that a person labelled.

    Attributes
    ----------
    video : str
        Stem of the video it comes from (its folder in labeled-data/).
    image_path : Path
        The extracted frame, an existing image file.
    xy : ndarray of float
        (K, 2) float64 px, NaN where a keypoint is not labelled.
    actuator : str
        Which actuator it shows; labels of one actuator train and are judged together.
    frame : int or None
        Index of the frame in its video, None where the file name does not contain it.
    propagated : bool
        Whether the positions follow from labels in other frames of the video: nobody labelled this one.
    """

    video: str
    image_path: Path
    xy: FloatArray
    actuator: str
    frame: int | None = None
    propagated: bool = False
