"""Figures of a study: what they show is what the data say, and the files are what a publisher takes."""

from __future__ import annotations

import re
import resource
import subprocess
import sys

import cv2
import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.patches import Rectangle
from matplotlib.text import Annotation

from bendtrack.tracker.errors import ResultsError
from bendtrack.tracker.study.designs import STUDY_COLOURS
from bendtrack.tracker.study.plots.bars import bars_figure
from bendtrack.tracker.study.plots.control_tracking import control_figure
from bendtrack.tracker.study.plots.figure_set import file_names
from bendtrack.tracker.study.plots.leaf import leaf_figure, mean_loop
from bendtrack.tracker.study.plots.leaf_grid import leaf_grid_figure
from bendtrack.tracker.study.plots.page import decimated, save_figure
from bendtrack.tracker.study.plots.ratio_angle import ratio_angle_figure
from bendtrack.tracker.study.plots.static_curves import static_figure
from bendtrack.tracker.study.plots.styles import design_styles
from bendtrack.tracker.study.plots.time_series import time_series_figure
from bendtrack.tracker.study.plots.trial_sheet import trial_sheet_figure
from bendtrack.tracker.study.trial import Kind, Shift, TrialData

LOOKS = design_styles((name, name, colour) for name, colour in STUDY_COLOURS.items())
RED, PURPLE = LOOKS["original"], LOOKS["mid-width smaller"]


def ellipse(height: float = 100.0, n: int = 200) -> np.ndarray:
    """A loop from (0, 0) to (50, height) and back, angle behind pressure: counter-clockwise."""
    phase = np.linspace(0, 2 * np.pi, n)
    return np.stack([25 - 25 * np.cos(phase), height / 2 * (1 - np.cos(phase - 0.4))], axis=1)


def make_trial(name: str = "a trial", design: str = "original", **changes) -> TrialData:
    time_s = np.arange(300) / 30
    log_time_s = np.arange(4000) / 400
    values = {
        "name": name,
        "design": design,
        "kind": Kind.DYNAMIC,
        "frequency_hz": 0.25,
        "pressure_pp_kpa": 50.0,
        "time_s": time_s,
        "angle_deg": 60 - 60 * np.cos(2 * np.pi * 0.25 * time_s),
        "angle_sd_deg": np.full(300, 0.5),
        "pressure_kpa": 25 - 25 * np.cos(2 * np.pi * 0.25 * time_s),
        "pressure_rate_kpa_s": np.zeros(300),
        "log_time_s": log_time_s,
        "log_pressure_kpa": 25 - 25 * np.cos(2 * np.pi * 0.25 * log_time_s) + 0.5,
        "log_reference_kpa": 25 - 25 * np.cos(2 * np.pi * 0.25 * log_time_s),
        "shift": Shift(0.0, 0.01, "given delay"),
    }
    return TrialData(**(values | changes))


def make_dynamic() -> pd.DataFrame:
    """Two designs, two frequencies, two pressures; the fast trials' intervals are wide."""
    rows = []
    for design, gain in (("original", 1.0), ("mid-width smaller", 2.0)):
        for frequency, half in ((0.0625, 0.004), (0.25, 0.05)):
            for pressure in (40.0, 50.0):
                response, ratio = (
                    gain * pressure * (1 - frequency),
                    0.3 / gain - pressure / 1000 + frequency / 10,
                )
                rows.append(
                    {
                        "trial": f"{design} {frequency} {pressure}",
                        "design": design,
                        "frequency_hz": frequency,
                        "pressure_pp_kpa": pressure,
                        "dynamic_response_deg": response,
                        "dynamic_response_deg_low": response - 1,
                        "dynamic_response_deg_high": response + 1,
                        "hysteresis_ratio": ratio,
                        "hysteresis_ratio_low": ratio - half,
                        "hysteresis_ratio_high": ratio + half,
                    }
                )
    return pd.DataFrame(rows)


def test_nine_designs_are_told_apart_without_colour_and_keep_theirs():
    assert [style.colour for style in LOOKS.values()] == list(STUDY_COLOURS.values())
    assert len({style.marker for style in LOOKS.values()}) == 9
    assert len({(style.marker, str(style.line)) for style in LOOKS.values()}) == 9
    assert len({str(style.line) for style in list(LOOKS.values())[:8]}) == 8


