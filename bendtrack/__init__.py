"""bendtrack: bending angles of soft actuators from plain video, without markers.

The names in `__all__` are the front door; each is loaded when it is first asked for, so importing
bendtrack costs nothing.

>>> import bendtrack as bt
>>> bt.measure("a.mp4").angle_deg  # no labels # doctest: +SKIP
>>> project = bt.open_project("my-study")  # doctest: +SKIP
>>> project.train(max_minutes=5)  # doctest: +SKIP
>>> project.track("a.mp4").to_dataframe()  # doctest: +SKIP
>>> bt.analyse("study.toml").dynamic  # doctest: +SKIP
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .measuring import measure
    from .project import Project, new_project, open_project
    from .studies import analyse
    from .tracker.results import read_results

# In a copy of the repository the rooms lie next to this folder, not in it. From its root this copy is imported whole,
# also where a wheel of another version is installed.
if not os.path.isdir(os.path.join(__path__[0], "tracker")):
    __path__.append(os.path.dirname(__path__[0]))

_HOMES = {
    "Project": "project",
    "analyse": "studies",
    "measure": "measuring",
    "new_project": "project",
    "open_project": "project",
    "read_results": "tracker.results",
}

__all__ = ["Project", "analyse", "measure", "new_project", "open_project", "read_results"]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("bendtrack")
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOMES[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, "__version__"})
