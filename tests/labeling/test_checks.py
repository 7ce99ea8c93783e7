"""Mistakes put into labels are found, and labels with a steady hand's error are left in peace: over many looks."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from bendtrack.labeling.checks import Finding, Problem, check_labels
from bendtrack.labeling.notes_file import write_notes
from bendtrack.labeling.store import LabelStore, image_name
from bendtrack.tracker.errors import LabelError
from bendtrack.tracker.project import Project
from bendtrack.tracker.synthetic.stream.chain import ENDS, Chain
from bendtrack.tracker.synthetic.trial_looks import trial_look

KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")
NOISE_PX = 1.0


def bend_xy(seed: int, frames: int = 30) -> np.ndarray:
    """(frames, 4, 2) px, exact points of an actuator that bends to 60, 120, 190 or 205 degrees in 640 x 480 px."""
    look = trial_look(seed, end_vector_px=(25.0, 40.0, 60.0)[seed % 3])
    angles = np.linspace(0, (60, 120, 190, 205)[seed % 4], frames)
    chains = [Chain(look.body, look.place, angle) for angle in angles]
    return np.stack([chain.point(chain.keypoint_s[ENDS]) for chain in chains])


def labelled(root: Path, xy: np.ndarray, video: str = "v", project: Project | None = None) -> Project:
    """A project with these labels, each on an image of its own."""
    project = project or Project.create(root, keypoints=KEYPOINTS)
    store = LabelStore.of(project)
    (store.labels_dir / video).mkdir(parents=True)
    for index in range(len(xy)):
        image = np.zeros((480, 640), np.uint8)
        image[0, : 8 * len(video)] = np.repeat(np.frombuffer(video.encode(), np.uint8), 8)
        image[1, index] = 255
        cv2.imwrite(str(store.labels_dir / video / image_name(index)), image)
    store.write(video, {image_name(index): points for index, points in enumerate(xy)})
    return project


def found(project: Project) -> list[tuple[str, Problem, tuple[str, ...]]]:
    return [(f.image, f.problem, f.keypoints) for f in check_labels(project).findings]


def hand(seed: int, xy: np.ndarray) -> np.ndarray:
    """Labels as an unsteady hand sets them."""
    return xy + NOISE_PX * np.random.default_rng(seed).standard_normal(xy.shape)


def test_few_false_alarms_on_labels_with_one_px_of_noise(tmp_path: Path) -> None:
    alarms = 0
    for seed in range(16):
        xy = hand(seed, bend_xy(seed, frames=(12, 20, 30)[seed % 3]))
        report = check_labels(labelled(tmp_path / str(seed), xy))
        assert report.labelled == len(xy)
        alarms += len(report.findings)
    assert alarms <= 1  # of 330 frames


@pytest.mark.parametrize(
    ("order", "concerned"),
    [
        ((1, 0, 2, 3), ("base_1", "base_2")),
        ((0, 1, 3, 2), ("tip_1", "tip_2")),
        ((3, 2, 1, 0), KEYPOINTS),
        ((2, 3, 0, 1), KEYPOINTS),
    ],
)
def test_swapped_points_are_found_in_every_look(
    tmp_path: Path, order: tuple[int, ...], concerned: tuple[str, ...]
) -> None:
    for seed in range(8):
        xy = hand(seed, bend_xy(seed))
        wrong = 3 + 3 * seed
        xy[wrong] = xy[wrong][list(order)]
        assert (image_name(wrong), Problem.SWAPPED, concerned) in found(labelled(tmp_path / str(seed), xy))


def test_a_point_in_the_wrong_place_is_found_among_other_mistakes(tmp_path: Path) -> None:
    caught = 0
    for seed in range(8):
        rng = np.random.default_rng([seed, 1])
        xy = hand(seed, bend_xy(seed))
        turn, point = rng.uniform(0, 2 * np.pi), int(rng.integers(4))
        xy[9, point] += 18 * np.array([np.cos(turn), np.sin(turn)])
        xy[20] = xy[20][::-1]
        xy[25] = xy[25][[1, 0, 2, 3]]
        findings = check_labels(labelled(tmp_path / str(seed), xy)).findings
        assert {f.image for f in findings if f.problem is Problem.SWAPPED} == {image_name(20), image_name(25)}
        others = [f for f in findings if f.problem is not Problem.SWAPPED]
        assert {f.image for f in others} <= {image_name(9)}
        caught += bool(others)
    assert caught >= 7


def test_a_segment_that_jumps_in_length_is_named(tmp_path: Path) -> None:
    xy = bend_xy(4)
    along = xy[12, 1] - xy[12, 0]
    xy[12, 0] -= 0.6 * along  # base_1 is labelled too far out
    findings = check_labels(labelled(tmp_path, hand(4, xy))).findings
    assert [(f.image, f.problem, f.keypoints) for f in findings] == [
        (image_name(12), Problem.SEGMENT, ("base_1",))
    ]
    length = float(np.linalg.norm(along))
    assert f"base_1 to base_2 is {1.6 * length:.0f}"[:-1] in findings[0].message


def test_points_that_are_missing_outside_or_at_one_place(tmp_path: Path) -> None:
    xy = hand(2, bend_xy(2))
    xy[3, 2:] = np.nan
    xy[5, 3] = xy[5, 2] + 0.2
    xy[7, 0] = (-0.7, 100)
    xy[8, 0] = (639.4, 479.4)  # the corner pixel ends at 639.5, 479.5
    project = labelled(tmp_path, xy)
    by_problem: dict[Problem, list[Finding]] = {}
    for finding in check_labels(project).findings:
        by_problem.setdefault(finding.problem, []).append(finding)
    assert [(f.image, f.keypoints) for f in by_problem[Problem.MISSING]] == [
        (image_name(3), ("tip_1", "tip_2"))
    ]
    assert [(f.image, f.keypoints) for f in by_problem[Problem.COINCIDENT]] == [
        (image_name(5), ("tip_1", "tip_2"))
    ]
    assert [(f.image, f.keypoints) for f in by_problem[Problem.OUTSIDE]] == [(image_name(7), ("base_1",))]
    # What is known not to be visible is not missing; what is skipped is no label.
    write_notes(project.labels_dir / "v", image_name(3), {"not_visible": ["tip_1", "tip_2"]})
    write_notes(project.labels_dir / "v", image_name(5), {"skipped": True})
    left = {f.problem for f in check_labels(project).findings}
    assert not left & {Problem.MISSING, Problem.COINCIDENT}


def test_the_same_image_under_two_names(tmp_path: Path) -> None:
    project = labelled(tmp_path, hand(0, bend_xy(0)))
    folder = project.labels_dir / "v"
    image = cv2.imread(str(folder / image_name(2)))
    cv2.imwrite(str(folder / image_name(17)), image, [cv2.IMWRITE_PNG_COMPRESSION, 0])
    assert (folder / image_name(17)).read_bytes() != (folder / image_name(2)).read_bytes()
    report = check_labels(project)
    assert [(f.image, f.problem) for f in report.findings] == [(image_name(17), Problem.DUPLICATE)]
    assert "v/img00002.png" in report.findings[0].message


def test_videos_filmed_from_elsewhere_are_not_compared(tmp_path: Path) -> None:
    first, second = hand(0, bend_xy(0, 16)), hand(1, bend_xy(1, 16))
    project = labelled(tmp_path, first)
    labelled(tmp_path, second, "trial 2", project)
    assert check_labels(project).findings == []
    second[5] = second[5][::-1]
    LabelStore.of(project).write("trial 2", {image_name(5): second[5]})
    findings = check_labels(project).findings
    assert [(f.video, f.image, f.problem) for f in findings] == [("trial 2", image_name(5), Problem.SWAPPED)]
    assert findings[0].link == "#trial%202/img00005.png"
    assert findings[0].image_path.is_file()


def test_few_labels_are_not_compared_and_it_is_said(tmp_path: Path) -> None:
    xy = bend_xy(0, 7)
    xy[3] = xy[3][::-1]
    report = check_labels(labelled(tmp_path, xy))
    assert report.findings == []
    assert report.notes == [
        "default (v): 7 frames with all points, fewer than 8: not compared with each other"
    ]


def test_what_moves_freely_is_not_compared(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    body = np.array([[-30.0, 0.0], [-10.0, 0.0], [10.0, 0.0], [30.0, 0.0]])
    turns = rng.uniform(0, 2 * np.pi, 30)
    rotated = [body @ [[np.cos(t), np.sin(t)], [-np.sin(t), np.cos(t)]] for t in turns]
    report = check_labels(labelled(tmp_path, np.stack(rotated) + rng.uniform(60, 400, (30, 1, 2))))
    assert report.findings == []
    assert report.notes == ["default: the labels do not follow one motion: not compared with each other"]


def test_a_project_without_labels_or_with_a_broken_image_cannot_be_checked(tmp_path: Path) -> None:
    with pytest.raises(LabelError, match="expected labelled frames to check, got none"):
        check_labels(Project.create(tmp_path / "a", keypoints=KEYPOINTS))
    project = labelled(tmp_path / "b", bend_xy(0, 9))
    (project.labels_dir / "v" / image_name(4)).write_bytes(b"no image")
    with pytest.raises(LabelError, match=r"img00004\.png: expected an image"):
        check_labels(project)
