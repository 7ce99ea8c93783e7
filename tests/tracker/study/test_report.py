"""The report of a small study: complete, self-contained, escaped whatever things are called, and never a crash."""

from __future__ import annotations

import base64
import hashlib
import re
from functools import cache
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest
import tomlkit

from bendtrack.tracker.errors import ResultsError
from bendtrack.tracker.study.analysis import StudyResults, analyse_study
from bendtrack.tracker.study.report import write_report
from bendtrack.tracker.study.study_file import Study, read_study
from bendtrack.tracker.study.trial import Kind, Shift, TrialData
from bendtrack.tracker.synthetic.cycling import CyclingTrial
from bendtrack.tracker.synthetic.stairs import StaircaseTrial

HOSTILE = '<script>alert("x")</script> & $5_{a}^b\\ %s {0} ../up\n'
VOID = {"meta", "link", "img", "br", "hr", "input", "source"}


def recorded(
    name: str, design: str, source: CyclingTrial | StaircaseTrial, seed: int, pressure_kpa: float | None
) -> TrialData:
    """A trial of exact truth with noise on the angle, camera and log on one clock."""
    log_time_s = np.arange(int(source.duration_s * 100)) / 100
    time_s = np.arange(int(source.duration_s * 30)) / 30
    pressure = source.pressure_kpa(time_s)
    cycling = isinstance(source, CyclingTrial)
    model_kpa = None if cycling else np.linspace(0, 60, 30)
    return TrialData(
        name=name,
        design=design,
        kind=Kind.DYNAMIC if cycling else Kind.STATIC,
        frequency_hz=source.frequency_hz if cycling else None,
        pressure_pp_kpa=pressure_kpa,
        time_s=time_s,
        angle_deg=source.angle_deg(time_s) + np.random.default_rng(seed).normal(0, 0.3, len(time_s)),
        angle_sd_deg=np.full(len(time_s), 0.3),
        pressure_kpa=pressure,
        pressure_rate_kpa_s=np.gradient(pressure, time_s),
        log_time_s=log_time_s,
        log_pressure_kpa=source.pressure_kpa(log_time_s),
        log_reference_kpa=source.reference_kpa(log_time_s),
        model_pressure_kpa=model_kpa,
        model_angle_deg=None if model_kpa is None else 2 * model_kpa,
        shift=Shift(0.0, 0.005, "given delay"),
        warnings=(f"a warning of {name}",),
        provenance={"log": {"name": f"{name}.csv", "sha256": "ab" * 32}},
    )


def study_of(folder: Path, trials: list[TrialData], title: str = "A study") -> Study:
    entries = [
        {"name": t.name, "design": t.design, "kind": str(t.kind), "log": "log.csv", "angles": f"{number}.csv"}
        for number, t in enumerate(trials)
    ]
    path = folder / "study.toml"
    path.write_text(tomlkit.dumps({"title": title, "trials": entries}), encoding="utf-8")
    return read_study(path)


@cache
def make_trials(suffix: str = "") -> list[TrialData]:
    """Two designs at two pressures and one frequency, one staircase, one trial whose pump stood still."""
    trials = []
    for design, gain, ratio in (("original", 1.0, 0.30), (f"new{suffix}", 1.1, 0.20)):
        for pressure in (40.0, 50.0):
            source = CyclingTrial(0.5, pressure, gain * 2.02 * pressure, ratio, cycles=5, lag_s=0.02)
            seed = len(trials)
            trials.append(recorded(f"{design} {pressure:g}{suffix}", design, source, seed, pressure))
    trials.append(recorded(f"stairs{suffix}", "original", StaircaseTrial(100.0, hold_s=3.0), 9, None))
    still = recorded(f"still{suffix}", "original", CyclingTrial(0.5, 40.0, 80.0, 0.3, cycles=3), 10, 40.0)
    flat = {"pressure_kpa": np.full_like(still.pressure_kpa, 3.0)}
    flat["log_pressure_kpa"] = np.full_like(still.log_pressure_kpa, 3.0)
    trials.append(TrialData(**{**still.__dict__, **flat}))
    return trials


