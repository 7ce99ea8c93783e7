"""Mutated files of every format that bendtrack reads: each gives a result or one line, never anything else.

    python benchmarks/fuzz.py --minutes 60              # new mutations for an hour, all formats in turn
    python benchmarks/fuzz.py --minutes 1 --only coco   # one format
    python benchmarks/fuzz.py --corpus                  # only what failed before, in tests/fuzz/corpus/

Another exception, a read of more than `SLOW_S`, or more than `MEMORY_MB` is a failure: its file is written to --keep,
from where it belongs into tests/fuzz/corpus/<format>/. The seed makes a run repeatable. Exit status 1: some failed.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import pickle
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import cv2
import h5py
import numpy as np
from scipy.io import savemat

from bendtrack.labeling.checks import check_labels
from bendtrack.labeling.interop.formats import open_labels
from bendtrack.labeling.interop.importing import import_source, project_of
from bendtrack.labeling.journal import Journal
from bendtrack.labeling.notes_file import read_notes
from bendtrack.labeling.store import LabelStore, image_size_wh
from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.bookkeeping import choose_stem, is_recorded, is_up_to_date
from bendtrack.tracker.errors import BendtrackError
from bendtrack.tracker.project import Project
from bendtrack.tracker.results import AngleTable, read_results, write_results
from bendtrack.tracker.study.angle_input import read_angles
from bendtrack.tracker.study.first_study import first_study_file
from bendtrack.tracker.study.model_curve import read_model_curve
from bendtrack.tracker.study.pressure_log import read_pressure_log
from bendtrack.tracker.study.study_file import read_study
from bendtrack.tracker.study.trial_data import load_trial

SLOW_S = 5
"""Seconds that the reading of one small file may take."""
MEMORY_MB = 1500
"""Memory of the process beyond what it has at the start; the limits of `hdf5_files` and `image_files` lie below."""
CORPUS = Path(__file__).parents[1] / "tests" / "fuzz" / "corpus"

KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")


class Slow(BaseException):
    """A read that takes too long; not an Exception, so that no reader takes it for a damaged file."""


@dataclass(frozen=True)
class Format:
    """A kind of file: a sound one, and what reads it.

    Attributes
    ----------
    name : str
        Path of the file in the folder that it is read in.
    make : callable
        Writes the sound file, and what belongs to it, into an empty folder.
    read : callable
        Reads the file; takes its path.
    """

    name: str
    make: Callable[[Path], object]
    read: Callable[[Path], object]


# --- sound files -----------------------------------------------------------------------------------------


def _table() -> AngleTable:
    t, k = 12, len(KEYPOINTS)
    rng = np.random.default_rng(0)
    flag = np.array([""] * 10 + ["low_likelihood", "undecodable"])
    provenance = {"bendtrack": "0.1", "video": {"name": "a.mp4", "sha256": "0" * 64}, "warnings": ["one"]}
    return AngleTable(
        time_s=np.arange(t) / 30,
        angle_deg=rng.random(t) * 90,
        angle_sd_deg=np.full(t, 0.4),
        flag=flag,
        xy=rng.random((t, k, 2)) * 90,
        likelihood=rng.random((t, k)),
        covariance=rng.random((t, k, 2, 2)),
        keypoints=KEYPOINTS,
        definition=AngleDefinition("two-vector", KEYPOINTS),
        provenance=provenance,
    )


def _results(folder: Path) -> None:
    write_results(_table(), folder, "a")


def _rows(header: str, count: int = 60) -> str:
    lines = [f"{n / 10:.3f},{20 - abs(20 - n % 40):.3f},{90 * n / count:.3f}" for n in range(count)]
    return "\n".join([header, *(line.rsplit(",", 3 - header.count(",") - 1)[0] for line in lines)]) + "\n"


def _write(name: str, text: str) -> Callable[[Path], object]:
    def write(folder: Path) -> None:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")

    return write


def _image(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    data = np.random.default_rng(1).integers(0, 255, (12, 16, 3), dtype=np.uint8)
    path.write_bytes(cv2.imencode(path.suffix, data)[1].tobytes())


_LABELS = (
    "scorer,,,anna,anna,anna,anna\nbodyparts,,,base_1,base_1,tip_1,tip_1\ncoords,,,x,y,x,y\n"
    "labeled-data,arm,img00001.png,1.5,2.5,7.25,8\nlabeled-data,arm,img00002.png,1,2,,\n"
)
_CONFIG = """Task: arm
scorer: anna
date: Nov3
multianimalproject: false
project_path: /somewhere
video_sets:
  videos/arm.mp4:
    crop: 0, 16, 0, 12
