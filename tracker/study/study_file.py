"""The study file (TOML): its trials, designs, how logs are read and clocks synchronised; checked, then resolved.

A first one is written by `first_study.py`; a trial's data are read by `trial_data.py`.
"""

from __future__ import annotations

import difflib
import re
import tomllib
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, ValidationError, field_validator, model_validator
from pydantic_core import PydanticCustomError

from ..errors import StudyError
from ..toml_files import Section, toml_text, validation_message
from ..types import Flag
from .designs import DesignSettings, design_colours
from .log_format import LogFormat
from .trial import Kind

# Flags of rows that hold an angle, which a study may keep; rows with other flags hold none.
_KEEPABLE = (Flag.LOW_LIKELIHOOD, Flag.JUMP, Flag.DAMAGED)
# The design that the others are compared with, where the file names none.
_USUAL_BASELINE = "original"


def _relative(path: str) -> str:
    if "\\" in path or PurePosixPath(path).is_absolute() or re.match(r"[A-Za-z]:", path) or not path:
        raise PydanticCustomError(
            "path",
            "expected a path relative to this file with / between folders, got '{path}'",
            {"path": path},
        )
    return path


RelativePath = Annotated[str, AfterValidator(_relative)]
Interval = Annotated[tuple[float, float], Field(strict=False)]


class SyncSettings(Section):
    """How the log's clock is brought to the video's (see `synchronisation.py`).

    Attributes
    ----------
    method : {'shared clock', 'given delay', 'sync event'}
        "shared clock": both count from the same moment.
    delay_s : float or None
        For "given delay": video time = log time + delay_s.
    sd_s : float
        Standard uncertainty of that delay, s; with the other methods it is added to their own.
    video_start : datetime or None
        When the video's first frame was taken, for a shared clock where the log holds dates.
    log_event : {'sync', 'pressure'}
        The event in the log: "sync" (first rising edge of its sync column) or "pressure" (its onset).
    video_event : {'led', 'angle'}
        The event in the video: "led" (a lamp goes on in led_region_px) or "angle" (its onset).
    led_region_px : tuple of (int, int, int, int) or None
        X, y, width, height in px of the region where the lamp is seen.
    log_window_s, video_window_s : tuple of (float, float) or None
        Time window of the event, on the log's and on the video's clock.
    """

    method: Literal["shared clock", "given delay", "sync event"] = "shared clock"
    delay_s: float | None = None
    sd_s: float = Field(default=0.0, ge=0)
    video_start: datetime | None = None
    log_event: Literal["sync", "pressure"] = "sync"
    video_event: Literal["led", "angle"] = "led"
    led_region_px: Annotated[tuple[int, int, int, int], Field(strict=False)] | None = None
    log_window_s: Interval | None = None
    video_window_s: Interval | None = None

    @model_validator(mode="after")
    def _keys_fit_the_method(self) -> SyncSettings:
        belongs = {
            "delay_s": "given delay",
            "video_start": "shared clock",
            **dict.fromkeys(("log_event", "video_event", "led_region_px"), "sync event"),
            **dict.fromkeys(("log_window_s", "video_window_s"), "sync event"),
        }
        for key in sorted(self.model_fields_set):
            if belongs.get(key, self.method) != self.method:
                raise _mistake(f"{key} is for method = '{belongs[key]}', got method = '{self.method}'")
        if self.method == "given delay" and self.delay_s is None:
            raise _mistake("method = 'given delay' needs delay_s")
        if self.method == "sync event" and self.video_event == "led" and self.led_region_px is None:
            raise _mistake("a lamp as video_event needs led_region_px = [x, y, width, height]")
        if self.led_region_px is not None and (
            min(self.led_region_px) < 0 or min(self.led_region_px[2:]) < 1
        ):
            raise _mistake(
                f"led_region_px: expected x, y, width, height in px, got {list(self.led_region_px)}"
            )
        for key in ("log_window_s", "video_window_s"):
            window = getattr(self, key)
            if window is not None and window[0] >= window[1]:
                raise _mistake(f"{key}: expected a begin before an end, got {list(window)}")
        return self


