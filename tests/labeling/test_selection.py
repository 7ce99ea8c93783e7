"""Chosen frames span the motion whatever the video does: rendered trials, of which the true angles are known."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bendtrack.labeling.frame_descriptors import FrameDescriptor
from bendtrack.labeling.gap_filling import fill_gaps
from bendtrack.labeling.pressure_signal import PressureSignal
from bendtrack.labeling.selection import select_frames
from bendtrack.labeling.stream_clustering import AppearanceClusters, BinnedClusters
from bendtrack.labeling.video_scan import VideoScan, scan_video
from bendtrack.tracker.synthetic.stream import TRAINING
from bendtrack.tracker.synthetic.trial import Trial, render_trial
from bendtrack.tracker.video import Video
from bendtrack.tracker.video_writer import VideoWriter

SEEDS = {"200 deg": 7, "wide loop": 8, "small bend": 100, "dark rubber": 5}
COVERED, GAP = 0.95, 0.08


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Trial]:
    """Two cycles of four actuators under wandering light, small enough to render quickly."""
    return {
        name: render_trial(
            tmp_path_factory.mktemp(f"seed{seed}"),
            seed=seed,
            frequency_hz=0.2,
            cycles=2,
            frame_rate=18,
            size_wh=(200, 150),
            end_vector_px=14,
            angle_max_deg=60.0 if name == "small bend" else 200.0,
            families=replace(TRAINING, materials=(name,)) if name == "dark rubber" else TRAINING,
            hysteresis_ratio=0.35 if name == "wide loop" else 0.2,
        )
        for name, seed in SEEDS.items()
    }


@pytest.fixture(scope="module")
def images(trials: dict[str, Trial]) -> list[np.ndarray]:
    """The frames of one of them, RGB."""
    return [frame.image for frame in Video(trials["200 deg"].video_path)]


@pytest.fixture(scope="module")
def angles(trials: dict[str, Trial]) -> np.ndarray:
    """And their true angles."""
    return trials["200 deg"].angle_deg


def write(path: Path, images: Sequence[np.ndarray]) -> Path:
    height, width = images[0].shape[:2]
    with VideoWriter(path, (width, height), 18.0) as writer:
        for index, image in enumerate(images):
            writer.write(image, index / 18)
    return path


def looked_at(video: Path, known: Sequence[int] = ()) -> VideoScan:
    return scan_video(video, AppearanceClusters(400), known=known)


def chosen_frames(video: Path, count: int = 30, known: Sequence[int] = ()) -> list[int]:
    return [descriptor.frame for descriptor in select_frames([looked_at(video, known)], count)[0]]


def covered_and_gap(chosen_deg: np.ndarray, all_deg: np.ndarray) -> tuple[float, float]:
    """Part of the range that frames span, and the largest gap between them, over the range."""
    inside = np.sort(chosen_deg)
    return np.ptp(inside) / np.ptp(all_deg), np.diff(inside).max() / np.ptp(all_deg)


@pytest.mark.parametrize("name", SEEDS)
def test_thirty_frames_span_the_motion_by_appearance_alone(trials: dict[str, Trial], name: str) -> None:
    trial = trials[name]
    frames = chosen_frames(trial.video_path)
    assert len(set(frames)) == 30
    covered, gap = covered_and_gap(trial.angle_deg[frames], trial.angle_deg)
    assert covered >= COVERED
    assert gap <= GAP


def test_what_was_chosen_by_time_would_not(trials: dict[str, Trial]) -> None:
    # So the test above is able to fail: the wide loop rests at small angles.
    trial = trials["wide loop"]
    frames = np.linspace(0, len(trial.angle_deg) - 1, 30).astype(int)
    assert covered_and_gap(trial.angle_deg[frames], trial.angle_deg)[1] > GAP


def test_more_frames_fill_the_gaps_that_are_left(trials: dict[str, Trial]) -> None:
    trial = trials["200 deg"]
    first = chosen_frames(trial.video_path, 10)
    more = chosen_frames(trial.video_path, 20, known=first)
    assert len({*first, *more}) == 30
    covered, gap = covered_and_gap(trial.angle_deg[[*first, *more]], trial.angle_deg)
    assert covered >= COVERED
    assert gap <= GAP


def test_frames_that_all_lie_at_one_end_are_no_reason_to_choose_more_there(
    trials: dict[str, Trial], angles: np.ndarray
) -> None:
    low = np.argsort(angles)[:12]
    more = chosen_frames(trials["200 deg"].video_path, 12, known=[int(i) for i in low])
    assert not set(low) & set(more)
    # As for 30 frames: 2.3 times the gaps of frames that are evenly spread.
    assert covered_and_gap(np.r_[angles[low], angles[more]], angles)[1] <= 2.3 / 12


def test_a_long_rest_takes_no_frames_from_the_motion(
    tmp_path: Path, images: list[np.ndarray], angles: np.ndarray
) -> None:
    rng = np.random.default_rng(0)
    rest = [np.clip(images[0] + rng.normal(0, 2, images[0].shape), 0, 255).astype(np.uint8) for _ in range(8)]
    video = write(tmp_path / "rest.mp4", [*(rest[i % 8] for i in range(600)), *images])
    all_deg = np.r_[np.full(600, angles[0]), angles]
    frames = chosen_frames(video)
    covered, gap = covered_and_gap(all_deg[frames], all_deg)
    assert covered >= COVERED
    assert gap <= 0.1
    assert sum(frame < 600 for frame in frames) <= 3


def test_blurred_frames_are_skipped(tmp_path: Path, images: list[np.ndarray], angles: np.ndarray) -> None:
    blurred = np.random.default_rng(1).permutation(len(images))[: len(images) // 3]
    images = [
        cv2.GaussianBlur(image, (0, 0), 2.0) if index in set(blurred) else image
        for index, image in enumerate(images)
    ]
    frames = chosen_frames(write(tmp_path / "blurred.mp4", images))
    assert len(set(frames) & set(blurred)) <= 2  # of 10, were they drawn by chance
    assert covered_and_gap(angles[frames], angles)[0] >= COVERED


def test_equal_frames_are_chosen_once(tmp_path: Path, images: list[np.ndarray], angles: np.ndarray) -> None:
    poses = [int(np.argmin(np.abs(angles[:50] - angle))) for angle in np.linspace(5, 195, 9)]
    images = [images[pose] for pose in poses for _ in range(8)]
    frames = chosen_frames(write(tmp_path / "steps.mp4", images))
    assert sorted(frame // 8 for frame in frames) == list(range(9))


def test_nothing_that_moves_is_one_image(tmp_path: Path, images: list[np.ndarray]) -> None:
    rng = np.random.default_rng(2)
    images = [
        np.clip(images[0] + rng.normal(0, 3, images[0].shape), 0, 255).astype(np.uint8) for _ in range(60)
    ]
    assert len(chosen_frames(write(tmp_path / "still.mp4", images))) == 1


def test_damaged_frames_are_skipped(tmp_path: Path, trials: dict[str, Trial]) -> None:
    data = bytearray(trials["200 deg"].video_path.read_bytes())
    start = len(data) // 3
    data[start : start + 400] = np.random.default_rng(3).bytes(400)
    (tmp_path / "hurt.mp4").write_bytes(data)
    frames = list(Video(tmp_path / "hurt.mp4"))
    sound = {frame.index for frame in frames if frame.decoded is not None and not frame.damaged}
    assert 30 < len(sound) < len(frames)
    found = looked_at(tmp_path / "hurt.mp4")
    assert found.warnings
    assert {descriptor.frame for descriptor in select_frames([found], 30)[0]} <= sound


def test_videos_of_one_actuator_share_the_count(
    tmp_path: Path, images: list[np.ndarray], angles: np.ndarray
) -> None:
    small = [index for index, angle in enumerate(angles) if angle < 90]
    videos = [write(tmp_path / "a.mp4", images), write(tmp_path / "b.mp4", [images[i] for i in small])]
    chosen = select_frames([looked_at(video) for video in videos], 30)
    assert [len(descriptors) for descriptors in chosen] == pytest.approx([15, 15], abs=4)
    reached = np.r_[angles[[g.frame for g in chosen[0]]], angles[small][[g.frame for g in chosen[1]]]]
    covered, gap = covered_and_gap(reached, angles)
    assert covered >= COVERED
    assert gap <= GAP


def test_a_camera_that_was_moved_gives_two_views_with_frames_of_each(
    tmp_path: Path, images: list[np.ndarray], angles: np.ndarray
) -> None:
    videos = [write(tmp_path / "a.mp4", images), write(tmp_path / "b.mp4", [x[:, ::-1] for x in images])]
    chosen = select_frames([looked_at(video) for video in videos], 30)
    for descriptors in chosen:
        assert len(descriptors) == 15
        covered, gap = covered_and_gap(angles[[g.frame for g in descriptors]], angles)
        assert covered >= COVERED
        assert gap <= 2.3 / 14
    known = [[g.frame for g in descriptors] for descriptors in chosen]
    more = select_frames([looked_at(video, own) for video, own in zip(videos, known, strict=True)], 8)
    for descriptors, own in zip(more, known, strict=True):
        assert len(descriptors) == 4
        assert not {g.frame for g in descriptors} & set(own)


# --- what is kept while a video streams by ---------------------------------------------------------------


def descriptor_of(value: float, frame: int, rng: np.random.Generator) -> FrameDescriptor:
    """A bright bar at a place, on noise."""
    look = rng.normal(100, 0.5, (18, 24)).astype(np.float32)
    look[:, int(value * 20) : int(value * 20) + 4] += 80
    return FrameDescriptor(frame, frame / 30, look, np.ones((6, 8), np.float32))


def test_memory_is_flat_and_what_is_seen_once_is_kept() -> None:
    rng, clusters = np.random.default_rng(0), AppearanceClusters(50)
    places = np.where(np.arange(6000) == 3210, 1.0, 0.4 * rng.uniform(size=6000))
    for frame, place in enumerate(places):
        clusters.add(descriptor_of(place, frame, rng))
    assert len(clusters.clusters) <= 50
    assert sum(cell.count for cell in clusters.clusters) == 6000
    assert max(len(cell.members) for cell in clusters.clusters) <= 6
    assert [
        descriptor.frame
        for cell in clusters.clusters
        for descriptor in cell.members
        if descriptor.frame == 3210
    ] == [3210]


def test_bins_of_time_grow_with_the_video() -> None:
    clusters = BinnedClusters(lambda time_s: (time_s, 0), 0.05, 64)
    for frame in range(9000):
        clusters.add(
            FrameDescriptor(frame, frame / 30, np.zeros((1, 1), np.float32), np.zeros((1, 1), np.float32))
        )
    kept = clusters.clusters
    assert 32 <= len(kept) <= 64
    starts = [cell.members[0].time_s for cell in kept]
    assert np.diff(starts).max() < 1.1 * np.diff(starts).min()
    members = [descriptor.time_s for cell in kept for descriptor in cell.members]
    assert np.diff(sorted(members)).max() < 300 / 32


# --- pressure --------------------------------------------------------------------------------------------


def test_pressure_and_its_direction_at_a_time() -> None:
    time_s = np.arange(0, 40, 0.01)
    clean = 25 - 25 * np.abs((time_s % 20) / 10 - 1) * 2 + 25  # up for 10 s, down for 10 s
    noisy = clean + np.random.default_rng(0).normal(0, 0.3, len(time_s))
    noisy[(time_s > 31) & (time_s < 33)] = np.nan
    order = PressureSignal(time_s, noisy)
    assert order.range_kpa == pytest.approx(50, abs=3)
    for at_s, rising in ((0.5, 1), (5.0, 1), (9.0, 1), (11.0, 0), (19.0, 0), (25.0, 1), (35.0, 0)):
        found = order.at(at_s)
        assert found is not None
        assert found[1] == rising, at_s
        assert found[0] == pytest.approx(np.interp(at_s, time_s, clean), abs=1.5)
    assert order.at(-0.1) is None
    assert order.at(40.5) is None
    assert order.at(32.0) is None


# --- gaps ------------------------------------------------------------------------------------------------

GRID = np.linspace(0, 1, 17)


@settings(max_examples=60, deadline=None)
@given(inside=st.lists(st.floats(0, 1), max_size=6), count=st.integers(1, 3))
def test_no_other_way_to_fill_leaves_a_smaller_gap(inside: list[float], count: int) -> None:
    taken = [0.0, *inside, 1.0]
    targets = [target.value for target in fill_gaps(0.0, 1.0, taken, count)]
    assert len(targets) == count
    assert targets == sorted(targets)

    def widest(more: Sequence[float]) -> float:
        return float(np.diff(sorted([*taken, *more])).max())

    others = itertools.combinations_with_replacement(GRID, count)
    assert widest(targets) <= min(map(widest, others)) + 1e-12


@pytest.mark.parametrize(
    ("taken", "count", "expected"),
    [
        ([], 1, [5.0]),
        ([], 2, [0.0, 10.0]),
        ([5.0], 2, [0.0, 10.0]),
        ([3.0], 1, [10.0]),
        ([0.0, 1.0, 2.0, 9.0], 3, [3.75, 5.5, 7.25]),
        ([-4.0, np.nan, 5.0], 2, [0.0, 10.0]),  # what lies elsewhere does not count
    ],
)
def test_the_ends_of_the_line_come_first(taken: list[float], count: int, expected: list[float]) -> None:
    assert [target.value for target in fill_gaps(0.0, 10.0, taken, count)] == expected


def test_without_any_there_the_points_are_even() -> None:
    targets = fill_gaps(-3.0, 5.0, [], 9)
    np.testing.assert_allclose([target.value for target in targets], np.linspace(-3, 5, 9))
    assert {target.spacing for target in targets} == {1.0}
