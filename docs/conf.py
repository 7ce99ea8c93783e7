"""How the pages are built: `sphinx-build -W --keep-going -b html docs build`. The extra `docs` brings what it needs."""

from __future__ import annotations

import re
import sys
from importlib.metadata import version as installed_version
from pathlib import Path

from sphinx.application import Sphinx

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))

project = "bendtrack"
author = "The bendtrack authors"
copyright = author
release = version = installed_version("bendtrack")

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    # Equations also where there is no network.
    "sphinx-mathjax-offline",
    "numpydoc",
    "myst_parser",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "commands",
]

exclude_patterns = ["_build", "examples", ".DS_Store"]
suppress_warnings = ["config.cache"]
nitpicky = False

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath", "amsmath", "attrs_inline", "attrs_block"]
myst_heading_anchors = 3

# Docstrings give a unit and a shape; what they inherit is not repeated.
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False
autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_preserve_defaults = True
autosummary_generate = False

copybutton_exclude = ".linenos, .gp, .go"
copybutton_prompt_text = r"\$ |PS> "
copybutton_prompt_is_regexp = True


def _figure_style(_gallery: dict[str, object], _file: str) -> None:
    """One look for the figures of all examples, whatever the example before left."""
    import matplotlib

    matplotlib.rcdefaults()
    matplotlib.rcParams.update(
        {
            "figure.dpi": 110,
            "savefig.dpi": 200,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.titlesize": "medium",
            "axes.titleweight": "bold",
            "legend.frameon": False,
            # Okabe and Ito's palette: told apart with any colour vision.
            "axes.prop_cycle": matplotlib.cycler(
                color=["#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9"]
            ),
        }
    )


sphinx_gallery_conf = {
    "examples_dirs": "examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"plot_",
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "show_signature": False,
    "remove_config_comments": True,
    "show_memory": False,
    "min_reported_time": 1_000,
    "abort_on_example_error": True,
    "image_scrapers": ("matplotlib",),
    "reset_modules": (_figure_style,),
    "thumbnail_size": (400, 280),
    "capture_repr": ("_repr_html_", "__repr__"),
}

html_theme = "pydata_sphinx_theme"
html_title = "bendtrack"
html_static_path = ["_static"]
html_css_files = ["bendtrack.css"]
html_favicon = "_static/mark.svg"
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "logo": {
        "text": "bendtrack",
        "image_light": "_static/mark.svg",
        "image_dark": "_static/mark.svg",
        "alt_text": "bendtrack: home",
    },
    "navbar_align": "left",
    "header_links_before_dropdown": 8,
    "navbar_persistent": [],
    "navbar_end": ["search-button", "theme-switcher"],
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "show_prev_next": True,
    "pygments_light_style": "friendly",
    "pygments_dark_style": "github-dark",
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
}
html_sidebars = {"index": [], "figures-measured": [], "getting-started": []}


def _escape_patterns(
    _app: object, _what: str, _name: str, _object: object, _options: object, lines: list[str]
) -> None:
    """File patterns in docstrings, such as *.csv, are not emphasis."""
    lines[:] = [re.sub(r"(?<!`)\*(?=\.\w)", r"\\*", line) for line in lines]


def setup(app: Sphinx) -> None:
    app.connect("autodoc-process-docstring", _escape_patterns)
