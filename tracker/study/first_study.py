"""A first study file from a folder: files are recognised by content and grouped into trials by name.

Names contain design, frequency and pressure ("original_0.0625Hz_45kPa.csv"); what is missing is left to the
user, in comments. Study files are read by `study_file.py`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

import tomlkit

from ..errors import PressureLogError, StudyError
from ..hdf5_files import open_hdf5
from ..project import SETTINGS_FILE
from ..project_settings import VIDEO_SUFFIXES
from .csv_log import csv_columns
from .designs import DesignSettings, design_colours, known_design
from .log_columns import is_pressure, time_column
from .pressure_log import read_pressure_log

_FREQUENCY = re.compile(r"(?<![\d.])(\d+(?:[.,p]\d+)?)[ _-]?hz(?![a-z])", re.IGNORECASE)
_PRESSURE = re.compile(r"(?<![\d.])(\d+(?:[.,p]\d+)?)[ _-]?kpa(?![a-z])", re.IGNORECASE)
_STATIC = re.compile(r"(?<![a-z])(static|stairs?|staircase|steps?)(?![a-z])", re.IGNORECASE)
# Words for the kind of file, which do not identify the trial.
_KIND_WORDS = re.compile(
    r"(?<![a-z])(angles?|results?|tracks?|tracked|videos?|pressures?|press|logs?|logged|data|dynamic|triangle|"
    r"simulink|matlab|csv|mat|daq|models?|fem|curves?|simulation)(?![a-z])",
    re.IGNORECASE,
)
# Marks of repetitions, which distinguish trials of equal conditions.
_REPEAT = re.compile(
    r"(?<![a-z])(?:rep(?:eat)?|run|trial|take|test|no)[ _-]*\d+|\d{4}-\d\d-\d\d(?:[T_ -]\d\d[-:.]?\d\d(?:[-:.]?\d\d)?)?"
    r"|(?<!\d)20\d{6}(?!\d)|\(\d+\)",
    re.IGNORECASE,
)
_SKIPPED = ("labeled-data", "figures", "tables", "report", "node_modules")
_MAX_FILES = 5000
_WEIGHTS = "weights.safetensors"
"""In the folder of every trained network (`bendtrack.models`)."""


@dataclass
class _TrialFiles:
    """Files of one trial, and the conditions in their names."""

    stem: str
    files: dict[str, str] = field(default_factory=dict)
    design: str = ""
    repeat: str = ""
    frequency_hz: float | None = None
    pressure_pp_kpa: float | None = None
    static: bool = False


def first_study_file(folder: str | Path) -> str:
    """Text of a study file for what is in a folder and its subfolders; paths in it are relative to the folder.

    Angle tables, logs and videos are recognised by content and suffix, grouped by name, and listed as trials
    where there is a log with an angle table or a video. Files without a trial are listed in comments.

    Parameters
    ----------
    folder : str or Path
        The folder.

    Returns
    -------
    str
        TOML with comments.

    Raises
    ------
    StudyError
        Not a folder, or a folder without a trial.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise StudyError(f"expected a folder with logs and angle tables, got {folder}")
    trials: dict[str, _TrialFiles] = {}
    left: list[str] = []
    for path in _files(folder):
        relative = path.relative_to(folder).as_posix()
        kind = _kind(path)
        if kind is None:
            continue
        if kind == "unknown":
            left.append(relative)
            continue
        found = _by_name(relative) or _TrialFiles(stem=_trial_stem(path), design=_trial_stem(path))
        trial = trials.setdefault(_key(found), found)
        known = trial.files.get(kind)
        # The exact .h5 of a table is preferred to its .csv; otherwise a second file of one kind is left out.
        if known is None or (kind == "angles" and _same_table(known, relative)):
            trial.files[kind] = min(relative, known or relative, key=lambda name: not name.endswith(".h5"))
        else:
            left.append(relative)
    whole = [t for t in trials.values() if "log" in t.files and {"angles", "video"} & set(t.files)]
    left += [file for t in trials.values() if t not in whole for file in t.files.values()]
    if not whole:
        raise StudyError(_why_none(folder, list(trials.values()), left))
    whole.sort(key=lambda t: (t.design, t.frequency_hz or 0, t.pressure_pp_kpa or 0, t.stem))
    return _text(folder, whole, sorted(left))


