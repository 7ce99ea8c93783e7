"""The figure of angle over time: a PNG that shows gaps and flags, without touching pyplot."""

from __future__ import annotations

import sys

import cv2
import numpy as np
import pytest

from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.errors import ResultsError
from bendtrack.tracker.figures import write_angle_figure
from bendtrack.tracker.results import AngleTable

NAMES = ("base_1", "base_2", "tip_1", "tip_2")


def make_table(flags: dict[int, str], n: int = 200) -> AngleTable:
    time_s = np.arange(n) / 30
    angle_deg = 60 - 60 * np.cos(time_s)
    flag = np.array([flags.get(row, "") for row in range(n)], dtype=object)
    angle_deg[np.isin(flag, ["undecodable", "out_of_frame", "coincident_points"])] = np.nan
    return AngleTable(
        time_s=time_s,
        angle_deg=angle_deg,
        angle_sd_deg=np.where(np.isnan(angle_deg), np.nan, 0.5),
        flag=flag,
        xy=np.zeros((n, 4, 2)),
        likelihood=np.ones((n, 4)),
        covariance=np.zeros((n, 4, 2, 2)),
        keypoints=NAMES,
        definition=AngleDefinition("two-vector", NAMES),
        provenance={"video": {"name": "price $5 & größe_1.mp4"}},
    )


def colour_count(path, rgb: tuple[int, int, int]) -> int:
    image = cv2.imread(str(path))[:, :, ::-1].astype(int)
    return int((np.abs(image - rgb).max(axis=2) < 12).sum())


def test_flagged_rows_show_in_their_colours(tmp_path):
    colours = {
        "low_likelihood": (230, 159, 0),
        "damaged": (204, 121, 167),
        "out_of_frame": (0, 158, 115),
        "coincident_points": (86, 180, 233),
        "undecodable": (213, 94, 0),
    }
    plain = tmp_path / "plain.png"
    write_angle_figure(make_table({}), plain)
    assert cv2.imread(str(plain)).shape == (720, 1440, 3)
    assert colour_count(plain, (0, 114, 178)) > 2000
    for kind, colour in colours.items():
        path = tmp_path / f"{kind}.png"
        write_angle_figure(make_table(dict.fromkeys(range(50, 60), kind)), path)
        assert colour_count(path, colour) > colour_count(plain, colour) + 50


def test_tables_of_every_kind_can_be_drawn(tmp_path):
    everywhere = dict.fromkeys(range(200), "undecodable")
    alternating = dict.fromkeys(range(0, 200, 2), "out_of_frame")
    for table in (
        make_table(everywhere),
        make_table(alternating),
        make_table({}, n=1),
        make_table({0: "new kind"}),
    ):
        write_angle_figure(table, tmp_path / "a.png")
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


def test_a_row_that_is_hardly_known_does_not_flatten_the_curve(tmp_path):
    plain, wild = make_table({}), make_table({100: "low_likelihood"})
    wild.angle_sd_deg[100] = 1e4
    heights = []
    for number, table in enumerate((plain, wild)):
        write_angle_figure(table, tmp_path / f"{number}.png")
        image = cv2.imread(str(tmp_path / f"{number}.png"))[:, :, ::-1].astype(int)
        rows = np.flatnonzero((np.abs(image - (0, 114, 178)).max(axis=2) < 12)[:780].any(axis=1))
        heights.append(np.ptp(rows))
    assert heights[1] > 0.95 * heights[0] > 500


@pytest.mark.parametrize("name", ["弯曲 50kPa.mp4", "a_very_long_name_" * 12 + ".mp4", "$x$ 100% #1\\.mp4"])
def test_any_name_of_a_video_will_do(tmp_path, name):
    table = make_table({})
    table.provenance["video"]["name"] = name
    write_angle_figure(table, tmp_path / "a.png")
    image = cv2.imread(str(tmp_path / "a.png"))
    assert image.shape == (720, 1440, 3)
    assert (image[:, -4:] == 255).all()  # nothing runs out of the image


def test_nothing_of_one_figure_shows_in_the_next(tmp_path):
    """All are drawn on one sheet."""
    plain, empty = make_table({}), make_table({}, n=0)
    for name, table in (("plain", plain), ("empty", empty)):
        write_angle_figure(table, tmp_path / f"{name}.png")
        for flags, n in (({3: "damaged", 40: "undecodable"}, 900), ({0: "out_of_frame"}, 1), ({}, 0)):
            write_angle_figure(make_table(flags, n=n), tmp_path / "other.png")
        write_angle_figure(table, tmp_path / "again.png")
        assert (tmp_path / "again.png").read_bytes() == (tmp_path / f"{name}.png").read_bytes()


def test_pyplot_is_left_alone(tmp_path):
    before = "matplotlib.pyplot" in sys.modules
    write_angle_figure(make_table({}), tmp_path / "a.png")
    assert ("matplotlib.pyplot" in sys.modules) == before


def test_unwritable_place_is_one_line(tmp_path):
    with pytest.raises(ResultsError, match="cannot be written"):
        write_angle_figure(make_table({}), tmp_path / "missing" / "a.png")