class _DesignEntry(Section):
    label: str | None = None
    colour: Annotated[str, Field(pattern=r"^#[0-9a-fA-F]{6}$")] | None = None


class _TrialEntry(Section):
    design: str
    kind: Annotated[Kind, Field(strict=False)]
    log: RelativePath
    name: str | None = None
    angles: RelativePath | None = None
    video: RelativePath | None = None
    frequency_hz: float | None = Field(default=None, gt=0)
    pressure_pp_kpa: float | None = Field(default=None, gt=0)
    reference: RelativePath | None = None
    model: RelativePath | None = None
    log_format: LogFormat | None = None
    sync: SyncSettings | None = None
    angle_common_sd_deg: float | None = Field(default=None, ge=0)

    @model_validator(mode="after")
    def _has_angles(self) -> _TrialEntry:
        if self.angles is None and self.video is None:
            raise _mistake("expected angles (an angle table) or video, got neither")
        return self

    @property
    def own_name(self) -> str:
        """As given, or the stem of the table or the video."""
        return self.name or PurePosixPath(self.angles or self.video or self.log).stem


class _StudyEntries(Section):
    title: str = "Study"
    baseline: str | None = None
    results: RelativePath | None = None
    keep_flagged: Annotated[tuple[str, ...], Field(strict=False)] = ()
    angle_common_sd_deg: float = Field(default=0.0, ge=0)
    compare_angles_deg: Annotated[tuple[float, ...], Field(strict=False)] = ()
    log_format: LogFormat = LogFormat()
    sync: SyncSettings = SyncSettings()
    designs: dict[str, _DesignEntry] = Field(default_factory=dict)
    trials: Annotated[tuple[_TrialEntry, ...], Field(strict=False)]

    @field_validator("keep_flagged")
    @classmethod
    def _flags_that_hold_an_angle(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for flag in value:
            if flag not in _KEEPABLE:
                raise _mistake(f"expected some of {', '.join(_KEEPABLE)}, got '{flag}'")
        return value

    @model_validator(mode="after")
    def _names_fit(self) -> _StudyEntries:
        if not self.trials:
            raise _mistake("expected at least one [[trials]], got none")
        names = [trial.own_name for trial in self.trials]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise _mistake(f"expected trials of distinct names, got '{twice}' twice; give each its name")
        for trial in self.trials:
            _check_known(trial.design, self.designs or [trial.design], f"trial '{trial.own_name}': design")
        if self.baseline is not None:
            _check_known(self.baseline, [trial.design for trial in self.trials], "baseline")
        return self


@dataclass(frozen=True)
class TrialSettings:
    """One trial of a study, with the file's defaults filled in and its paths resolved.

    Attributes
    ----------
    name, design : str
        As in `trial.TrialData`.
    kind : Kind
        Static or dynamic.
    frequency_hz, pressure_pp_kpa : float or None
        Nominal frequency and peak-to-peak pressure, None where not given.
    angles : Path or None
        Angle table; None where it is looked up by `video` in the results.
    video : Path or None
        Video file.
    log : Path
        Pressure log.
    reference, model : Path or None
        Files of the reference wave and of the model curve; None where there is none.
    log_format : LogFormat
        How the log is read.
    sync : SyncSettings
        How the log's clock is brought to the video's.
    angle_common_sd_deg : float
        Standard uncertainty common to all angles of the trial.
    """

    name: str
    design: str
    kind: Kind
    frequency_hz: float | None
    pressure_pp_kpa: float | None
    angles: Path | None
    video: Path | None
    log: Path
    reference: Path | None
    model: Path | None
    log_format: LogFormat
    sync: SyncSettings
    angle_common_sd_deg: float


@dataclass(frozen=True)
class Study:
    """A study file, read.

    Attributes
    ----------
    path : Path
        Path of the study file.
    title : str
        Title of the report.
    baseline : str or None
        The design that the others are compared with; None where the file names none and there is no
        "original".
    designs : dict of str to DesignSettings
        Designs by name, in the order of the file.
    trials : tuple of TrialSettings
        Trials in the order of the file.
    results : Path or None
        Folder of angle tables, in which a trial's video is looked up.
    keep_flagged : tuple of str
        Flags (see `types.Flag`) of rows whose angle is used; other flagged rows are gaps.
    compare_angles_deg : tuple of float
        Angles at which hysteresis ratios are compared; empty: chosen by the analysis.
    """

    path: Path
    title: str
    baseline: str | None
    designs: dict[str, DesignSettings]
    trials: tuple[TrialSettings, ...]
    results: Path | None
    keep_flagged: tuple[str, ...]
    compare_angles_deg: tuple[float, ...]

    @property
    def root(self) -> Path:
        """The folder to which paths in the file are relative."""
        return self.path.parent


def read_study(path: str | Path) -> Study:
    """Read a study file. The files that it names need not be there yet.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    Study
        The study, with resolved paths.

    Raises
    ------
    StudyError
        No such file, not TOML, an unknown key, a wrong value; the message gives the key, what was expected and what
        was found.
    """
    path = Path(path)
    if not path.is_file():
        raise StudyError(f"expected a study file, got {'a folder' if path.is_dir() else 'no file'}: {path}")
    raw = tomllib.loads(toml_text(path, StudyError))
    try:
        entries = _StudyEntries.model_validate(raw)
    except ValidationError as error:
        raise StudyError(f"{path}: {validation_message(error, _StudyEntries)}") from error
    used = dict.fromkeys(trial.design for trial in entries.trials)
    names = list(entries.designs) or list(used)
    chosen = {name: entry.colour for name, entry in entries.designs.items() if entry.colour is not None}
    colours = design_colours(names, chosen)
    labels = {name: entry.label for name, entry in entries.designs.items()}
    return Study(
        path=path,
        title=entries.title,
        baseline=entries.baseline or (_USUAL_BASELINE if _USUAL_BASELINE in used else None),
        designs={name: DesignSettings(labels.get(name) or name, colours[name]) for name in names},
        trials=tuple(_resolved(trial, entries, path.parent) for trial in entries.trials),
        results=None if entries.results is None else path.parent / entries.results,
        keep_flagged=entries.keep_flagged,
        compare_angles_deg=entries.compare_angles_deg,
    )


def _resolved(trial: _TrialEntry, study: _StudyEntries, root: Path) -> TrialSettings:
    """The trial with the study's settings where it has none. A trial's `sync` replaces the study's as a whole."""
    own = trial.log_format.model_dump(exclude_unset=True) if trial.log_format else {}
    common_sd_deg = trial.angle_common_sd_deg
    return TrialSettings(
        name=trial.own_name,
        design=trial.design,
        kind=trial.kind,
        frequency_hz=trial.frequency_hz,
        pressure_pp_kpa=trial.pressure_pp_kpa,
        angles=_at(root, trial.angles),
        video=_at(root, trial.video),
        log=root / trial.log,
        reference=_at(root, trial.reference),
        model=_at(root, trial.model),
        log_format=study.log_format.model_copy(update=own),
        sync=trial.sync or study.sync,
        angle_common_sd_deg=study.angle_common_sd_deg if common_sd_deg is None else common_sd_deg,
    )


def _at(root: Path, path: str | None) -> Path | None:
    return None if path is None else root / path


def _check_known(name: str, known: list[str] | dict[str, _DesignEntry], what: str) -> None:
    if name not in known:
        close = difflib.get_close_matches(name, list(known), n=1)
        hint = f" (did you mean '{close[0]}'?)" if close else ""
        listed = ", ".join(dict.fromkeys(known))
        raise _mistake(f"{what}: expected one of the designs {listed}, got '{name}'{hint}")


def _mistake(text: str) -> PydanticCustomError:
    return PydanticCustomError("study", "{text}", {"text": text})
