"""The names that other programs may build on. A change here is a change of the contract: CHANGELOG.md."""

from __future__ import annotations

import importlib
import inspect
from importlib.metadata import version
from types import ModuleType

import pytest

PUBLIC = {
    "bendtrack": ["Project", "analyse", "measure", "new_project", "open_project", "read_results"],
    "bendtrack.tracker": [
        "AngleDefinition",
        "AngleTable",
        "Detections",
        "Detector",
        "LabelledFrame",
        "Project",
        "StudyResults",
        "Video",
        "analyse_study",
        "bending_angle",
        "load_trials",
        "read_results",
        "read_study",
        "track",
        "write_overlay",
        "write_report",
        "write_results",
    ],
    "bendtrack.models": [
        "Checkpoint",
        "Evaluation",
        "NetworkDetector",
        "TrainingSettings",
        "cross_validate",
        "evaluate",
        "load_checkpoint",
        "train",
    ],
    "bendtrack.labeling": ["ImportReport", "LabelStore", "export_dlc", "import_dlc"],
}


@pytest.mark.parametrize("package", PUBLIC)
def test_the_list_is_this_one(package: str) -> None:
    assert sorted(importlib.import_module(package).__all__) == sorted(PUBLIC[package])


@pytest.mark.parametrize(("package", "name"), [(p, n) for p, names in PUBLIC.items() for n in names])
def test_each_is_there_documented_and_no_module(package: str, name: str) -> None:
    value = getattr(importlib.import_module(package), name)
    assert not isinstance(value, ModuleType)  # a module and what it exports never share a name
    assert inspect.getdoc(value)


def test_a_wrong_name_is_an_attribute_error() -> None:
    package = importlib.import_module("bendtrack.tracker")
    with pytest.raises(AttributeError, match="no attribute 'bendingangle'"):
        package.bendingangle  # noqa: B018


def test_lazy_names_are_listed_for_completion() -> None:
    for name in ("bendtrack", "bendtrack.tracker"):
        package = importlib.import_module(name)
        assert set(package.__all__) <= set(dir(package))


def test_the_version_is_the_installed_one() -> None:
    package = importlib.import_module("bendtrack")
    assert package.__version__ == version("bendtrack")
    assert "__version__" in dir(package)