bodyparts: [base_1, tip_1]
skeleton:
- [base_1, tip_1]
start: 0
pcutoff: 0.6
TrainingFraction: [0.95]
"""


def _dlc(folder: Path) -> None:
    _write("config.yaml", _CONFIG)(folder)
    _write("labeled-data/arm/CollectedData_anna.csv", _LABELS)(folder)
    for number in (1, 2):
        _image(folder / f"labeled-data/arm/img{number:05d}.png")


def _dlc_table_h5(folder: Path) -> None:
    columns = [("anna", part, coord) for part in ("base_1", "tip_1") for coord in ("x", "y")]
    rows = np.zeros(2, np.dtype([("index", "S29"), ("values_block_0", "f8", (4,))]))
    rows["index"] = [f"labeled-data/arm/img{number:05d}.png".encode() for number in (1, 2)]
    rows["values_block_0"] = [[1.5, 2.5, 7, 8], [1, 2, np.nan, np.nan]]
    with h5py.File(folder / "CollectedData_anna.h5", "w") as file:
        group = file.create_group("df_with_missing")
        for name, value in {
            "pandas_type": b"frame_table",
            "encoding": b"UTF-8",
            "non_index_axes": pickle.dumps([(1, columns)], 0),
            "info": pickle.dumps({1: {"names": ["scorer", "bodyparts", "coords"]}}, 0),
        }.items():
            group.attrs[name] = np.bytes_(value)
        table = group.create_dataset("table", data=rows)
        table.attrs["index_kind"] = np.bytes_(b"string")
        table.attrs["values_block_0_kind"] = np.bytes_(pickle.dumps(columns, 0))


def _dlc_fixed_h5(folder: Path) -> None:
    columns = [("anna", part, coord) for part in ("base_1", "tip_1") for coord in ("x", "y")]
    axes = {
        "axis0": (columns, ("scorer", "bodyparts", "coords")),
        "block0_items": (columns, ("scorer", "bodyparts", "coords")),
        "axis1": ([("labeled-data", "arm", f"img{n:05d}.png") for n in (1, 2)], ("N.", "N.", "N.")),
    }
    with h5py.File(folder / "CollectedData_anna.h5", "w") as file:
        group = file.create_group("df_with_missing")
        group.attrs["pandas_type"], group.attrs["encoding"] = np.bytes_(b"frame"), np.bytes_(b"UTF-8")
        group.attrs["nblocks"] = 1
        for axis, (labels, names) in axes.items():
            group.attrs[f"{axis}_variety"], group.attrs[f"{axis}_nlevels"] = np.bytes_(b"multi"), len(names)
            for number, (parts, name) in enumerate(zip(zip(*labels, strict=True), names, strict=True)):
                levels = sorted(set(parts))
                level = group.create_dataset(f"{axis}_level{number}", data=np.array(levels, "S"))
                level.attrs["kind"], level.attrs["name"] = np.bytes_(b"string"), np.bytes_(name.encode())
                group[f"{axis}_label{number}"] = np.array([levels.index(part) for part in parts], np.int8)
        values = group.create_dataset(
            "block0_values", data=np.array([[1.5, 2.5, 7, 8], [1, 2, np.nan, np.nan]])
        )
        values.attrs["transposed"] = np.uint8(1)


def _coco(folder: Path) -> None:
    document = {
        "images": [{"id": n, "file_name": f"arm/img{n:05d}.png", "width": 16, "height": 12} for n in (1, 2)],
        "annotations": [
            {
                "id": n,
                "image_id": n,
                "category_id": 1,
                "keypoints": [1.5, 2, 2, 7, 8.25, 2],
                "num_keypoints": 2,
            }
            for n in (1, 2)
        ],
        "categories": [{"id": 1, "name": "arm", "supercategory": "", "keypoints": ["base_1", "tip_1"]}],
    }
    (folder / "labels.json").write_text(json.dumps(document, indent=1))
    for number in (1, 2):
        _image(folder / f"arm/img{number:05d}.png")


def _lightning_pose(folder: Path) -> None:
    text = (
        "scorer,anna,anna,anna,anna,anna,anna\nbodyparts,base_1,base_1,base_1,tip_1,tip_1,tip_1\n"
        "coords,x,y,visible,x,y,visible\nlabeled-data/arm/img00001.png,1,2,2,7,8,1\n"
    )
    _write("CollectedData.csv", text)(folder)
    _image(folder / "labeled-data/arm/img00001.png")


def _project(folder: Path) -> None:
    project = Project.create(folder / "project", keypoints=KEYPOINTS)
    for number in (1, 2):
        _image(project.labels_dir / "arm" / f"img{number:05d}.png")
    LabelStore.of(project).write(
        "arm", {f"img{n:05d}.png": np.array([[1, 2], [3, 4], [5, 6], [7.5 + n, 8]]) for n in (1, 2)}
    )
    entry = {"not_visible": ["tip_1"], "note": "ä", "flagged": True, "repeat": {"points": {"tip_1": [1, 2]}}}
    notes = {"format": "bendtrack-notes-1", "images": {"img00001.png": entry}}
    (project.labels_dir / "arm" / "bendtrack-notes.json").write_text(json.dumps(notes))


_STATE = {
    "points": {"tip_1": [1.5, 2]},
    "not_visible": ["tip_2"],
    "note": "",
    "flagged": False,
    "skipped": False,
}
_EDIT = {
    "edit_id": "e1",
    "client": "anna",
    "video": "arm",
    "image": "i.png",
    "before": _STATE,
    "after": _STATE,
}
_JOURNAL = "".join(
    json.dumps(record) + "\n"
    for record in (
        {"do": "edit", **_EDIT},
        {"done": "e1"},
        {"do": "undo", **_EDIT, "edit_id": "e2", "of": "e1"},
        {"done": "e2"},
        {"passed": "redo", "edit_id": "e3", "client": "anna", "of": "e1"},
    )
)
_STUDY = """title = "Study"
baseline = "original"
keep_flagged = ["low_likelihood"]
compare_angles_deg = [40, 60.5]
[log_format]
pressure_unit = "kPa"
[sync]
method = "shared clock"
video_start = 2024-01-01T00:00:00Z
[designs.original]
label = "as it was"
colour = "#ff0000"
[[trials]]
design = "original"
kind = "dynamic"
frequency_hz = 0.25
pressure_pp_kpa = 20.0
angles = "a.csv"
log = "log.csv"
model = "model.csv"
"""


def _study(folder: Path) -> None:
    _write("study.toml", _STUDY)(folder)
    _write("log.csv", _rows("time_s,pressure_kpa"))(folder)
    _write("a.csv", _rows("time_s,unused,angle_deg"))(folder)
    _write("model.csv", "pressure_kpa,angle_deg\n0,0\n10,20\n20,45\n")(folder)


def _mat5(folder: Path) -> None:
    time_s = np.arange(60) / 10
    signals = {"values": 20 - np.abs(20 - np.arange(60.0) % 40), "label": "pressure_kpa"}
    savemat(
        folder / "log.mat", {"out": {"time": time_s, "signals": signals}, "note": "x"}, do_compression=True
    )


def _mat73(folder: Path) -> None:
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", userblock_size=512) as file:
        group = file.create_group("out")
        group["time_s"], group["pressure_kpa"] = np.arange(60.0)[None] / 10, np.arange(60.0)[None]
        cells = group.create_dataset("cell", (1, 1), h5py.ref_dtype)
        cells[0, 0] = group["time_s"].ref
    header = b"MATLAB 7.3 MAT-file".ljust(512, b"\0")
    (folder / "log.mat").write_bytes(header + buffer.getvalue()[512:])


# --- readers ---------------------------------------------------------------------------------------------


def _read_table(path: Path) -> None:
    """As `analyze`, `track` and the page do."""
    folder = path.parent
    for use in (lambda: read_results(path), lambda: read_angles(path)):
        _allowed(use)
    is_up_to_date(folder, "a", "0" * 64, {}, None)
    choose_stem(folder, Path("a.mp4"), "1" * 64)
    is_recorded(folder, "a", folder / "a.png")


def _import(label_format: str) -> Callable[[Path], object]:
    def read(path: Path) -> None:
        where = (
            path if path.suffix in (".json", ".h5") or label_format == "lightning-pose" else path.parents[0]
        )
        where = (
            where.parents[1]
            if path.name.startswith("CollectedData") and label_format == "dlc-folder"
            else where
        )
        found = open_labels(where, label_format.removesuffix("-folder"))
        folder = path.parents[len(path.parents) - 1 - _DEPTH]
        _allowed(lambda: project_of(folder / "made", found))
        import_source(found, Project.create(folder / "new", keypoints=KEYPOINTS))

    return read


def _read_project(path: Path) -> None:
    root = next(parent for parent in path.parents if parent.name == "project")
    project = Project.open(root)
    LabelStore.of(project).read()
    read_notes(project.labels_dir / "arm")
    check_labels(project)
    project.assign_actuator("original", ["arm"])


def _read_study(path: Path) -> None:
    study = read_study(path)
    for trial in study.trials:
        _allowed(lambda settings=trial: load_trial(study, settings))


def _read_log(path: Path) -> None:
    _allowed(lambda: read_pressure_log(path))
    _allowed(lambda: first_study_file(path.parent))


FORMATS: dict[str, Format] = {
    "results-csv": Format("a.csv", _results, _read_table),
    "results-h5": Format("a.h5", _results, _read_table),
    "results-json": Format("a.json", _results, _read_table),
    "angle-table": Format("a.csv", _write("a.csv", _rows("time_s,unused,angle_deg")), read_angles),
    "log-csv": Format("log.csv", _write("log.csv", _rows("Time (s),P [kPa]")), _read_log),
    "log-dates": Format(
        "log.csv",
        _write(
            "log.csv", "date;p_kpa\n" + "".join(f"01.02.2024 10:00:{s:02d},5;{s},25\n" for s in range(30))
        ),
        _read_log,
    ),
    "log-mat5": Format("log.mat", _mat5, _read_log),
    "log-mat73": Format("log.mat", _mat73, _read_log),
    "model-curve": Format("m.csv", _write("m.csv", "pressure_kpa,angle_deg\n0,0\n10,20\n"), read_model_curve),
    "study-toml": Format("study.toml", _study, _read_study),
    "project-toml": Format("project/bendtrack.toml", _project, _read_project),
    "labels-csv": Format("project/labeled-data/arm/CollectedData_bendtrack.csv", _project, _read_project),
    "notes": Format("project/labeled-data/arm/bendtrack-notes.json", _project, _read_project),
    "image": Format("project/labeled-data/arm/img00001.png", _project, _read_project),
    "tiff": Format("a.tif", lambda folder: _image(folder / "a.tif"), image_size_wh),
    "jpeg": Format("a.jpg", lambda folder: _image(folder / "a.jpg"), image_size_wh),
    "journal": Format(
        "journal.jsonl", _write("journal.jsonl", _JOURNAL), lambda path: Journal(path).catch_up()
    ),
    "dlc-config": Format("config.yaml", _dlc, _import("dlc-folder")),
    "dlc-csv": Format("labeled-data/arm/CollectedData_anna.csv", _dlc, _import("dlc-folder")),
    "dlc-h5-fixed": Format("CollectedData_anna.h5", _dlc_fixed_h5, _import("dlc")),
    "dlc-h5-table": Format("CollectedData_anna.h5", _dlc_table_h5, _import("dlc")),
    "coco": Format("labels.json", _coco, _import("coco")),
    "lightning-pose": Format("CollectedData.csv", _lightning_pose, _import("lightning-pose")),
}
"""Every format; SLEAP's files are read by sleap-io after `hdf5_files` has checked them."""

