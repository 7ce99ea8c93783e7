"""Calibration: from a network's own spreads and peaks to covariances and likelihoods.

A position is uncertain for two reasons. The network finds a keypoint a little elsewhere in every frame: its spread head
has learnt how much. And all it knows comes from n labels with an error of `label_sd_px` each: however steady the
network is, the labelled point is known to label_sd_px / sqrt(n) only.

A heatmap's peak is no probability. One keypoint's stays at 0.5 where another's reaches 0.9, and both grow with
training. Divided by its median in labelled frames, the reference peak, it says how well the keypoint is seen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...tracker.types import BoolArray, Detections, FloatArray

MEDIAN_CHI2 = float(np.log(4.0))
"""Median squared Mahalanobis distance of a two-dimensional Gaussian."""

FILM_QUANTILE, LEAST_FILM_SCALE = 0.25, 0.5
"""A film's own peaks are taken from its lower quarter, for a keypoint is seen less well in some poses; below half of
the peaks in labelled frames it may be something else that is seen."""

MIN_PASSED = 0.5
"""Share of a film's frames that must pass the checks of agreement and distance before its peaks say anything."""

CLICK_SD_PX = 1.0
"""Error of a click along either axis, px of the frame, where too few labels show it."""

DEFINITION_SD_RAD = float(np.deg2rad(2.0))
"""How far the direction in which someone labels an end differs from the one that a pretrained network finds, rad."""

LEAST_RESTING_SCALE = 0.25
"""A keypoint at rest is not called more certain than half of the network's own standard deviation: another film may
show it a little differently."""

MOST_CORRELATED = 0.98
"""Correlation of the errors of an end's two points is not taken for more."""

MIN_REFERENCE_PEAK = 0.2
"""A network with a lower reference peak has not learnt the keypoint: its likelihoods are not raised further."""


@dataclass(frozen=True)
class Calibration:
    """Covariance = scale * spread + label_sd_px**2 / n_labels; likelihood = peak / reference peak, at most 1.

    Attributes
    ----------
    scale : float
        Factor on the network's own covariances. Above 1 where held-out labels lie further away than spread, label
        noise and chance explain. For a pretrained network also below 1, since its truth is exact and plentiful.
    label_sd_px : float
        Standard deviation of a label's error in x and in y, px, from the residuals of the training frames.
    n_labels : int
        Labels that a keypoint of one actuator was learnt from.
    reference_peak : tuple of float
        For each of K keypoints the median peak in labelled frames; empty where none is known.
    resting_scale : tuple of float
        For each of K keypoints a further factor on the network's own covariances, below 1 for a keypoint that rests and
        is found there more steadily than the network says; empty for 1.
    end_correlation : tuple of (int, int, float)
        For each moving end its two keypoints, and the correlation of their errors: the end is regressed as one rigid
        piece, so its direction is known better than two points found by themselves would give it.
    """

    scale: float = 1.0
    label_sd_px: float = 0.0
    n_labels: int = 1
    reference_peak: tuple[float, ...] = ()
    resting_scale: tuple[float, ...] = ()
    end_correlation: tuple[tuple[int, int, float], ...] = ()

    def apply(self, found: Detections) -> Detections:
        """Detections (N, K) with calibrated likelihoods and covariances, from the network's own."""
        scale = self.scale * np.asarray(self.resting_scale or 1.0)[..., None, None]
        covariance = found.covariance * scale + np.eye(2) * self.label_variance_px2
        return replace(found, covariance=covariance, likelihood=self.likelihood(found.likelihood))

    @property
    def label_variance_px2(self) -> float:
        """Variance of the labels' mean along either axis, px^2."""
        return self.label_sd_px**2 / self.n_labels

    def likelihood(self, peak: FloatArray) -> FloatArray:
        """Likelihoods in [0, 1] from peaks (N, K, ...) of heatmaps."""
        reference = self.normalising_peak.reshape(-1, *(1,) * (peak.ndim - 2))
        return np.minimum(peak / reference, 1.0)

    @property
    def normalising_peak(self) -> FloatArray:
        """What peaks are divided by, (K,): `reference_peak`, at least `MIN_REFERENCE_PEAK`; 1 where none is known."""
        return np.asarray(np.maximum(self.reference_peak or 1.0, MIN_REFERENCE_PEAK))

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready, under the names of the checkpoint's format, and read back by `from_dict`."""
        return {
            "scale": self.scale,
            "label_sd_px": self.label_sd_px,
            "n_labels": self.n_labels,
            "usual_peak": list(self.reference_peak),
            "resting_scale": list(self.resting_scale),
            "end_correlation": [list(end) for end in self.end_correlation],
        }

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Calibration:
        """The calibration that `to_dict` wrote."""
        return cls(
            values["scale"],
            values["label_sd_px"],
            values["n_labels"],
            tuple(values["usual_peak"]),
            tuple(values.get("resting_scale", ())),
            tuple((int(k), int(p), float(r)) for k, p, r in values.get("end_correlation", ())),
        )