def test_leaf_shows_its_cycles_the_rectangle_to_the_axes_and_the_way_round():
    loops = [ellipse(98), ellipse(100), ellipse(102)]
    figure = leaf_figure(
        loops,
        PURPLE,
        largest_pressure_kpa=51.0,
        largest_angle_deg=104.0,
        apart=[ellipse(90)],
        note="ratio $0.3",
    )
    (axes,) = figure.axes
    (rectangle,) = [patch for patch in axes.patches if type(patch) is Rectangle]
    assert rectangle.get_bbox().extents.tolist() == [0, 0, 51, 104]
    apart, cycles = sorted(
        (c for c in axes.collections if isinstance(c, LineCollection)), key=lambda c: len(c.get_segments())
    )
    assert len(cycles.get_segments()) == 3
    assert len(apart.get_segments()) == 1
    assert to_hex(cycles.get_color()[0]) == PURPLE.colour
    np.testing.assert_array_equal(cycles.get_segments()[1], loops[1])
    assert axes.get_xlabel() == "pressure (kPa)"
    assert axes.get_ylabel() == "bending angle (°)"
    assert axes.get_xlim()[1] > 51
    assert axes.get_ylim()[1] > 104
    assert axes.get_xlim()[0] == axes.get_ylim()[0] == 0
    arrows = {}
    texts = [text for text in axes.texts if isinstance(text, Annotation)]
    for arrow, label in zip(texts[::2], texts[1::2], strict=True):
        (x0, y0), (x1, y1) = arrow.xyann, arrow.xy
        arrows[label.get_text()] = (x1 - x0, y1 - y0)
    assert arrows["loading"][0] > 0
    assert arrows["loading"][1] > 0
    assert arrows["unloading"][0] < 0
    assert arrows["unloading"][1] < 0
    assert "ratio $0.3" in [text.get_text() for text in axes.texts]


def test_leaf_below_zero_is_seen_whole():
    loop = ellipse() - [8, 5]
    (axes,) = leaf_figure([loop], RED, largest_pressure_kpa=float("nan"), largest_angle_deg=95.0).axes
    assert axes.get_xlim()[0] < -7.9
    assert axes.get_ylim()[0] < loop[:, 1].min() + 0.1
    assert not [patch for patch in axes.patches if type(patch) is Rectangle]


def test_mean_loop_is_the_mean_at_equal_phase():
    mean = mean_loop([ellipse(90, 200), ellipse(110, 331)])
    expected = ellipse(100, len(mean))
    np.testing.assert_allclose(mean, expected, atol=0.02)
    gap = ellipse(90)
    gap[50:60] = np.nan
    assert np.isfinite(mean_loop([gap, ellipse(110)])).all()


def test_time_series_keeps_gaps_and_names_units():
    angle_deg = np.full(300, 20.0)
    angle_deg[90:120] = np.nan
    figure = time_series_figure(make_trial(angle_deg=angle_deg), PURPLE)
    angles, pressures = figure.axes
    (line,) = angles.lines
    assert to_hex(line.get_color()) == PURPLE.colour
    assert np.isnan(line.get_ydata()[90:120]).all()
    assert np.isfinite(line.get_ydata()[:90]).all()
    (bar,) = angles.collections
    assert bar.get_paths()[0].get_extents().intervalx == pytest.approx((3.0, 4.0))
    assert angles.get_ylabel() == "bending angle (°)"
    assert pressures.get_ylabel() == "pressure (kPa)"
    assert pressures.get_xlabel() == "time (s)"
    assert [line.get_label() for line in pressures.lines] == ["measured pressure", "reference"]
    assert pressures.lines[0].get_ydata().max() == pytest.approx(50.5)