# --- mutations -------------------------------------------------------------------------------------------

_TOKENS = (
    *(b"\0", b"\xff", b"\xef\xbb\xbf", b"\r\n", b"\n\n", b"=1+1", b"'", b'"', b"\\u0000", b"\\ud800", b"../", b"/"),
    *(b"nan", b"NaN", b"inf", b"1e999", b"-1", b"1e308", b"9" * 400, b"9" * 5000, b"3024-01-01", b"0001-01-01T00:00Z"),
    *(b"[" * 3000, b"{" * 3000, b"(" * 500, b"null", b"true", b"[]", b"{}", b"[1]", b"{'a': 1}", b'{"a": [1]}', b'""'),
    *(b",", b";", b"\t", b":", b"x" * 200_000, b"&a ", b"*a", b"<<: ", b"!!python/name:os.system", b"- ", b"%", b"#"),
)  # fmt: skip
_BYTES = (0, 1, 0x7F, 0x80, 0xFF)


def mutated(data: bytes, rng: random.Random) -> bytes:
    """Return the file with one to six changes."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        place = rng.randrange(len(out) + 1)
        length = min(rng.choice((1, 2, 4, 8, 30, 200)), len(out) - place)
        kind = rng.randrange(9)
        if kind == 0 and length:
            out[place] ^= 1 << rng.randrange(8)
        elif kind == 1 and length:
            out[place] = rng.choice(_BYTES)
        elif kind == 2:
            del out[place : place + length]
        elif kind == 3:
            out[place:place] = out[place : place + length] * rng.choice((1, 2, 50))
        elif kind == 4:
            out[place:place] = rng.choice(_TOKENS)
        elif kind == 5:
            out[place : place + length] = rng.randbytes(length)
        elif kind == 6:
            del out[place:]
        else:
            _replace_value(out, rng)
    return bytes(out)


def _replace_value(out: bytearray, rng: random.Random) -> None:
    """Replace a number, a word or a quoted text by a token, or swap it with another one of the file."""
    found = list(re.finditer(rb'"[^"\n]{0,60}"|[\w.+-]+', out[: 2**16]))
    if found:
        one, other = rng.choice(found), rng.choice(found)
        out[one.start() : one.end()] = rng.choice((rng.choice(_TOKENS), other.group()))


# --- running ---------------------------------------------------------------------------------------------

_DEPTH = 0  # parts of the folder that a format is read in; set by `main`


def _allowed(use: Callable[[], object]) -> None:
    """Run a reader; an error in one line is as good as a result."""
    try:
        use()
    except BendtrackError as error:
        if "\n" in str(error):
            raise AssertionError(f"a message of several lines: {error}") from error
    except OSError as error:
        if error.errno is None:  # a library's, not the system's
            raise


def _alarm(signum: int, frame: FrameType | None) -> None:
    raise Slow


@contextmanager
def _limited(seconds: float) -> Iterator[None]:
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)


def run_one(format_: Format, folder: Path, data: bytes) -> str | None:
    """Read one file.

    Returns
    -------
    str or None
        What went wrong; None for a result or an error in one line.
    """
    for made in ("made", "new"):
        shutil.rmtree(folder / made, ignore_errors=True)
    path = folder / format_.name
    path.write_bytes(data)
    try:
        with _limited(SLOW_S):
            _allowed(lambda: format_.read(path))
    except Slow:
        return f"took more than {SLOW_S} s"
    except MemoryError:
        return f"asked for more than {MEMORY_MB} MB"
    except Exception as error:
        places = [
            frame for frame in traceback.extract_tb(error.__traceback__) if "fuzz.py" not in frame.filename
        ]
        own = [frame for frame in places if "site-packages" not in frame.filename] or places
        where = f"{Path(own[-1].filename).name}:{own[-1].lineno}" if own else "?"
        return f"{type(error).__name__} at {where}: {str(error)[:100]!r}"
    return None


@contextmanager
def _sound(format_: Format, scratch: Path) -> Iterator[tuple[Path, bytes]]:
    """Folder with the sound file, and its bytes."""
    global _DEPTH
    folder = Path(tempfile.mkdtemp(dir=scratch))
    _DEPTH = len(folder.parts) - 1
    try:
        format_.make(folder)
        yield folder, (folder / format_.name).read_bytes()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def fuzz(
    names: list[str], seconds: float, seed: int, keep: Path | None, only_corpus: bool = False
) -> tuple[Counter[str], dict[str, list[str]]]:
    """Read the corpus, then mutated files of each format in turn until the time is over.

    Returns
    -------
    tried : Counter
        Files read of each format.
    failures : dict of str to list of str
        Format -> distinct failures.
    """
    tried: Counter[str] = Counter()
    failures: dict[str, list[str]] = {}
    scratch = Path(tempfile.mkdtemp(dir="/dev/shm" if os.path.isdir("/dev/shm") else None))
    started = time.monotonic()
    try:
        for number, name in enumerate(names):
            format_, rng = FORMATS[name], random.Random(f"{seed} {name}")
            with _sound(format_, scratch) as (folder, data):
                format_.read(folder / format_.name)  # the sound file is read without an error
                inputs = iter(sorted((CORPUS / name).glob("*")))
                until = started + seconds * (number + 1) / len(names)
                while True:
                    kept = next(inputs, None)
                    if kept is None and (only_corpus or time.monotonic() > until):
                        break
                    current = kept.read_bytes() if kept is not None else mutated(data, rng)
                    problem = run_one(format_, folder, current)
                    tried[name] += 1
                    if problem is not None and problem not in failures.setdefault(name, []):
                        failures[name].append(problem)
                        print(
                            f"{name}: {kept.name if kept else f'number {tried[name]}'}: {problem}", flush=True
                        )
                        if keep is not None:
                            (keep / name).mkdir(parents=True, exist_ok=True)
                            (keep / name / f"{seed}-{tried[name]}").write_bytes(current)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return tried, {name: problems for name, problems in failures.items() if problems}


def main() -> int:
    """Run from the command line; return the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--only", action="append", choices=sorted(FORMATS))
    parser.add_argument("--corpus", action="store_true")
    parser.add_argument("--keep", type=Path)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    with open("/proc/self/statm", encoding="ascii") as file:
        now = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + MEMORY_MB * 2**20, resource.RLIM_INFINITY))
    signal.signal(signal.SIGALRM, _alarm)
    names = options.only or list(FORMATS)
    tried, failures = fuzz(names, 60 * options.minutes, options.seed, options.keep, options.corpus)
    n_failures = sum(map(len, failures.values()))
    for name in names:
        print(f"{name:15} {tried[name]:7} tried, {len(failures.get(name, []))} kinds of failures")
    print(f"{sum(tried.values())} files, {n_failures} kinds of failures (seed {options.seed})")
    return 1 if n_failures else 0


if __name__ == "__main__":
    sys.exit(main())
