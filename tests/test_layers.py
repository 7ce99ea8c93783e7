"""The star: tracker knows nobody, models and labeling know tracker; front door and command line know all, but late.

Within models each floor knows the lower ones only.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import bendtrack
import bendtrack.labeling
import bendtrack.models
import bendtrack.tracker

PACKAGES = {
    "tracker": Path(bendtrack.tracker.__path__[0]),
    "models": Path(bendtrack.models.__path__[0]),
    "labeling": Path(bendtrack.labeling.__path__[0]),
}
ALLOWED = {"tracker": {"tracker"}, "models": {"models", "tracker"}, "labeling": {"labeling", "tracker"}}
FRONT_DOOR = {path.stem: path for path in sorted(Path(bendtrack.__path__[0]).glob("*.py"))}
HEAVY = {"torch", "torchvision", "safetensors"}
FLOORS = (
    "inference",
    "localization",
    "networks",
    "data",
    "denoising",
    "training",
    "pretraining",
    "adaptation",
)
"""The folders of models, from the lowest floor up; modules directly in models are above them all."""


def modules() -> list[tuple[str, Path]]:
    """Every module's dotted name under bendtrack, and its file."""
    found = [("" if name == "__init__" else name, path) for name, path in FRONT_DOOR.items()]
    for package, folder in PACKAGES.items():
        for path in sorted(folder.rglob("*.py")):
            parts = [package, *path.relative_to(folder).with_suffix("").parts]
            found.append((".".join(part for part in parts if part != "__init__"), path))
    return found


def imports(name: str, path: Path, *, at_import: bool = False) -> Iterator[str]:
    """Dotted names that a module imports, ours as "bendtrack....".

    at_import : only those that run when the module is imported, not those in functions or for type checkers
    """
    parts = name.split(".") if name else []
    package = parts if path.name == "__init__.py" else parts[:-1]

    def walk(node: ast.AST) -> Iterator[ast.AST]:
        for child in ast.iter_child_nodes(node):
            if at_import and isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
                continue
            if at_import and isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING":
                continue
            yield child
            yield from walk(child)

    for node in walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            if node.level == 0:
                yield node.module or ""
                continue
            base = ["bendtrack", *package[: len(package) - node.level + 1]]
            if node.module:
                yield ".".join([*base, node.module])
            else:
                yield from (".".join([*base, alias.name]) for alias in node.names)


def ours(imported: str) -> str | None:
    """The package of ours that an imported name belongs to."""
    parts = imported.split(".")
    return parts[1] if parts[0] == "bendtrack" and len(parts) > 1 else None


def floor(module: str) -> int:
    """The floor of a module of models, given as "models.inference.roi"."""
    folder = module.split(".")[1:2]
    return FLOORS.index(folder[0]) if folder and folder[0] in FLOORS else len(FLOORS)


@pytest.mark.parametrize(
    ("name", "path"), modules(), ids=lambda value: value if isinstance(value, str) else ""
)
def test_imports_follow_the_star(name: str, path: Path) -> None:
    package = name.split(".")[0]
    is_cli = name.startswith("tracker.cli")
    knows_all = is_cli or path in FRONT_DOOR.values()
    allowed = {*PACKAGES, *FRONT_DOOR} if knows_all else ALLOWED[package]
    for imported in imports(name, path):
        assert ours(imported) in {None, *allowed, *({"data_samples"} if is_cli else ())}, imported
        assert is_cli or not imported.startswith("bendtrack.tracker.cli"), (
            imported
        )  # it is a shell over all others
        if package != "models" and not is_cli:
            assert imported.split(".")[0] not in HEAVY, imported
        assert imported.split(".")[0] not in PACKAGES, imported


