"""Repeat labels: which frames come back, that nothing is shown, where the answers lie, and the spread that follows."""

from __future__ import annotations

import json
import uuid

import numpy as np
import pytest

from bendtrack.labeling.repeatability import estimate_repeatability
from bendtrack.tracker.angle import AngleDefinition

KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")
TWO_VECTOR = AngleDefinition("two-vector", KEYPOINTS)
# Ends of 20 px, an angle of 90 degrees.
SHAPE = {"base_1": [10, 20], "base_2": [30, 20], "tip_1": [40, 30], "tip_2": [40, 50]}


def label_all(page, study) -> None:
    for index in range(12):
        assert page.put(index, points=SHAPE).status == 200


def answer_repeat(page, due, points, edit_id=None):
    body = {"edit_id": edit_id or str(uuid.uuid4()), "client_id": "anna", "points": points}
    return page("PUT", due["put_url"], body)


def shifted(points, by):
    return {name: [x + by[0], y + by[1]] for name, (x, y) in points.items()}


def test_the_spread_is_that_of_the_hand_and_its_interval_holds_it() -> None:
    # Truth: 0.8 px a coordinate; by hand, ends of L = 50 px: each end turns by sqrt(2) sigma / L.
    rng = np.random.default_rng(4)
    shape = np.array([[0.0, 0.0], [50.0, 0.0], [100.0, 50.0], [100.0, 100.0]])
    sigma, trials = 0.8, 400
    turn_deg = np.degrees(2 * sigma / 50)
    held = np.zeros(2)
    found = np.zeros(2)
    for _ in range(trials):
        labels, again = (shape + rng.normal(0, sigma, (6, 4, 2)) for _ in range(2))
        spread = estimate_repeatability(labels, again, KEYPOINTS, TWO_VECTOR)
        assert spread is not None
        assert (spread.n_points, spread.n_frames, spread.n_angles) == (24, 6, 6)
        held += [
            spread.px_low <= sigma <= spread.px_high,
            spread.deg_low <= turn_deg <= spread.deg_high,
        ]
        found += [spread.px**2, spread.deg**2]
    assert np.sqrt(found / trials) == pytest.approx([sigma, turn_deg], rel=0.03)
    assert (np.abs(held / trials - 0.95) < 0.035).all(), held / trials


def test_points_that_were_placed_once_do_not_count() -> None:
    label = np.array([[[0, 0], [10, 0], [20, 0], [30, 0]]], dtype=float)
    again = label + np.array([3.0, 4.0])
    again[0, 3] = np.nan
    spread = estimate_repeatability(label, again, KEYPOINTS, TWO_VECTOR)
    assert spread is not None
    assert spread.px == pytest.approx(np.sqrt(12.5 / 2))  # rms of 3 and 4, over sqrt(2)
    assert (spread.n_points, spread.n_frames, spread.n_angles, spread.deg) == (3, 1, 0, None)
    assert estimate_repeatability(label, np.full_like(label, np.nan), KEYPOINTS, TWO_VECTOR) is None
    assert estimate_repeatability(label[:0], label[:0], KEYPOINTS, TWO_VECTOR) is None


def test_frames_come_back_blind_and_their_answers_lie_apart(study, page) -> None:
    assert page("GET", "/api/repeats/next").status == 204
    label_all(page, study)
    labels = study.csv.read_bytes()
    # Five are wanted; the eight frames that were worked on last are remembered, so four can be asked for.
    assert page.get("/api/frames")["repeats"] == {"due": 4, "done": 0, "target": 5}
    asked = []
    while (answer := page("GET", "/api/repeats/next")).status == 200:
        due = answer.json
        assert due["repeat"] is True
        assert not {"points", "suggestions", "previous", "note"} & set(due)
        assert due["id"] in [study.id(i) for i in range(4 + len(asked))]
        asked.append(due["id"])
        answer = answer_repeat(page, due, shifted(SHAPE, (0.6, 0.8)))
        assert answer.status == 200
        assert answer.json["px"] == pytest.approx(1.0, abs=0.001)
        assert answer.json["angle_deg"] == pytest.approx(0, abs=0.001)
    assert len(asked) == len(set(asked)) == 5
    assert study.csv.read_bytes() == labels
    spread = page.get("/api/summary")["spread"]
    # rms of 0.6 and 0.8, over sqrt(2)
    assert spread["px"] == pytest.approx(0.5, abs=0.001)
    assert (spread["n_points"], spread["n_frames"], spread["deg"]) == (20, 5, 0)
    assert page.get("/api/summary")["actuators"][0]["sigma_px"] == 0.5


