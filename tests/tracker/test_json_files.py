"""JSON of any origin: depth, numbers, characters and size."""

from __future__ import annotations

from pathlib import Path

import pytest

from bendtrack.tracker import json_files
from bendtrack.tracker.errors import LabelError, ProjectError
from bendtrack.tracker.json_files import parse_json, read_json
from bendtrack.tracker.toml_files import toml_text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000, "nested too deep"),
        ('{"a":' * 100_000, "nested too deep"),
        ("[NaN]", "NaN is no JSON number"),
        ("[-Infinity]", "-Infinity is no JSON number"),
        ("[1e999]", "1e999 is no JSON number"),
        (r'["\ud800"]', "surrogates not allowed"),
        (r'{"\udc00": 1}', "surrogates not allowed"),
        ("[" + "9" * 5000 + "]", "Exceeds the limit"),
        (b"\xff", "utf-8"),
        ("", "Expecting value"),
    ],
)
def test_what_is_refused(tmp_path: Path, text: str | bytes, message: str) -> None:
    path = tmp_path / "a.json"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(LabelError, match=message) as caught:
        read_json(path, LabelError)
    assert str(caught.value).startswith(f"{path}: expected JSON, got a mistake (")
    assert "\n" not in str(caught.value)


def test_what_is_read() -> None:
    assert parse_json(b'\xef\xbb\xbf{"a": [1, 2.5, "\\u00e4", "\\ud83d\\ude00", null]}') == {
        "a": [1, 2.5, "ä", "😀", None]
    }
    assert parse_json("[1e999]", finite=False) == [float("inf")]


def test_a_large_file_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(json_files, "MAX_BYTES", 10)
    (tmp_path / "a.json").write_text("[1, 2, 3, 4, 5]")
    with pytest.raises(LabelError, match="expected at most"):
        read_json(tmp_path / "a.json", LabelError)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a = " + "[" * 100_000, "nested too deep"),
        ("a = " + "{a=" * 20_000, "nested too deep"),
        ("a = " + "9" * 5000, "Exceeds the limit"),
        ("a = 2024-99-99", "got a mistake"),
        (r'a = [{b = "x\u0000"}]', "a character of value 0"),
        (r'"a\u0000" = 1', "a character of value 0"),
        ("a = 1\0", "got a mistake"),
    ],
)
def test_settings_that_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bendtrack.toml"
    path.write_text(text)
    with pytest.raises(ProjectError, match=message) as caught:
        toml_text(path, ProjectError)
    assert "\n" not in str(caught.value)
