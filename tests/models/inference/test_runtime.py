"""Engine records on disk, and OpenVINO's import without its telemetry. How engines compute is in test_export."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from bendtrack.models.inference.runtime import (
    FORMAT,
    RECORD,
    EngineCheck,
    EngineRecord,
    engine_folder,
    engine_record,
    load_openvino,
)

SHA256 = "a" * 64


@pytest.fixture
def record() -> EngineRecord:
    return EngineRecord(
        checkpoint_sha256=SHA256,
        openvino=load_openvino().__version__,
        frames_fitted=4,
        frames_judged=3,
        ends=((2, 3), (7, 8)),
        engines={
            "openvino-int8": EngineCheck(0.2, 0.01, False, 5.0),
            "openvino": EngineCheck(1e-5, 2e-5, True, 9.5),
        },
        skipped={"another": "expected a reason"},
    )


def written(record: EngineRecord, folder: Path) -> Path:
    """A checkpoint's file with this record next to it; returns the checkpoint's path."""
    checkpoint_file = folder / "weights.safetensors"
    engine_folder(checkpoint_file).mkdir()
    (engine_folder(checkpoint_file) / RECORD).write_text(json.dumps(record.to_dict()))
    return checkpoint_file


def test_round_trip_of_a_record(record: EngineRecord, tmp_path: Path) -> None:
    assert EngineRecord.from_dict(json.loads(json.dumps(record.to_dict()))) == record
    assert engine_record(written(record, tmp_path), SHA256) == record


def test_a_record_without_skipped_engines_is_read(record: EngineRecord) -> None:
    values = record.to_dict()
    del values["skipped"]
    assert EngineRecord.from_dict(values).skipped == {}


def test_the_fastest_engine_passed_its_check(record: EngineRecord) -> None:
    assert record.fastest == "openvino"
    failed = {name: EngineCheck(1.0, 1.0, False, 1.0) for name in record.engines}
    assert EngineRecord(SHA256, "", 0, 0, (), failed).fastest is None


@pytest.mark.parametrize(
    "damage",
    [
        lambda values: values | {"format": FORMAT - 1},
        lambda values: values | {"checkpoint_sha256": "b" * 64},
        lambda values: values | {"openvino": "1.0"},
        lambda values: values | {"engines": {"openvino": {"drift_px": 0.1}}},
        lambda values: values | {"engines": {"openvino": {**values["engines"]["openvino"], "colour": 1}}},
        lambda values: values | {"engines": {"openvino": "fast"}},
        lambda values: values | {"engines": ["openvino"]},
        lambda values: values | {"ends": [[2]]},
        lambda values: values | {"ends": 7},
        lambda values: values | {"frames_fitted": "many"},
        lambda values: values | {"skipped": None},
        lambda values: {key: value for key, value in values.items() if key != "frames_judged"},
        lambda values: [values],
        lambda _: None,
        lambda _: "{",
        lambda _: {},
    ],
)
def test_a_damaged_or_foreign_record_is_no_record(
    damage: Callable[[dict[str, Any]], Any], record: EngineRecord, tmp_path: Path
) -> None:
    file = written(record, tmp_path)
    changed = damage(record.to_dict())
    text = changed if isinstance(changed, str) else json.dumps(changed)
    (engine_folder(file) / RECORD).write_text(text)
    assert engine_record(file, SHA256) is None


def test_a_missing_or_binary_record_is_no_record(record: EngineRecord, tmp_path: Path) -> None:
    file = written(record, tmp_path)
    (engine_folder(file) / RECORD).write_bytes(b"\xff\xfe\x00{}")
    assert engine_record(file, SHA256) is None
    (engine_folder(file) / RECORD).unlink()
    assert engine_record(file, SHA256) is None


def test_importing_the_package_changes_no_module_of_others() -> None:
    """Telemetry is hidden only when OpenVINO is imported through `load_openvino`."""
    code = (
        "import sys\n"
        "before = dict(sys.modules)\n"
        "import bendtrack.models, bendtrack.models.inference.runtime\n"
        "assert 'openvino' not in sys.modules and 'torch' not in sys.modules\n"
        "assert 'openvino_telemetry' not in sys.modules\n"
        "assert all(sys.modules[name] is module for name, module in before.items())\n"
        "openvino = bendtrack.models.inference.runtime.load_openvino()\n"
        "assert openvino is sys.modules['openvino']\n"
        "assert sys.modules['openvino_telemetry'] is None\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_an_openvino_that_is_imported_already_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    own, telemetry = ModuleType("openvino"), ModuleType("openvino_telemetry")
    monkeypatch.setitem(sys.modules, "openvino", own)
    monkeypatch.setitem(sys.modules, "openvino_telemetry", telemetry)
    assert load_openvino() is own
    assert sys.modules["openvino_telemetry"] is telemetry