def test_dense_line_keeps_every_extreme_and_gap():
    rng = np.random.default_rng(0)
    time_s, values = np.arange(50_003) / 400, rng.normal(size=50_003)
    values[20_000:20_400] = np.nan
    values[33_333] = 12.5
    drawn_s, drawn = decimated(time_s, values, 1000)
    assert len(drawn) <= 2 * 1021
    assert (np.diff(drawn_s) >= 0).all()
    assert np.isin(drawn_s[drawn == 12.5], time_s[33_333]).all()
    assert 12.5 in drawn
    assert np.isnan(drawn[(drawn_s > time_s[20_100]) & (drawn_s < time_s[20_300])]).all()
    assert np.nanmin(drawn) == np.nanmin(values)
    few = decimated(time_s[:100], values[:100], 1000)
    assert few[1] is not None
    np.testing.assert_array_equal(few[1], values[:100])


def test_grid_has_a_panel_for_each_frequency_and_pressure():
    dynamic = make_dynamic().drop(index=7)
    loops = {name: [ellipse(50 + 10 * row)] * 3 for row, name in enumerate(dynamic["trial"])}
    figure = leaf_grid_figure(dynamic, loops, LOOKS)
    assert len(figure.axes) == 4
    colours = [[to_hex(colour) for colour in axes.collections[0].get_colors()] for axes in figure.axes]
    assert colours == [[RED.colour] * 3 + [PURPLE.colour] * 3] * 3 + [[RED.colour] * 3]
    segments = figure.axes[0].collections[0].get_segments()
    assert [segment[:, 1].max() for segment in segments] == pytest.approx([50] * 3 + [90] * 3, abs=0.1)
    assert [axes.get_title("center") for axes in figure.axes[:2]] == [
        "40 kPa peak to peak",
        "50 kPa peak to peak",
    ]
    assert figure.axes[0].get_ylabel().startswith("0.0625 Hz")
    assert figure.axes[2].get_ylabel().startswith("0.25 Hz")
    tips = [line.get_ydata()[0] for line in figure.axes[0].lines]
    assert tips == pytest.approx([50, 90], abs=0.5)
    assert [line.get_marker() for line in figure.axes[0].lines] == [RED.marker, PURPLE.marker]
    shown = [text.get_text() for text in figure.legends[0].get_texts()]
    assert shown == ["original", "mid-width smaller"]


def test_bars_have_the_values_and_hold_their_whiskers():
    dynamic = make_dynamic()
    figure = bars_figure(dynamic, LOOKS)
    slow_response, fast_response, slow_ratio, fast_ratio = figure.axes
    for axes, frequency, metric in (
        (slow_response, 0.0625, "dynamic_response_deg"),
        (fast_response, 0.25, "dynamic_response_deg"),
        (slow_ratio, 0.0625, "hysteresis_ratio"),
        (fast_ratio, 0.25, "hysteresis_ratio"),
    ):
        here = dynamic[dynamic["frequency_hz"] == frequency]
        assert [bar.get_height() for bar in axes.patches] == pytest.approx(list(here[metric]))
        assert [to_hex(bar.get_facecolor()) for bar in axes.patches] == [RED.colour] * 2 + [PURPLE.colour] * 2
        middles = [bar.get_x() + bar.get_width() / 2 for bar in axes.patches]
        assert np.round(middles).tolist() == [0, 1, 0, 1]
        assert middles[0] < middles[2]  # the study's order within a pressure
        assert axes.get_ylim()[1] >= here[f"{metric}_high"].max()
        whiskers = [segment for c in axes.containers[1::2] for segment in c.lines[2][0].get_segments()]
        np.testing.assert_allclose(
            [segment[:, 1] for segment in whiskers], here[[f"{metric}_low", f"{metric}_high"]]
        )
        np.testing.assert_allclose([segment[0, 0] for segment in whiskers], middles)
    assert slow_ratio.get_ylim()[1] >= dynamic["hysteresis_ratio_high"].max()
    assert slow_response.get_ylabel() == "dynamic response (°)"
    assert slow_ratio.get_xlabel() == "peak-to-peak pressure (kPa)"


