"""Draws `stages.svg`, the figure of the Method page: `python docs/method/draw_stages.py`. Standard library only."""

from __future__ import annotations

from html import escape
from pathlib import Path

WIDTH, BOX_W, BOX_H, GAP, LEFT = 860, 144, 92, 18, 34
LANES = [
    (
        "Once: training, from about thirty labels",
        "#B26B00",
        "#FFF6E6",
        [
            ("A", "Pretrained start", "and experience replay"),
            ("B", "Denoised targets", "label-noise model"),
            ("C", "Joint registration", "of the moving end"),
            ("D", "Weight averaging", "schedule, early decay"),
            ("E", "Engine", "float32 or 8 bit"),
        ],
    ),
    (
        "Once: without labels",
        "#8A2F5F",
        "#FBEFF5",
        [
            ("I", "Motion evidence", "what moves in the film"),
            ("II", "Probe frames", "the end that rests"),
            ("III", "Chain assembly", "dynamic programming"),
            ("IV", "Edge orientation", "from its two sides"),
            ("V", "Self-training", "where it is not sure"),
            ("VI", "Label propagation", "with one to four labels"),
        ],
    ),
    (
        "Every frame",
        "#0072B2",
        "#EAF4FB",
        [
            ("1", "Region of interest", "where labels lie"),
            ("2", "Localize", "all points, coarse"),
            ("3", "Oriented crops", "every tip upright"),
            ("4", "Refine", "each point, fine"),
            ("5", "End regression", "at twice the scale"),
            ("6", "Consistency check", "coarse against fine"),
            ("7", "Calibration", "sd and likelihood"),
            ("8", "Tracking", "next frame's crops"),
        ],
    ),
]


def text(
    x: float, y: float, words: str, size: float, colour: str, weight: int = 400, anchor: str = "start"
) -> str:
    return (
        f'<text x="{x:g}" y="{y:g}" font-size="{size:g}" fill="{colour}" font-weight="{weight}" '
        f'text-anchor="{anchor}">{escape(words)}</text>'
    )


def arrow(x1: float, y1: float, x2: float, y2: float, colour: str) -> str:
    return (
        f'<line x1="{x1:g}" y1="{y1:g}" x2="{x2:g}" y2="{y2:g}" stroke="{colour}" stroke-width="2" '
        f'marker-end="url(#tip)"/>'
    )


def box(x: float, y: float, colour: str, stage: tuple[str, str, str]) -> str:
    number, name, detail = stage
    first, second = name.rsplit(" ", 1) if " " in name else (name, "")
    return "\n".join(
        [
            f'<rect x="{x:g}" y="{y:g}" width="{BOX_W}" height="{BOX_H}" rx="9" fill="#fff" '
            f'stroke="{colour}" stroke-width="1.5"/>',
            f'<circle cx="{x + 22:g}" cy="{y + 27:g}" r="13.5" fill="{colour}"/>',
            text(x + 22, y + 31.5, number, 12.5, "#fff", 700, "middle"),
            text(x + 43, y + (23 if second else 32), first, 13.5, "#1d2630", 600),
            text(x + 43, y + 40, second, 13.5, "#1d2630", 600),
            text(x + 12, y + 74, detail, 11, "#55606b"),
        ]
    )


def drawing() -> str:
    parts, y = [], 20.0
    for title, colour, ground, stages in LANES:
        rows = [stages[i : i + 5] for i in range(0, len(stages), 5)]
        height = 46 + len(rows) * (BOX_H + GAP) + 4
        parts.append(
            f'<rect x="16" y="{y:g}" width="{WIDTH - 32}" height="{height:g}" rx="14" fill="{ground}"/>'
        )
        parts.append(text(LEFT, y + 30, title, 16, colour, 700))
        for r, row in enumerate(rows):
            top = y + 46 + r * (BOX_H + GAP)
            for c, stage in enumerate(row):
                x = LEFT + c * (BOX_W + GAP)
                parts.append(box(x, top, colour, stage))
                if c + 1 < len(row):
                    parts.append(
                        arrow(x + BOX_W + 2, top + BOX_H / 2, x + BOX_W + GAP - 4, top + BOX_H / 2, colour)
                    )
            if r + 1 < len(rows):
                last, first = LEFT + 4 * (BOX_W + GAP) + BOX_W / 2, LEFT + BOX_W / 2
                middle = top + BOX_H + GAP / 2
                parts.append(
                    f'<polyline points="{last:g},{top + BOX_H:g} {last:g},{middle:g} {first:g},{middle:g} '
                    f'{first:g},{top + BOX_H + GAP - 3:g}" fill="none" stroke="{colour}" stroke-width="2" '
                    f'marker-end="url(#tip)"/>'
                )
        y += height + 16
    result = "Result: the bending angle of every frame, with its standard deviation and a flag."
    parts.append(text(LEFT, y + 16, result, 14, "#1d2630", 600))
    height = y + 36
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height:g}" '
            "font-family=\"system-ui, -apple-system, 'Segoe UI', Roboto, 'Liberation Sans', sans-serif\" role=\"img\" "
            'aria-label="The stages of bendtrack in three lanes: training, without labels, and every frame">',
            '<defs><marker id="tip" viewBox="0 0 8 8" refX="6" refY="4" markerWidth="6" markerHeight="6" orient="auto">'
            '<path d="M0 0 L8 4 L0 8 z" fill="context-stroke"/></marker></defs>',
            f'<rect width="{WIDTH}" height="{height:g}" rx="14" fill="#fff"/>',
            *parts,
            "</svg>",
        ]
    )


if __name__ == "__main__":
    Path(__file__).with_name("stages.svg").write_text(drawing() + "\n", encoding="utf-8")