@pytest.mark.parametrize(
    ("name", "path"),
    [m for m in modules() if m[0].startswith("models")],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_models_import_their_own_floor_and_lower_ones(name: str, path: Path) -> None:
    for imported in imports(name, path):
        if ours(imported) == "models":
            assert floor(imported.removeprefix("bendtrack.")) <= floor(name), imported


@pytest.mark.parametrize(
    ("name", "path"),
    [m for m in modules() if m[0].startswith(("models.inference", "models.localization"))],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_inference_and_localization_import_no_torch(name: str, path: Path) -> None:
    for imported in imports(name, path):
        assert imported.split(".")[0] not in {"torch", "torchvision"}, imported


def test_every_folder_of_models_has_a_floor() -> None:
    folders = {name.split(".")[1] for name, path in modules() if path.parent.parent == PACKAGES["models"]}
    assert folders == set(FLOORS)


@pytest.mark.parametrize(
    ("name", "path"),
    [m for m in modules() if m[0].startswith("tracker.cli")],
    ids=lambda value: str(value)[-30:],
)
def test_the_command_line_imports_its_parts_inside_commands(name: str, path: Path) -> None:
    light = {"bendtrack.tracker.errors", "bendtrack.tracker.atomic"}
    for imported in imports(name, path, at_import=True):
        if ours(imported) is not None:
            assert imported in light or imported.startswith("bendtrack.tracker.cli"), imported
        else:
            top = imported.split(".")[0]
            assert top in sys.stdlib_module_names or top == "typer" or path.stem == "progress_bars", imported


def test_no_import_is_absolute_within_the_packages() -> None:
    # An absolute one could find another copy of the package, installed beside this tree.
    for name, path in modules():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                assert not (node.module or "").startswith("bendtrack"), (name, node.lineno)


def loaded_by(code: str) -> set[str]:
    """Top-level packages that a fresh interpreter has loaded after some code."""
    script = f"import sys\n{code}\nprint('\\n' + ' '.join({{name.split('.')[0] for name in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return set(done.stdout.splitlines()[-1].split())


def test_help_loads_nothing_heavy() -> None:
    # What makes `bendtrack --help` quick, without a clock.
    code = (
        "from bendtrack.tracker.cli import main\nsys.argv = ['bendtrack', '--help']\n"
        "try: main()\nexcept SystemExit: pass"
    )
    loaded = loaded_by(code)
    assert "typer" in loaded
    assert not loaded & {
        "torch",
        "numpy",
        "pandas",
        "cv2",
        "av",
        "h5py",
        "matplotlib",
        "pydantic",
        "scipy",
        "rich",
    }


@pytest.mark.parametrize(
    "code",
    [
        "import bendtrack.tracker",
        "from bendtrack.tracker import *",
        "from bendtrack.tracker import read_results, bending_angle, track, write_overlay, Project",
        "import bendtrack.tracker.synthetic.trial, bendtrack.tracker.figures, bendtrack.labeling",
    ],
)
def test_analysis_never_loads_torch(code: str) -> None:
    assert not loaded_by(code) & HEAVY


def test_the_front_door_costs_nothing_before_it_is_used() -> None:
    heavy = {
        *HEAVY,
        "numpy",
        "pandas",
        "openvino",
        "cv2",
        "av",
        "h5py",
        "matplotlib",
        "pydantic",
        "scipy",
        "typer",
    }
    assert not loaded_by("import bendtrack; bendtrack.__version__; dir(bendtrack)") & heavy


def test_a_project_is_opened_without_torch_and_openvino() -> None:
    code = "import bendtrack as bt; bt.open_project, bt.measure, bt.analyse, bt.read_results, bt.Project"
    assert not loaded_by(code) & {*HEAVY, "openvino"}


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_is_imported_under_its_full_name_only(package: str) -> None:
    # From the root of the repository `import tracker` would otherwise load a second copy of everything.
    done = subprocess.run(
        [sys.executable, "-c", f"import {package}"],
        cwd=PACKAGES[package].parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert f"import this package as bendtrack.{package}" in done.stderr