def _why_none(folder: Path, trials: list[_TrialFiles], left: list[str]) -> str:
    """Why there is no trial, and what to do next."""
    found = f"{', '.join(left[:5]) or 'neither'}{', ...' if len(left) > 5 else ''}"
    said = (
        f"{folder}: expected pressure logs and angle tables (or videos) of the same names inside this folder, such as "
        f"logs/original_0.0625Hz_45kPa.csv with results/original_0.0625Hz_45kPa.h5; found {found}"
    )
    without_log = [trial.stem for trial in trials if {"angles", "video"} & set(trial.files)]
    if without_log and not any("log" in trial.files for trial in trials):
        said += f". No pressure log is there: copy the one of '{without_log[0]}' to "
        said += str(folder / "logs" / f"{without_log[0]}.csv")
    return said


def _trial_stem(path: Path) -> str:
    """Name of the trial of a file whose name says nothing else: its own, without what says what it is."""
    return path.stem.removesuffix(".overlay")


def _files(folder: Path) -> Iterator[Path]:
    count = 0
    for here, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith(".") and name not in _SKIPPED)
        if _WEIGHTS in names:  # a trained network, whose training.csv is no log
            folders.clear()
            continue
        if SETTINGS_FILE in names:  # a project: what lies in its models/ are networks
            folders[:] = [name for name in folders if name != "models"]
        for name in sorted(names):
            if not name.startswith("."):
                yield Path(here) / name
                count += 1
        if count > _MAX_FILES:
            raise StudyError(
                f"{folder}: expected a folder of a study, got one with more than {_MAX_FILES} files"
            )


def _kind(path: Path) -> str | None:
    """Kind of a file: "angles", "log", "video", "model"; "unknown" tables; None for no table."""
    suffix = path.suffix.lower()
    if suffix in VIDEO_SUFFIXES:
        return None if path.stem.endswith(".overlay") or path.with_suffix(".json").is_file() else "video"
    if suffix == ".mat":
        return "log"
    if suffix == ".h5":
        try:
            with open_hdf5(path, StudyError, "HDF5") as file:
                return "angles" if "angle_deg" in file.root and "time_s" in file.root else None
        except StudyError:
            return None
    if suffix not in (".csv", ".txt", ".tsv", ".dat"):
        return None
    try:
        columns, _ = csv_columns(path)
        has_time = time_column(columns, str(path)) is not None
    except PressureLogError:
        return "unknown"
    if any(column.name.lower() == "angle_deg" for column in columns):
        return "angles" if has_time else "model"
    if path.parent.name == "results" and (path.parent.parent / SETTINGS_FILE).is_file():
        return None  # a project's own
    return "log" if any(is_pressure(column) for column in columns) else "unknown"


def _by_name(relative: str) -> _TrialFiles | None:
    """Conditions of a trial from a file's name, or from it together with its folders' names."""
    path = PurePosixPath(relative)
    for text in (path.stem, " ".join((*path.parent.parts, path.stem))):
        frequency, pressure, static = _FREQUENCY.search(text), _PRESSURE.search(text), _STATIC.search(text)
        if not frequency and not static:
            continue
        repeats = _REPEAT.findall(text)
        rest = _REPEAT.sub(" ", text)
        for pattern in (_FREQUENCY, _PRESSURE, _STATIC, _KIND_WORDS):
            rest = pattern.sub(" ", rest)
        words = " ".join(re.sub(r"[_\s]+|-(?=\s)|(?<=\s)-|(?<=_)-", " ", rest).strip(" -_.,").split())
        if words:
            return _TrialFiles(
                stem=path.stem,
                design=known_design(words) or words,
                repeat=" ".join(repeats),
                frequency_hz=_number(frequency[1]) if frequency else None,
                pressure_pp_kpa=_number(pressure[1]) if pressure else None,
                static=not frequency,
            )
    return None


def _number(text: str) -> float:
    return float(text.replace(",", ".").replace("p", "."))


def _key(found: _TrialFiles) -> str:
    return f"{found.design.lower()}|{found.frequency_hz}|{found.pressure_pp_kpa}|{found.repeat.lower()}"


def _same_table(a: str, b: str) -> bool:
    return PurePosixPath(a).with_suffix("") == PurePosixPath(b).with_suffix("")