def calibrate(
    trained: Detections,
    trained_labels: FloatArray,
    held: Detections | None,
    held_labels: FloatArray | None,
    actuators: int = 1,
) -> Calibration:
    """Calibrate on what the network finds in training frames and in held-out frames.

    Medians throughout: one label on the wrong spot must not make every frame uncertain.

    Parameters
    ----------
    trained : Detections
        (N, K), in the training frames.
    trained_labels : ndarray of float, shape (N, K, 2)
        Their labels, px; NaN where not labelled.
    held : Detections or None
        (M, K), in the held-out frames.
    held_labels : ndarray of float, shape (M, K, 2), or None
        Their labels.
    actuators : int, optional
        So many share the training frames: where the points of one lie, the labels of another do not say.
    """
    residual = trained.xy - trained_labels
    known = np.logical_not(np.isnan(residual[..., 0]))
    n = int(max(1, np.median((~np.isnan(trained_labels).any(axis=2)).sum(axis=0)) / actuators))
    label_sd = float(np.sqrt(np.median((residual[known] ** 2).sum(axis=1)) / MEDIAN_CHI2))
    scale = 1.0
    if held is not None and held_labels is not None:
        scale = spread_scale(held, held_labels, label_sd**2 * (1 + 1 / n))
    return Calibration(scale, label_sd, n, reference_peaks(trained.likelihood, known))


def film_scale(likelihood: FloatArray) -> FloatArray:
    """What the likelihoods of a film are divided by: in other light than the labels' all peaks are lower.

    A keypoint is found there as surely as it can be; how far off it may be, its covariance says. Frames in which some
    check failed have likelihood 0, and do not count.

    Parameters
    ----------
    likelihood : ndarray of float, shape (T, K)
        Of all frames of a film, NaN where it could not be decoded.

    Returns
    -------
    ndarray of float, shape (K,)
        `LEAST_FILM_SCALE` to 1; 1 where fewer than half of the frames pass the checks.
    """
    known = likelihood[np.isfinite(likelihood).all(axis=1)]
    passed = known[(known > 0).all(axis=1)]
    if not len(passed) or len(passed) < MIN_PASSED * len(known):
        return np.ones(likelihood.shape[1])
    return np.asarray(np.clip(np.quantile(passed, FILM_QUANTILE, axis=0), LEAST_FILM_SCALE, 1.0))


def turn_shrinkage(n_labels: int, end_px: float) -> float:
    """Share of the turn between a few labels of an end and the network's that is taken for real, 0 to 1.

    Parameters
    ----------
    n_labels : int
        Labels of the end.
    end_px : float
        Distance of its two points, px.
    """
    clicks = 2 * (CLICK_SD_PX / end_px) ** 2 / n_labels
    return float(DEFINITION_SD_RAD**2 / (DEFINITION_SD_RAD**2 + clicks))


def few_label_variance_px2(n_labels: int, end_px: float) -> float:
    """Variance of each point of an end along either axis that a few labels leave, px^2.

    It turns the end by as much as is unknown after `turn_shrinkage`.

    Parameters
    ----------
    n_labels, end_px
        As `turn_shrinkage`'s.
    """
    return turn_shrinkage(n_labels, end_px) * CLICK_SD_PX**2 / n_labels


