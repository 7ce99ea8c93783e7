"""Whatever the packages import is declared: what comes along with something else today may not tomorrow."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from pathlib import Path

from bendtrack.tracker.extras import TRAINING_PACKAGES

ROOT = Path(__file__).parents[1]
# Modules that are not called like what is installed.
INSTALLED_AS = {
    "PIL": "pillow",
    "cv2": "opencv-python-headless",
    "fontTools": "fonttools",
    "yaml": "pyyaml",
    "pydantic_core": "pydantic",
    "sleap_io": "sleap-io",
    "ndx_pose": "ndx-pose",
}


def imported() -> set[str]:
    """Top-level modules that any file of the packages imports, wherever in it."""
    found: set[str] = set()
    for package in ("bendtrack", "tracker", "models", "labeling"):
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
    optional = [line for name in ("dlc-h5", "sleap", "xarray", "nwb") for line in extras[name]]
    lines = [*project["dependencies"], *optional]
    declared = {re.split(r"[^\w.-]", line)[0].lower() for line in lines}
    assert {INSTALLED_AS.get(module, module) for module in imported()} - declared == set()


def test_the_versions_tested_with_are_allowed_and_all_there() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lines = (ROOT / "requirements" / "constraints-tested.txt").read_text(encoding="utf-8").splitlines()
    tested = dict(line.split("==") for line in lines if not line.startswith("#"))
    for line in [*project["dependencies"], *project["optional-dependencies"]["test"]]:
        name, lowest = line.split(">=")
        version = tested[name.lower()]
        assert [int(part) for part in version.split(".")[:3]] >= [int(part) for part in lowest.split(".")], (
            line
        )


def test_tracking_alone_needs_all_but_what_trains() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lines = (ROOT / "requirements" / "track-only.txt").read_text(encoding="utf-8").splitlines()
    left = set(project["dependencies"]) - {line for line in lines if not line.startswith("#")}
    assert (
        {re.split(r"[^\w.-]", line)[0] for line in left}
        == {"torch", "torchvision", "nncf"}
        == set(TRAINING_PACKAGES)
    )
    assert {line for line in lines if not line.startswith("#")} <= set(project["dependencies"])
