"""Every example in a docstring is run, in every module as installed."""

from __future__ import annotations

import doctest
import importlib
import pkgutil
from pathlib import Path

import pytest

import bendtrack
import bendtrack.labeling
import bendtrack.models
import bendtrack.tracker

MODULES = [
    "bendtrack",
    *(f"bendtrack.{path.stem}" for path in Path(bendtrack.__file__).parent.glob("[!_]*.py")),
] + [
    found.name
    for package in (bendtrack.tracker, bendtrack.models, bendtrack.labeling)
    for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
]


@pytest.mark.parametrize("name", MODULES)
def test_examples(name: str) -> None:
    assert doctest.testmod(importlib.import_module(name)).failed == 0


def test_there_are_examples() -> None:
    finder = doctest.DocTestFinder(exclude_empty=True)
    examples = [e for name in MODULES for t in finder.find(importlib.import_module(name)) for e in t.examples]
    assert len(examples) > 5
