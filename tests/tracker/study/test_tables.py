"""Tables of a study: CSVs come back as they went, LaTeX is balanced and escaped, numbers read as people write them."""

from __future__ import annotations

import math
import re

import numpy as np
import pandas as pd
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from bendtrack.tracker.errors import ResultsError
from bendtrack.tracker.study.latex import latex_table, latex_text
from bendtrack.tracker.study.number_text import plain_number, with_interval
from bendtrack.tracker.study.paper_tables import PaperTable, TableColumn
from bendtrack.tracker.study.tables import write_csv_tables


def test_csv_comes_back_as_it_went(tmp_path):
    table = pd.DataFrame(
        {
            "trial": ['a, "quoted"\nname', "größe", "="],
            "cycle": [1, 2, 3],
            "hysteresis_ratio": [0.1 + 0.2, math.pi * 1e-17, np.nan],
            "used": [True, False, True],
        }
    )
    (path,) = write_csv_tables({"dynamic": table}, tmp_path)
    assert path == tmp_path / "dynamic.csv"
    pd.testing.assert_frame_equal(pd.read_csv(path), table, check_exact=True)
    assert b"\r" not in path.read_bytes()
    assert path.read_text(encoding="utf-8").splitlines()[0] == "trial,cycle,hysteresis_ratio,used"


def test_several_numbers_in_a_cell_come_apart_again(tmp_path):
    (path,) = write_csv_tables({"dynamic": pd.DataFrame({"cycles_used": [(2, 3, 12), ()]})}, tmp_path)
    assert path.read_text() == 'cycles_used\n2 3 12\n""\n'


def test_an_empty_table_keeps_its_columns(tmp_path):
    (path,) = write_csv_tables({"static": pd.DataFrame(columns=["trial", "rmse_deg"])}, tmp_path)
    assert path.read_text() == "trial,rmse_deg\n"


def test_unwritable_folder_is_a_clear_error(tmp_path):
    with pytest.raises(ResultsError, match=r"static\.csv: cannot be written"):
        write_csv_tables({"static": pd.DataFrame({"trial": []})}, tmp_path / "missing")


def structure(tex: str) -> tuple[str, list[list[str]]]:
    """Column letters and rows of cells of a table; braces and environments are checked on the way."""
    code = re.sub(r"(?m)^%.*$", "", tex)
    depth = 0
    for brace in re.findall(r"(?<!\\)[{}]", code.replace(r"\\", "")):
        depth += 1 if brace == "{" else -1
        assert depth >= 0
    assert depth == 0
    stack = []
    for begin, name in re.findall(r"\\(begin|end)\{(\w+)\}", code):
        if begin == "begin":
            stack.append(name)
        else:
            assert stack.pop() == name
    assert stack == []
    assert code.count(r"\toprule") == code.count(r"\bottomrule") == 1
    columns = re.search(r"\\begin\{tabular\}\{(\w+)\}", code)
    assert columns is not None
    body = code[code.index(r"\toprule") : code.index(r"\bottomrule")]
    lines = [line.strip() for line in body.splitlines() if line.strip().endswith(r"\\")]
    return columns[1], [[cell.strip() for cell in re.split(r"(?<!\\)&", line[:-2])] for line in lines]


HOSTILE = '50% & 3_4 #1 $x$ {y} ~z^2 \\end{table} <|> "q" 90° ± 2\n'


def test_latex_is_balanced_and_escaped():
    table = PaperTable(
        name="one",
        caption=HOSTILE,
        columns=(TableColumn("Design & co", numeric=False), TableColumn("Angle (°)"), TableColumn("NRMSE %")),
        rows=((HOSTILE, "45.44\u00a0±\u00a00.12", "−4.0\u00a0%"), (HOSTILE, "–", "1"), ("b", "2", "3")),
        note=HOSTILE,
        grouped=True,
    )
    columns, rows = structure(latex_table(table))
    assert columns == "lrr"
    assert [len(row) for row in rows] == [3, 3, 3, 3]
    assert rows[1][0].startswith(
        r"50\% \& 3\_4 \#1 \$x\$ \{y\} \textasciitilde{}z\textasciicircum{}2 \textbackslash{}end"
    )
    assert rows[1][1] == r"45.44~$\pm$~0.12"
    assert rows[1][2] == r"$-$4.0~\%"
    assert rows[2][0] == ""  # the same group is named once
    assert rows[3][0] == "b"
    assert latex_table(table).count(r"\midrule") == 2


@given(st.text(max_size=60))
def test_any_text_becomes_one_line_without_commands_of_its_own(text):
    escaped = latex_text(text)
    assert "\n" not in escaped
    assert len(re.findall(r"(?<!\\)\{", escaped)) == len(re.findall(r"(?<!\\)\}", escaped))
    assert not re.search(r"(?<!\\)[&%#_]", escaped)
    left = re.sub(r"\\(text[a-z]+\{\}|[{}&%$#_]|pm|times|cdot|circ)", "", escaped)
    assert "\\" not in left


@given(
    st.floats(-1e4, 1e4),
    st.floats(1e-9, 1e3),
    st.integers(0, 4),
)
@example(0.0, 0.5, 0)  # halves round to even, here to 0
def test_an_interval_is_never_shown_as_nothing_nor_far_off(value, half, decimals):
    shown, _, shown_half = with_interval(value, value - half, value + half, decimals).split()
    assert float(shown_half) > 0
    assert float(shown_half) == pytest.approx(half, rel=0.51, abs=0.5 * 10**-decimals)
    places = len(shown_half.partition(".")[2])
    assert len(shown.partition(".")[2]) == places >= decimals
    assert float(shown.replace("\u2212", "-")) == pytest.approx(value, abs=0.51 * 10**-places)


def test_missing_numbers_are_dashes():
    assert plain_number(math.nan, 2) == "–"
    assert with_interval(math.nan, 1.0, 2.0, 1) == "–"
    assert with_interval(1.25, math.nan, math.nan, 2) == "1.25"
