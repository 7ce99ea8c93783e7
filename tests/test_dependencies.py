"""Whatever the packages import is declared: what comes along with something else today may not tomorrow."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
# Modules that are not called like what is installed.
INSTALLED_AS = {
    "PIL": "pillow",
    "cv2": "opencv-python-headless",
    "fontTools": "fonttools",
    "yaml": "pyyaml",
    "pydantic_core": "pydantic",
    "sleap_io": "sleap-io",
}


def imported() -> set[str]:
    """Top-level modules that any file of the packages imports, wherever in it."""
    found: set[str] = set()
    for package in ("tracker", "models", "labeling"):
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Import):
                    found |= {alias.name.partition(".")[0] for alias in node.names}
                elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                    found.add(node.module.partition(".")[0])
    return found - set(sys.stdlib_module_names) - {"bendtrack"}


def test_every_import_is_a_declared_dependency() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    lines = [*project["dependencies"], *extras["dlc-h5"], *extras["sleap"]]
    declared = {re.split(r"[^\w.-]", line)[0].lower() for line in lines}
    assert {INSTALLED_AS.get(module, module) for module in imported()} - declared == set()