class Page(HTMLParser):
    """What a browser would see of a page: tags with attributes, ids, text; tags left open are an error."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text: list[str] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not self.open or self.open[-1] != "style":
            self.text.append(data)

    def values(self, attribute: str) -> list[str]:
        return [str(attrs[attribute]) for _, attrs in self.tags if attribute in attrs]

    @property
    def words(self) -> str:
        return " ".join("".join(self.text).split())


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> tuple[Path, StudyResults, list[TrialData], Study]:
    folder = tmp_path_factory.mktemp("study")
    trials = make_trials(HOSTILE)
    study = study_of(folder, trials, title=f"Title {HOSTILE}")
    results = analyse_study(trials, baseline=study.baseline)
    assert write_report(results, trials, study, folder / "out") == folder / "out" / "report.html"
    return folder, results, trials, study


def test_page_asks_for_nothing_from_elsewhere(written):
    text = (written[0] / "out" / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert {tag for tag, _ in page.tags} & {
        "script",
        "link",
        "iframe",
        "object",
        "embed",
        "form",
        "base",
    } == set()
    assert all(source.startswith("data:image/png;base64,") for source in page.values("src"))
    assert all(target.startswith("#") for target in page.values("href"))
    assert not [name for _, attrs in page.tags for name in attrs if name.startswith("on")]
    style = text[text.index("<style>") : text.index("</style>")]
    assert "url(" not in style
    assert "@import" not in style
    policy = next(a["content"] for t, a in page.tags if t == "meta" and "http-equiv" in a)
    assert policy.startswith("default-src 'none'")


def test_hostile_names_are_only_text(written):
    page = Page((written[0] / "out" / "report.html").read_text(encoding="utf-8"))
    shown = " ".join(HOSTILE.split())
    assert f"Title {shown}" in page.words
    assert f"a warning of stairs{shown}" in page.words
    assert f"new{shown} has a hysteresis ratio of" in page.words


def test_contents_lead_somewhere_and_ids_are_unique(written):
    page = Page((written[0] / "out" / "report.html").read_text(encoding="utf-8"))
    ids = page.values("id")
    assert len(ids) == len(set(ids))
    targets = [target[1:] for target in page.values("href")]
    assert len(targets) > 8
    assert set(targets) <= set(ids)


def test_every_picture_and_figure_file_is_one(written):
    folder, _, trials, _ = written
    page = Page((folder / "out" / "report.html").read_text(encoding="utf-8"))
    images = [base64.b64decode(source.partition(",")[2], validate=True) for source in page.values("src")]
    assert len(images) == 7 + len(trials)
    for image in images:
        assert cv2.imdecode(np.frombuffer(image, np.uint8), cv2.IMREAD_COLOR).std() > 5
    assert all(len(alt) > 20 for alt in page.values("alt"))
    figures = folder / "out" / "figures"
    families = (
        "bars",
        "control_tracking",
        "leaf",
        "leaves",
        "ratio_against_angle",
        "static_curves",
        "time_series",
    )
    names = [figures / name for name in families]
    names += sorted({path.with_suffix("") for path in (figures / "trials").glob("*.pdf")})
    assert len(names) == 7 + len(trials)
    for name in names:
        assert name.with_name(f"{name.name}.pdf").read_bytes().startswith(b"%PDF-")
        assert cv2.imread(str(name.with_name(f"{name.name}.png"))) is not None


def test_nothing_is_written_outside_nor_left_behind(written):
    folder = written[0]
    assert sorted(path.name for path in folder.iterdir()) == ["out", "study.toml"]
    files = [path for path in (folder / "out").rglob("*") if path.is_file()]
    assert {path.suffix for path in files} == {".html", ".pdf", ".png", ".csv", ".tex"}
    assert not [path for path in files if path.name.startswith(".")]


def test_summary_says_what_the_numbers_say(written):
    folder, results, *_ = written
    words = Page((folder / "out" / "report.html").read_text(encoding="utf-8")).words
    # The truth is a ratio of 0.30 and 0.20 at every angle; the angle compared at is the largest that both reach.
    found = re.search(
        r"At 100° and 0\.5 Hz, .*? has a hysteresis ratio of (0\.\d+) ± (0\.\d+) and original one of (0\.\d+) ±",
        words,
    )
    assert found is not None
    assert float(found[1]) == pytest.approx(0.20, abs=0.01)
    assert float(found[3]) == pytest.approx(0.30, abs=0.01)
    assert re.search(r"an improvement of 3[0-9]\.\d ± \d+\.\d %", words)
    assert "bends furthest at 40 and 50 kPa" in words
    furthest = re.search(
        r"to (\d+\.\d) ± \d\.\d° at 50 kPa; that is (?:10|10 to 11|9 to 10|9 to 11) % more than original",
        words,
    )
    assert furthest is not None
    assert float(furthest[1]) == pytest.approx(1.1 * 2.02 * 50, abs=1)
    assert "No hysteresis ratio could be given for still" in words
    assert f"{len(results.warnings)} warnings in {len(written[2])} trials" in words
    assert "0 of 0" in words  # cycles of the pump that stood still


def test_provenance_names_files_and_versions(written):
    folder, *_, study = written
    words = Page((folder / "out" / "report.html").read_text(encoding="utf-8")).words
    assert hashlib.sha256(study.path.read_bytes()).hexdigest() in words
    assert "ab" * 32 in words
    assert re.search(r"numpy \d+\.\d+", words)
    assert str(folder) not in words


@pytest.mark.parametrize(
    "kept",
    [slice(0, 1), slice(2, 3), slice(4, 5), slice(5, 6)],
    ids=["one trial", "no baseline", "static only", "nothing measured"],
)
def test_little_data_makes_a_short_report_not_a_crash(tmp_path, kept):
    trials = make_trials()[kept]
    study = study_of(tmp_path, trials)
    results = analyse_study(trials, baseline=study.baseline)
    page = Page(write_report(results, trials, study, tmp_path / "out").read_text(encoding="utf-8"))
    assert len(page.values("src")) >= 1
    assert f"a warning of {trials[0].name}" in page.words


def test_other_processes_draw_the_same(tmp_path):
    trials = make_trials()[:2]
    study = study_of(tmp_path, trials)
    results = analyse_study(trials, baseline=study.baseline)
    write_report(results, trials, study, tmp_path / "alone")
    write_report(results, trials, study, tmp_path / "helped", workers=1)
    files = sorted(path.relative_to(tmp_path / "alone") for path in (tmp_path / "alone").rglob("*.*"))
    assert len(files) > 10
    for path in files:
        assert (tmp_path / "alone" / path).read_bytes() == (tmp_path / "helped" / path).read_bytes(), path


def test_a_folder_that_cannot_be_written_is_a_clear_error(tmp_path):
    trials = make_trials()[:1]
    study = study_of(tmp_path, trials)
    results = analyse_study(trials, baseline=study.baseline)
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultsError, match="cannot be written"):
        write_report(results, trials, study, tmp_path / "file" / "out")