def test_the_difference_of_the_angle_is_told(study, page) -> None:
    label_all(page, study)
    turned = {**SHAPE, "tip_2": [40 - 20 * np.sin(np.radians(5)), 30 + 20 * np.cos(np.radians(5))]}
    answer = answer_repeat(page, page.get("/api/repeats/next"), turned)
    assert answer.json["angle_deg"] == pytest.approx(5, abs=0.01)
    assert answer.json["spread"]["deg"] == pytest.approx(5 / np.sqrt(2), abs=0.01)


def test_who_corrects_a_label_later_does_not_change_the_spread(study, page) -> None:
    label_all(page, study)
    due = page.get("/api/repeats/next")
    answer_repeat(page, due, shifted(SHAPE, (0.6, 0.8)))
    index = [study.id(i) for i in range(12)].index(due["id"])
    page.put(index, points=shifted(SHAPE, (0.6, 0.8)))
    assert page.get("/api/summary")["spread"]["px"] == pytest.approx(0.5, abs=0.001)


def test_undo_leaves_repeats_alone_and_notes_keep_them(study, page) -> None:
    label_all(page, study)
    due = page.get("/api/repeats/next")
    answer_repeat(page, due, SHAPE)
    index = [study.id(i) for i in range(12)].index(due["id"])
    page.put(index, note="seen twice")
    page.step("undo")
    assert page.step("undo").json["frame"]["id"] == study.id(11)
    assert page.get("/api/frames")["repeats"]["done"] == 1
    assert set(study.notes()[study.image(index)]) == {"repeat"}


def test_an_answer_sent_again_is_the_same_and_another_is_refused(study, page) -> None:
    label_all(page, study)
    due = page.get("/api/repeats/next")
    edit_id = str(uuid.uuid4())
    first = answer_repeat(page, due, shifted(SHAPE, (1, 0)), edit_id)
    assert answer_repeat(page, due, shifted(SHAPE, (1, 0)), edit_id).json == first.json
    # Who has seen how far off he was is not blind any more.
    assert answer_repeat(page, due, SHAPE).status == 404


def test_a_frame_skipped_is_not_asked_for_again(study, page) -> None:
    label_all(page, study)
    due = page.get("/api/repeats/next")
    answer = answer_repeat(page, due, dict.fromkeys(KEYPOINTS))
    assert (answer.status, answer.json["px"], answer.json["spread"]) == (200, None, None)
    assert page.get("/api/repeats/next")["id"] != due["id"]


def test_evaluate_shows_the_spread_beside_the_networks_error(bendtrack, trained_project) -> None:
    notes = trained_project.labels_dir / "arm" / "bendtrack-notes.json"
    label = {"base_1": [12.0, 22.0], "base_2": [30.0, 22.0], "tip_1": [46.0, 22.0], "tip_2": [64.0, 22.0]}
    repeat = {"label": label, "points": shifted(label, (0.6, 0.8))}
    notes.write_text(
        json.dumps({"format": "bendtrack-notes-1", "images": {"img00000.png": {"repeat": repeat}}})
    )
    ran = bendtrack("evaluate", trained_project.root)
    assert (ran.status, ran.err) == (0, "")
    assert "from 4 points in 1 frames that were labelled twice: 0.50 px [" in " ".join(ran.out.split())
    written = json.loads((trained_project.models_dir / "model" / "evaluation.json").read_text())
    assert written["labeller_spread"]["px"] == 0.5
    notes.unlink()
    assert "labelled twice" not in bendtrack("evaluate", trained_project.root).out
    assert not (trained_project.root / ".bendtrack").exists()