def resting_scale(found: Detections, resting_xy: FloatArray) -> tuple[float, ...]:
    """The factor on the network's own covariances that explains how far resting keypoints are found from their place.

    Parameters
    ----------
    found : Detections
        (N, K).
    resting_xy : ndarray of float, shape (N, K, 2)
        The place of a keypoint that rests, px; NaN for one that moves.

    Returns
    -------
    tuple of float
        For each keypoint `LEAST_RESTING_SCALE` to 1; 1 for those that move.
    """
    off = found.xy - resting_xy
    scales = []
    for k in range(off.shape[1]):
        rests = ~np.isnan(off[:, k]).any(axis=1)
        own, covariance = off[rests, k], found.covariance[rests, k]
        distance2 = np.einsum("ni,nij,nj->n", own, np.linalg.inv(covariance), own)
        scale = float(np.median(distance2)) / MEDIAN_CHI2 if rests.any() else 1.0
        scales.append(float(np.clip(scale, LEAST_RESTING_SCALE, 1.0)))
    return tuple(scales)


def end_correlation(
    found: Detections, end: tuple[int, int], turn_sd_rad: float, label_variance: float
) -> float:
    """Correlation of the errors of an end's two points at which its direction is as uncertain as it is known to be.

    Parameters
    ----------
    found : Detections
        (N, K), calibrated.
    end : (int, int)
        The two keypoints.
    turn_sd_rad : float
        Standard deviation of the end's direction from frame to frame, rad.
    label_variance : float
        Of each point's mean label, px^2: the labels' errors are independent.

    Returns
    -------
    float
        0 to `MOST_CORRELATED`; 0 where the two points by themselves are not more uncertain.
    """
    along = found.xy[:, end[1]] - found.xy[:, end[0]]
    length = np.linalg.norm(along, axis=1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1) / length[:, None]
    first, second = (np.einsum("ni,nij,nj->n", across, found.covariance[:, k], across) for k in end)
    wanted = (turn_sd_rad * length) ** 2 + 2 * label_variance
    correlation = (first + second - wanted) / (2 * np.sqrt(first * second))
    known = correlation[np.isfinite(correlation)]
    return float(np.clip(np.median(known), 0.0, MOST_CORRELATED)) if known.size else 0.0


def typical_scale(found: Detections, truth: FloatArray) -> float:
    """The factor on the network's own covariances that explains its median distance from the exact truth.

    Parameters
    ----------
    found : Detections
        (N, K).
    truth : ndarray of float, shape (N, K, 2)
        px; NaN where a keypoint cannot be seen.
    """
    off = found.xy - truth
    seen = ~np.isnan(off).any(axis=2)
    distance2 = np.einsum("ni,nij,nj->n", off[seen], np.linalg.inv(found.covariance[seen]), off[seen])
    return float(np.median(distance2)) / MEDIAN_CHI2


def reference_peaks(likelihood: FloatArray, known: BoolArray) -> tuple[float, ...]:
    """For each keypoint the median peak of heatmaps (N, K) where it is known (N, K) to be there."""
    return tuple(
        float(np.median(own[seen])) if seen.any() else 1.0
        for own, seen in zip(likelihood.T, known.T, strict=True)
    )


def spread_scale(found: Detections, truth: FloatArray, truth_variance: float) -> float:
    """The factor on the network's own covariances that explains its distances from noisy positions.

    Parameters
    ----------
    found : Detections
        (N, K).
    truth : ndarray of float, shape (N, K, 2)
        Positions, px; NaN where unknown.
    truth_variance : float
        Variance of these positions in x and in y, px^2.

    Returns
    -------
    float
        1 where the spread is not clearly too small, or nothing is known.
    """
    off = found.xy - truth
    seen = ~np.isnan(off).any(axis=2)
    off, own = off[seen], found.covariance[seen]

    def distance2(scale: float) -> float:
        covariance = own * scale + np.eye(2) * truth_variance
        return float(np.median(np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariance), off)))

    # Few points are held out, and half of all medians lie above their expectation: only what chance would not do
    # (two standard errors of the median, 2 / sqrt(n) each) says that the spread is too small.
    chance = MEDIAN_CHI2 + 2 * 2 / np.sqrt(max(len(off), 1))
    if not len(off) or distance2(1.0) <= chance:
        return 1.0
    low, high = 1.0, 1e4
    for _ in range(60):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if distance2(middle) > MEDIAN_CHI2 else (low, middle)
    return high
