"""Tables as LaTeX files for a paper (booktabs), everything escaped. Their contents are made in `paper_tables.py`."""

from __future__ import annotations

from .number_text import MINUS, MISSING
from .paper_tables import PaperTable

_ESCAPES = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    "±": r"$\pm$",
    "°": r"$^{\circ}$",
    "×": r"$\times$",
    "·": r"$\cdot$",
    MINUS: "$-$",
    MISSING: "--",
    "\u00a0": "~",
}


def latex_text(text: str) -> str:
    """Text escaped for LaTeX; line breaks and control characters become spaces.

    Parameters
    ----------
    text : str
        Plain text.

    Returns
    -------
    str
        LaTeX source of one line.

    Examples
    --------
    >>> latex_text("50% of a_b & 3° ± 1°")
    '50\\\\% of a\\\\_b \\\\& 3$^{\\\\circ}$ $\\\\pm$ 1$^{\\\\circ}$'
    """
    return "".join(_ESCAPES.get(char, char if char.isprintable() else " ") for char in text)


def latex_table(table: PaperTable) -> str:
    """A `table` environment, to be included with \\input; the document needs \\usepackage{booktabs}.

    Parameters
    ----------
    table : PaperTable
        The table.

    Returns
    -------
    str
        LaTeX source.
    """
    columns = "".join("r" if column.numeric else "l" for column in table.columns)
    lines = [
        r"% needs \usepackage{booktabs}; \usepackage[T1]{fontenc} for quotation marks in names",
        r"\begin{table}[htb]",
        r"  \centering",
        rf"  \caption{{{latex_text(table.caption)}}}",
        rf"  \label{{tab:{table.name}}}",
        rf"  \begin{{tabular}}{{{columns}}}",
        r"    \toprule",
        f"    {_row([column.heading for column in table.columns])}",
        r"    \midrule",
    ]
    before = ""
    for index, row in enumerate(table.rows):
        again = table.grouped and row[0] == before
        if table.grouped and index > 0 and not again:
            lines.append(r"    \midrule")
        lines.append(f"    {_row(['', *row[1:]] if again else row)}")
        before = row[0]
    lines += [r"    \bottomrule", r"  \end{tabular}"]
    lines += [rf"  \par\smallskip\footnotesize {latex_text(table.note)}"] if table.note else []
    lines += [r"\end{table}", ""]
    return "\n".join(lines)


def _row(cells: list[str] | tuple[str, ...]) -> str:
    return " & ".join(latex_text(cell) for cell in cells) + r" \\"