def test_ratio_against_angle_joins_trials_and_marks_the_comparison():
    dynamic = make_dynamic()
    comparison = {
        "frequency_hz": 0.0625,
        "angle_deg": 45.0,
        "baseline": "original",
        "design": "mid-width smaller",
        "baseline_ratio": 0.26,
        "design_ratio": 0.11,
        "improvement": 0.15 / 0.26,
    }
    figure = ratio_angle_figure(dynamic, pd.DataFrame([comparison]), LOOKS)
    slow, fast = figure.axes
    lines = {line.get_label(): line for line in slow.lines if line.get_label() in LOOKS}
    here = dynamic[(dynamic["design"] == "original") & (dynamic["frequency_hz"] == 0.0625)]
    np.testing.assert_allclose(lines["original"].get_xdata(), here["dynamic_response_deg"])
    np.testing.assert_allclose(lines["original"].get_ydata(), here["hysteresis_ratio"])
    assert to_hex(lines["original"].get_color()) == RED.colour
    assert lines["original"].get_linestyle() != lines["mid-width smaller"].get_linestyle()
    circles = [tuple(line.get_xydata()[0]) for line in slow.lines if line.get_markersize() == 6.5]
    assert circles == [(45.0, 0.26), (45.0, 0.11)]
    assert "at 45°: mid-width smaller −57.7\u00a0% against original" in slow.get_title("center")
    assert fast.get_title("center") == "0.25 Hz"
    assert slow.get_xlabel() == "largest bending angle (°)"


def test_a_single_trial_is_not_cut_and_designs_without_a_point_are_not_named():
    dynamic = make_dynamic()
    dynamic.loc[dynamic["design"] != "original", "hysteresis_ratio"] = np.nan
    one = dynamic[(dynamic["design"] != "original") | (dynamic.index == dynamic.index[0])]
    figure = ratio_angle_figure(one, pd.DataFrame(columns=["frequency_hz"]), LOOKS)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["original"]
    figure = ratio_angle_figure(dynamic.iloc[:1], pd.DataFrame(columns=["frequency_hz"]), LOOKS)
    (axes,) = figure.axes
    assert axes.get_xlim()[1] >= 1.05 * dynamic.iloc[0]["dynamic_response_deg"]


def test_the_tip_is_where_it_bends_most_also_where_bending_is_negative():
    dynamic = make_dynamic().iloc[:1]
    loop = ellipse(50)
    loop[:, 1] *= -1
    figure = leaf_grid_figure(dynamic, {dynamic["trial"].iloc[0]: [loop] * 3}, LOOKS)
    (tip,) = figure.axes[0].lines
    assert tip.get_ydata()[0] == pytest.approx(-50, abs=0.5)


def test_static_curves_and_what_is_left():
    model_kpa, model_deg = np.array([0.0, 25.0, 50.0]), np.array([0.0, 30.0, 100.0])
    trial = make_trial(kind=Kind.STATIC, model_pressure_kpa=model_kpa, model_angle_deg=model_deg)
    steps = pd.DataFrame(
        {
            "trial": "a trial",
            "number": [1, 2, 3],
            "pressure_kpa": model_kpa,
            "angle_deg": [1.0, 28.0, 104.0],
            "angle_deg_low": [0.5, 27.5, 103.5],
            "angle_deg_high": [1.5, 28.5, 104.5],
            "model_angle_deg": model_deg,
        }
    )
    angles, residuals = static_figure(steps, [trial], LOOKS).axes
    curves = [line for line in angles.lines if line.get_linestyle() == "--"]
    np.testing.assert_array_equal(curves[0].get_ydata(), model_deg)
    assert to_hex(curves[0].get_color()) == RED.colour
    marks = [line for line in residuals.lines if line.get_marker() == RED.marker]
    np.testing.assert_allclose(marks[0].get_ydata(), [1, -2, 4])
    assert residuals.get_ylabel() == "measured − model (°)"


def test_control_shows_the_error_and_its_rmse():
    figure = control_figure([make_trial()], [0.5])
    waves, errors = figure.axes
    assert waves.get_ylabel() == "pressure (kPa)"
    assert waves.get_title("center") == "0.25 Hz, 50 kPa"
    np.testing.assert_allclose(errors.lines[0].get_ydata(), 0.5, atol=1e-9)
    assert "RMSE 0.5 kPa" in errors.get_title("right")
    assert errors.get_ylim()[1] > 0.5


