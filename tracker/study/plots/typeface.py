"""The typeface of the figures: matplotlib's own DejaVu Sans, subset once so that embedding it is fast.

A study has a hundred PDFs. Embedding the whole font's layout tables costs more than drawing a figure does.
"""

from __future__ import annotations

import atexit
import shutil
import tempfile
from functools import cache
from pathlib import Path

from fontTools import subset
from matplotlib import font_manager

WHOLE_FAMILY = "DejaVu Sans"
_FAMILY = "DejaVu Sans (figures)"
# Latin-1 (with ° ± ×), dashes, quotes, ellipsis, minus. Other characters are taken from the whole font.
_RANGES = ((0x20, 0x7E), (0xA0, 0xFF), (0x2010, 0x201F), (0x2026, 0x2026), (0x2212, 0x2212))
_FAMILY_IDS = (1, 16)  # of OpenType's name table


@cache
def figure_families() -> tuple[str, ...]:
    """Font families for `font.sans-serif`, registered with matplotlib: the subset, then the whole font.

    Returns
    -------
    tuple of str
        Names of font families.
    """
    options = subset.Options(layout_features=[], name_IDs=["*"], glyph_names=False)
    options.drop_tables += ["GDEF", "GPOS", "GSUB", "kern", "FFTM"]
    path = _folder() / "figures.ttf"
    with subset.load_font(font_manager.findfont(WHOLE_FAMILY), options) as font:
        subsetter = subset.Subsetter(options)
        subsetter.populate(unicodes=[code for first, last in _RANGES for code in range(first, last + 1)])
        subsetter.subset(font)
        for record in font["name"].names:
            if record.nameID in _FAMILY_IDS:
                record.string = _FAMILY
        subset.save_font(font, str(path), options)
    font_manager.fontManager.addfont(path)
    return _FAMILY, WHOLE_FAMILY


def _folder() -> Path:
    """A folder that exists until the program ends: matplotlib opens the font whenever it draws."""
    folder = tempfile.mkdtemp(prefix="bendtrack-font-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)
