"""Tables with one header row: every row is compared with it; text cells are no formulas."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bendtrack.tracker.csv_tables import read_csv_table, spreadsheet_cell, spreadsheet_text
from bendtrack.tracker.errors import ResultsError
from bendtrack.tracker.study.angle_input import read_angles
from bendtrack.tracker.study.tables import write_csv_tables

ROWS = "".join(f"{n / 10:.1f},{n},\n" for n in range(5))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,angle_deg\n0,0.1,5\n1,0.2,6\n", "line 2: expected 2 fields as the header has names, got 3"),
        ("time_s,angle_deg,flag\n0,1,\n0.1,2\n", "line 3: expected 3 fields as the header has names, got 2"),
        ("time_s,angle_deg\n0,1\n0.1,2,3\n", "line 3: expected 2 fields"),
        ("time_s,angle_deg,time_s\n0,1,2\n", "expected distinct names of columns, got 'time_s' twice"),
        ('time_s,angle_deg\n0,"1\n', "unexpected end of data"),
        ("time_s,angle_deg\n0,1\0\n", "a byte of value 0"),
        ("time_s,angle_deg\n0," + "x" * 200_000 + "\n", "field larger than field limit"),
        ("", "expected a header row"),
        ("\n,,\n", "expected a header row"),
    ],
)
def test_rows_that_do_not_fit_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_csv_table(path)
    with pytest.raises(ResultsError, match=message) as caught:
        read_angles(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        f"time_s,angle_deg,flag\n{ROWS}",
        f"\ufefftime_s, angle_deg,flag\n{ROWS}",
        f"time_s,angle_deg\n{ROWS}",  # each line ends with a delimiter
        f"time_s,angle_deg,flag,,\n{ROWS}",
        f"\n\ntime_s,angle_deg,flag\n\n{ROWS}\n\n",
        f"time_s,angle_deg,flag\n{ROWS}".replace("\n", "\r\n"),
        f"time_s,angle_deg,flag\n{ROWS}".replace(",", ";").replace(".", ","),
        f'"time_s","angle_deg","flag"\n{ROWS}',
    ],
)
def test_rows_that_fit_are_read(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode())
    angles = read_angles(path)
    assert angles.time_s.tolist() == [0.0, 0.1, 0.2, 0.3, 0.4]
    assert angles.angle_deg.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_a_long_flag_does_not_widen_every_row(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time_s,angle_deg,flag\n0,1,\n1,2," + "x" * 1000 + "\n")
    with pytest.raises(ResultsError, match="flags of at most 64 characters, got 1000"):
        read_angles(path)


@given(st.text())
def test_text_comes_back(text: str) -> None:
    assert spreadsheet_text(spreadsheet_cell(text)) == text
    assert len(text) < 2 or not spreadsheet_cell(text).startswith(("=", "+", "-", "@", "\t", "\r"))


def test_tables_hold_no_formulas_and_their_numbers_stay(tmp_path: Path) -> None:
    table = pd.DataFrame(
        {
            "trial": ["=HYPERLINK(1)", "+1", "-x", "@a", "\tb", "plain", "'=quoted"],
            "=column": [-1.5, 2.0, 3.0, 4.0, 5.0, 6.0, float("nan")],
            "cycles": [(-1, 2), (), (3,), (), (), (), ()],
        }
    )
    (path,) = write_csv_tables({"dynamic": table}, tmp_path)
    read = pd.read_csv(path, keep_default_na=False)
    assert list(read.columns) == ["trial", "'=column", "cycles"]
    assert not any(cell.startswith(("=", "+", "-", "@", "\t", "\r")) for cell in read["trial"])
    assert [spreadsheet_text(cell) for cell in read["trial"]] == table["trial"].tolist()
    assert read["'=column"].tolist() == ["-1.5", "2.0", "3.0", "4.0", "5.0", "6.0", ""]
    assert read["cycles"][0] == "-1 2"