def _text(folder: Path, trials: list[_TrialFiles], left: list[str]) -> str:
    document = tomlkit.document()
    for line in (
        "A study for `bendtrack analyze`, made from the names of the files next to it. Check it:",
        "designs, frequencies and pressures are taken from the names. Unknown keys are refused.",
    ):
        document.add(tomlkit.comment(line))
    document.add("title", tomlkit.item(folder.resolve().name or "Study"))
    names = list(dict.fromkeys(trial.design for trial in trials))
    if "original" in names:
        document.add("baseline", tomlkit.item("original"))
    else:
        document.add(
            tomlkit.comment(f'baseline = "{names[0]}"     # the design that the others are compared with')
        )
    for line in (
        "compare_angles_deg = [85, 140]          # where hysteresis ratios are compared, if not chosen from the data",
        'keep_flagged = ["low_likelihood"]       # rows of angle tables that are used though they are flagged',
        "angle_common_sd_deg = 0.5               # uncertainty that all angles of a trial share",
    ):
        document.add(tomlkit.comment(line))
    document.add(tomlkit.nl())
    document.add("log_format", _log_format(folder / trials[0].files["log"]))
    document.add("sync", _sync())
    colours = design_colours(names, {})
    designs = tomlkit.table(is_super_table=True)
    for name in names:
        shown = DesignSettings(name, colours[name])
        table = tomlkit.table()
        table.update({"label": shown.label, "colour": shown.colour})
        table.add(tomlkit.nl())
        designs.add(name, table)
    document.add("designs", designs)
    entries = tomlkit.aot()
    stems = [trial.stem for trial in trials]
    for trial in trials:
        table = tomlkit.table()
        kind = "static" if trial.static else "dynamic"
        if stems.count(trial.stem) > 1:
            table["name"] = (
                f"{trial.design} {trial.frequency_hz or kind} {trial.pressure_pp_kpa or ''}".strip()
            )
        table["design"] = trial.design
        table["kind"] = kind
        for key in ("frequency_hz", "pressure_pp_kpa"):
            if getattr(trial, key) is not None:
                table[key] = getattr(trial, key)
        for key in ("angles", "video", "log", "model"):
            if key in trial.files:
                table[key] = trial.files[key]
        entries.append(table)
    document.add("trials", entries)
    text = tomlkit.dumps(document).rstrip() + "\n"
    if left:
        text += "\n# Not put into a trial, because the name does not say which or another file is there already:\n"
        text += "".join(f"#   {name}\n" for name in left)
    return text


def _log_format(log: Path) -> tomlkit.items.Table:
    """The section on logs, with comments to fill in where the first log is ambiguous."""
    table = tomlkit.table()
    table.add(tomlkit.comment("How the logs are read; a trial may have its own log_format."))
    try:
        columns = read_pressure_log(log).provenance["columns"]
        found = ", ".join(f"{what} '{name}'" for what, name in columns.items() if name)
        table.add(tomlkit.comment(f"Found in {log.name}: {found}."))
    except PressureLogError as error:
        table.add(tomlkit.comment(f"TO DO: {str(error).replace(str(log), log.name)}"))
    for line in (
        'time_column = "t"          # a name, or a number from 1; also pressure_column, reference_column, sync_column',
        'pressure_unit = "kPa"      # kPa, Pa, hPa, MPa, mbar, bar, psi; V and mV with gain_kpa_per_v and offset_kpa',
        'time_unit = "s"            # s, ms, us, min',
        "rate_hz = 400              # for logs without times",
        "lag_s = 0.0                # how late the logged pressure is (a 5 Hz low-pass: 0.032)",
    ):
        table.add(tomlkit.comment(line))
    table.add(tomlkit.nl())
    return table


def _sync() -> tomlkit.items.Table:
    table = tomlkit.table()
    table.add(
        tomlkit.comment("How the log's clock is brought to the video's; a trial may have its own sync.")
    )
    table.add("method", tomlkit.item("shared clock"))
    for line in (
        'method = "given delay"     # delay_s = 0.12 (video time = log time + delay_s), sd_s = 0.01',
        'method = "sync event"      # log_event = "sync" or "pressure"; video_event = "led" with',
        '                           # led_region_px = [x, y, width, height], or "angle"',
    ):
        table.add(tomlkit.comment(line))
    table.add(tomlkit.nl())
    return table
