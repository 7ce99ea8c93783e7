"""Elements of the HTML report: tables, figures, lists, the table of contents. All text is escaped here.

A function that returns HTML has a name that ends in `_html`; everything else is text.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

from .paper_tables import PaperTable


@dataclass(frozen=True)
class Part:
    """A section of the report: its heading, its anchor, its content as HTML, and its subsections.

    Attributes
    ----------
    heading : str
        Heading, plain text.
    anchor : str
        Id of the heading.
    content_html : str
        Content, HTML.
    parts : tuple of Part
        Subsections.
    """

    heading: str
    anchor: str
    content_html: str
    parts: tuple[Part, ...] = ()


def contents_html(parts: Iterable[Part]) -> str:
    """The table of contents, two levels deep.

    Parameters
    ----------
    parts : iterable of Part
        Sections of the report.

    Returns
    -------
    str
        HTML.
    """
    items = []
    for part in parts:
        inner = contents_html(part.parts) if part.parts else ""
        items.append(f'<li><a href="#{escape(part.anchor)}">{escape(part.heading)}</a>{inner}</li>')
    return f"<ol>{''.join(items)}</ol>"


def part_html(part: Part, level: int = 2) -> str:
    """A part with its heading, and the parts in it one level lower.

    Parameters
    ----------
    part : Part
        The section.
    level : int, optional
        Level of its heading.

    Returns
    -------
    str
        HTML.
    """
    heading = f'<h{level} id="{escape(part.anchor)}">{escape(part.heading)}</h{level}>'
    return "\n".join([heading, part.content_html, *(part_html(inner, level + 1) for inner in part.parts)])


def paragraph_html(text: str, css_class: str = "") -> str:
    """A paragraph of plain text.

    Parameters
    ----------
    text : str
        Plain text.
    css_class : str, optional
        Class of the element.

    Returns
    -------
    str
        HTML.
    """
    return f"<p{_class(css_class)}>{escape(text)}</p>"


def list_html(texts: Iterable[str], css_class: str = "") -> str:
    """A list of plain texts; nothing for no texts.

    Parameters
    ----------
    texts : iterable of str
        Plain texts, one per item.
    css_class : str, optional
        Class of the element.

    Returns
    -------
    str
        HTML.
    """
    items = "".join(f"<li>{escape(text)}</li>" for text in texts)
    return f"<ul{_class(css_class)}>{items}</ul>" if items else ""


def definitions_html(entries: Iterable[tuple[str, str, str]]) -> str:
    """Terms with their meaning and, where there is one, their formula: (term, text, formula).

    Parameters
    ----------
    entries : iterable of tuple of (str, str, str)
        Tuples of plain text.

    Returns
    -------
    str
        HTML.
    """
    lines = []
    for term, text, formula in entries:
        shown = f'<span class="formula">{escape(formula)}</span>' if formula else ""
        lines.append(f"<dt>{escape(term)}</dt><dd>{escape(text)}{shown}</dd>")
    return f"<dl>{''.join(lines)}</dl>"


def table_html(table: PaperTable, *, rows_in_view: int = 16) -> str:
    """A table with its caption and note; one with more rows scrolls under its headings.

    Parameters
    ----------
    table : PaperTable
        The table.
    rows_in_view : int, optional
        Number of rows above which the table scrolls.

    Returns
    -------
    str
        HTML.
    """
    classes = ["n" if column.numeric else "" for column in table.columns]
    heads = "".join(
        f'<th scope="col"{_class(css)}>{escape(column.heading)}</th>'
        for column, css in zip(table.columns, classes, strict=True)
    )
    body = []
    before = ""
    for index, row in enumerate(table.rows):
        again = table.grouped and row[0] == before
        turn = table.grouped and index > 0 and not again
        own = [f"{classes[0]} again".strip() if again else classes[0], *classes[1:]]
        cells = "".join(f"<td{_class(css)}>{escape(cell)}</td>" for cell, css in zip(row, own, strict=True))
        body.append(f"<tr{_class('turn' if turn else '')}>{cells}</tr>")
        before = row[0]
    tall = " tall" if len(table.rows) > rows_in_view else ""
    wide = " wide" if len(table.columns) > 8 else ""
    note = paragraph_html(table.note, "note") if table.note else ""
    hint = ' <span class="hint">Scroll sideways for all columns.</span>' if wide else ""
    return (
        f'<div class="scroll{tall}{wide}" tabindex="0"><table><caption>{escape(table.caption)}{hint}</caption>'
        f"<thead><tr>{heads}</tr></thead><tbody>{''.join(body)}</tbody></table></div>{note}"
    )


def figure_html(png: bytes, *, name: str, alt: str, caption: str, css_class: str = "") -> str:
    """An embedded image with its caption.

    Parameters
    ----------
    png : bytes
        The image file.
    name : str
        Number of the figure, set in bold.
    alt : str
        Alternative text of the image.
    caption : str
        The caption.
    css_class : str, optional
        Class of the element.

    Returns
    -------
    str
        HTML.
    """
    data = base64.b64encode(png).decode("ascii")
    lead = f"<b>{escape(name)}</b> " if name else ""
    return (
        f'<figure{_class(css_class)}><img alt="{escape(alt)}" '
        f'src="data:image/png;base64,{data}"><figcaption>{lead}{escape(caption)}</figcaption></figure>'
    )


def legend_html(entries: Sequence[tuple[str, str]]) -> str:
    """The designs' colours: (label, "#rrggbb").

    Parameters
    ----------
    entries : sequence of tuple of (str, str)
        Label and colour of each design.

    Returns
    -------
    str
        HTML.
    """
    items = "".join(
        f'<li><i style="background:{escape(colour)}"></i>{escape(label)}</li>' for label, colour in entries
    )
    return f'<ul class="key">{items}</ul>' if items else ""


def collapsed_html(heading: str, aside: str, mark: str, content_html: str, anchor: str) -> str:
    """A collapsed element (`details`): heading, a muted note next to it, a mark at its end.

    Parameters
    ----------
    heading : str
        Heading, plain text.
    aside : str
        Note next to the heading, plain text.
    mark : str
        Mark at the end of the line; empty for none.
    content_html : str
        Content, HTML.
    anchor : str
        Id of the element.

    Returns
    -------
    str
        HTML.
    """
    marked = f'<span class="mark">{escape(mark)}</span>' if mark else ""
    return (
        f'<details id="{escape(anchor)}"><summary><span>{escape(heading)}</span>'
        f'<span class="sub">{escape(aside)}</span>{marked}</summary>{content_html}</details>'
    )


def _class(name: str) -> str:
    return f' class="{escape(name)}"' if name else ""