def test_files_are_what_a_publisher_takes(tmp_path):
    figure = trial_sheet_figure(
        make_trial("größe $5 名"), RED, [ellipse()], largest_pressure_kpa=50, largest_angle_deg=100
    )
    save_figure(figure, tmp_path / "one")
    pdf = (tmp_path / "one.pdf").read_bytes()
    assert pdf.startswith(b"%PDF-")
    assert pdf.rstrip().endswith(b"%%EOF")
    assert b"/FontFile2" in pdf  # TrueType, embedded
    assert b"/Type3" not in pdf
    assert not re.search(rb"/Subtype\s*/Image", pdf)  # vector throughout
    box = re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", pdf)
    assert box is not None
    assert float(box[1]) == pytest.approx(180 / 25.4 * 72, abs=0.5)
    image = cv2.imread(str(tmp_path / "one.png"))
    assert image.shape[1] == pytest.approx(180 / 25.4 * 300, abs=1)
    red = np.array([int(RED.colour[i : i + 2], 16) for i in (5, 3, 1)])
    assert (np.abs(image.astype(int) - red).max(axis=2) < 12).sum() > 1000
    save_figure(figure, tmp_path / "two")
    assert (tmp_path / "two.pdf").read_bytes() == pdf
    assert (tmp_path / "two.png").read_bytes() == (tmp_path / "one.png").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.pdf", "one.png", "two.pdf", "two.png"]


def test_a_sheet_drawn_on_again_is_as_new(tmp_path):
    gap = make_trial("the first", angle_deg=np.where(np.arange(300) % 50 < 9, np.nan, 80.0))
    sides = {"largest_pressure_kpa": 50.0, "largest_angle_deg": 100.0}
    used = trial_sheet_figure(gap, RED, [ellipse() - 9] * 4, apart=[ellipse()], note="ratio", **sides)
    save_figure(used, tmp_path / "first")
    again = trial_sheet_figure(make_trial("the second"), PURPLE, [ellipse(60)], sheet=used, **sides)
    save_figure(again, tmp_path / "again")
    save_figure(
        trial_sheet_figure(make_trial("the second"), PURPLE, [ellipse(60)], **sides), tmp_path / "new"
    )
    for suffix in (".pdf", ".png"):
        assert (tmp_path / f"again{suffix}").read_bytes() == (tmp_path / f"new{suffix}").read_bytes()


def test_a_column_is_88_mm_wide(tmp_path):
    save_figure(
        leaf_figure([ellipse()], RED, largest_pressure_kpa=50, largest_angle_deg=100), tmp_path / "leaf"
    )
    assert cv2.imread(str(tmp_path / "leaf.png")).shape[1] == pytest.approx(88 / 25.4 * 300, abs=1)


def test_unwritable_folder_is_a_clear_error(tmp_path):
    figure = leaf_figure([ellipse()], RED, largest_pressure_kpa=50, largest_angle_deg=100)
    with pytest.raises(ResultsError, match=r"missing/leaf\.pdf: cannot be written"):
        save_figure(figure, tmp_path / "missing" / "leaf")


def test_the_users_own_matplotlib_is_left_alone():
    with mpl.rc_context({"font.size": 33.0, "axes.grid": True}):
        figure = time_series_figure(make_trial(), RED)
        assert mpl.rcParams["font.size"] == 33.0
        assert figure.axes[0].xaxis.label.get_fontsize() == 7.0
    code = (
        "import bendtrack.tracker.study.plots.figure_set, sys; sys.exit('matplotlib.pyplot' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_file_names_are_safe_and_distinct():
    names = ["../../etc/passwd", "a/b", "a:b", "A_B", "", "名", "CON" * 60, ".hidden"]
    found = file_names(names)
    assert list(found) == names
    assert len({stem.casefold() for stem in found.values()}) == len(names)
    for stem in found.values():
        assert re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", stem)
        assert len(stem) < 100


@pytest.mark.parametrize("room", [0, 1000, 6000])
def test_a_figure_on_a_full_disk_is_one_line(tmp_path, room: int) -> None:
    figure = mpl.figure.Figure(figsize=(2, 2))
    figure.subplots().plot([0, 1], [0, 1])
    save_figure(figure, tmp_path / "figure")  # which also finds the fonts
    for path in tmp_path.iterdir():
        path.unlink()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, limits[1]))
    try:
        with pytest.raises(ResultsError, match=r"figure\.pdf: cannot be written \(File too large\)"):
            save_figure(figure, tmp_path / "figure")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not list(tmp_path.iterdir())
