"""README, getting started and the tutorials do what they say: every shell and Python block is run in a folder.

Films are rendered small and trainings take two steps; `SHORTER` says how. What cannot run here is in `NOT_RUN`,
with the reason. Also here: no document is too long, no relative link is dead, every command that the pages name
exists.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import chdir
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest
import typer

from bendtrack.tracker.cli import app
from bendtrack.tracker.results import read_results, write_results
from bendtrack.tracker.synthetic.trial import read_trial, render_trial

if TYPE_CHECKING:
    from conftest import Bendtrack

ROOT = Path(__file__).parents[1]
STUDY = "docs/tutorials/study.md"
RUN = (
    "README.md",
    "docs/getting-started.md",
    STUDY,
    "docs/tutorials/without-labels.md",
    "docs/tutorials/python.md",
)
PAGES = sorted(
    path.relative_to(ROOT).as_posix()
    for path in (*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("*/**/README.md"))
    if not {".venv", "build", "node_modules", "gallery"} & set(path.relative_to(ROOT).parts)
)

NOT_RUN = {
    "python3 -m venv": "installs for minutes over the network; .ci/run does it",
    ".venv/bin/pip": "the same",
    "source .venv/bin/activate": "the tests run in an environment already",
    "bendtrack demo": "trains for a minute; test_cli_demo.py and .ci/run do it",
    "bendtrack label my-study": "waits for clicks in a browser; tests/browser does it, here labels are imported",
    "bendtrack angle trial/trial.mp4 --label": "the same",
    "bendtrack angle video.mp4 --label": "the same",
    "bendtrack frames one-label/labels": "goes on from such clicks",
    "bendtrack label one-label/labels": "the same",
    "bendtrack live my-study 0": "needs a camera; test_cli_live.py plays a file",
}
"""Commands, by their beginning, that are not run, and why."""

SHORTER = (
    # Films of some hundred frames become some dozen, of a quarter of the size.
    (r"(bendtrack render films\S+)", r"\1 --frame-rate 6 --size 320x240"),
    (
        r"bendtrack render trial --seed 7.*",
        "bendtrack render trial --seed 7 --cycles 1 --frequency-hz 0.25 --frame-rate 3 --size 320x240",
    ),
    (r"--cycles 4\b", "--cycles 3"),
    (r"--labels 30\b", "--labels 8"),
    (r"--end-vector-px 60\b", "--end-vector-px 30"),
    (r"(bendtrack frames my-study \S+)", r"\1 --count 3"),
    # Compiling takes longer than these few frames in torch; adapting to an actuator takes a minute.
    (r"(bendtrack track my-study \S+)", r"\1 --engine torch"),
    (r"(bendtrack angle \S+)", r"\1 --engine torch --quick"),
    # The same in Python.
    (r"(project\.track\([^)]*)", r'\1, engine="torch"'),
    (r"(bt\.measure\([^)]*)", r'\1, engine="torch", adapt=False'),
)
"""What is changed in a command or a Python block before it is run."""

ONE_CYCLE = {"seed": 7, "cycles": 1, "frequency_hz": 0.25, "frame_rate": 3.0, "size_wh": (320, 240)}
"""A film that `angle` finds its actuator in."""


@dataclass(frozen=True)
class Block:
    """A fenced block of a document.

    Attributes
    ----------
    language : str
        As written after the fence, such as "sh" or "python".
    text : str
        What is in it.
    line : int
        Where it begins in the document, from 1.
    needs : tuple of str
        Modules that it needs and that not every installation has.
    """

    language: str
    text: str
    line: int
    needs: tuple[str, ...]


_BLOCK = re.compile(
    r"^(?:<!-- test: needs (?P<needs>.*?) -->\n)?```(?P<language>\w+)\n(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)


def blocks(document: str) -> Iterator[Block]:
    text = (ROOT / document).read_text(encoding="utf-8")
    for found in _BLOCK.finditer(text):
        line = text.count("\n", 0, found.start()) + 1
        yield Block(found["language"], found["text"], line, tuple(re.findall(r"\w+", found["needs"] or "")))


def commands(block: Block) -> list[str]:
    return [line for line in block.text.splitlines() if line.strip() and not line.startswith("#")]


def reason_not_to_run(command: str) -> str | None:
    return next((reason for beginning, reason in NOT_RUN.items() if command.startswith(beginning)), None)


def shortened(command: str) -> str:
    for pattern, replacement in SHORTER:
        command = re.sub(pattern, replacement, command)
    return command


def short_training(folder: Path) -> None:
    """As little as there can be: the network is right about nothing, and everything around it must hold."""
    toml = folder / "my-study" / "bendtrack.toml"
    few = '[training]\ninit = "random"\nsteps = 2\nbatch_frames = 1\n'
    toml.write_text(toml.read_text().replace("[training]\n", few))


def clicked_labels(folder: Path, bendtrack: Bendtrack) -> None:
    """What a person would click on the page."""
    for film in sorted((folder / "films").iterdir()):
        video = film / f"{film.name}.mp4"
        if not (film / "labels.csv").exists():
            continue
        assert bendtrack("import", folder / "my-study", film / "labels.csv", "--video", video).status == 0


def exact_results(folder: Path) -> None:
    """The angles that a network would find that is right, in place of those of two steps of training."""
    for film in sorted((folder / "films").iterdir()):
        results = folder / "my-study" / "results"
        found, truth = read_results(results / f"{film.name}.h5"), read_trial(film)
        exact = replace(
            found,
            angle_deg=truth.angle_deg,
            angle_sd_deg=np.full(len(found), 0.3),
            flag=np.full(len(found), ""),
        )
        write_results(exact, results, film.name)


def logs_in_the_project(folder: Path) -> None:
    """Where README says that the logs lie."""
    for film in sorted((folder / "films").iterdir()):
        shutil.copy(film / "pressure.csv", folder / "my-study" / f"{film.name}.csv")


def by_hand(command: str, folder: Path, bendtrack: Bendtrack) -> None:
    """What a reader does after a command, or what makes the next ones short."""
    if command.startswith("bendtrack new my-study"):
        short_training(folder)
    elif command.startswith("bendtrack label my-study"):
        clicked_labels(folder, bendtrack)
    elif command.startswith("bendtrack track my-study") or "project.track(" in command:
        exact_results(folder)
        if "videos/" in command:
            logs_in_the_project(folder)


def run_command(command: str, folder: Path, where: str, bendtrack: Bendtrack, installed: bool) -> None:
    words = shlex.split(command, comments=True)
    if words[0] == "bendtrack":
        ran = bendtrack.installed(*words[1:], cwd=folder) if installed else bendtrack(*words[1:])
        # So few labels of so short films look like mistakes, which is status 1.
        fine = (0, 1) if words[1:3] == ["labels", "check"] else (0,)
        assert ran.status in fine, f"{where}: {command}\n{ran.out}\n{ran.err}"
    else:
        subprocess.run(words, cwd=folder, check=True)


def run_document(document: str, folder: Path, bendtrack: Bendtrack, installed: bool = False) -> None:
    """Run every block of a document, in order; Python blocks share their names.

    Parameters
    ----------
    folder : Path
        Where to run it: the current folder.
    installed : bool
        Whether each command runs in a process of its own, as users do it. One process spares torch's imports.
    """
    names: dict[str, object] = {"__name__": "__main__"}
    for block in blocks(document):
        where = f"{document}:{block.line}"
        if not all(map(find_spec, block.needs)):
            continue
        if block.language == "python":
            exec(compile(shortened(block.text), where, "exec"), names)
            by_hand(block.text, folder, bendtrack)
        for command in commands(block) if block.language == "sh" else ():
            if reason_not_to_run(command) is None:
                run_command(shortened(command), folder, where, bendtrack, installed)
            by_hand(command, folder, bendtrack)


@pytest.fixture(scope="session")
def study(tmp_path_factory: pytest.TempPathFactory, bendtrack: Bendtrack) -> Path:
    """The folder in which the first lesson was followed."""
    folder = tmp_path_factory.mktemp("lesson")
    with chdir(folder):
        run_document(STUDY, folder, bendtrack)
    return folder


@pytest.mark.slow
def test_the_study_lesson_ends_with_its_report(study: Path) -> None:
    report = study / "my-study" / "study-report"
    assert (report / "report.html").is_file()
    # The films were rendered with this ratio, and the lesson says that the report finds it.
    trials = pd.read_csv(report / "tables" / "dynamic.csv")
    assert trials["hysteresis_ratio"].to_numpy() == pytest.approx(0.25, abs=0.02)
    # "The designs compared", as the lesson promises: at one pressure, and the ratios at one angle that both reach.
    ranking = pd.read_csv(report / "tables" / "ranking.csv")
    assert set(ranking.loc[ranking["metric"] == "hysteresis_ratio", "design"]) == {"original", "wider"}
    page = (report / "report.html").read_text(encoding="utf-8")
    assert 'id="ranking"' in page
    for name in (
        "original_0.25Hz_50kPa",
        "wider_0.25Hz_50kPa",
        "original_0.25Hz_40kPa",
        "wider_0.25Hz_40kPa",
    ):
        for suffix in ("csv", "h5", "json", "png"):
            assert (study / "my-study" / "results" / f"{name}.{suffix}").is_file()


@pytest.mark.slow
def test_the_python_lesson_goes_on_from_there(study: Path, tmp_path: Path, bendtrack: Bendtrack) -> None:
    folder = shutil.copytree(study, tmp_path / "lesson")
    with chdir(folder):
        run_document("docs/tutorials/python.md", folder, bendtrack)
    assert (folder / "loops.png").stat().st_size > 1000


@pytest.mark.slow
def test_the_lesson_without_labels(tmp_path: Path, bendtrack: Bendtrack) -> None:
    with chdir(tmp_path):
        run_document("docs/tutorials/without-labels.md", tmp_path, bendtrack)
    assert len(read_results(tmp_path / "first-look" / "trial.csv")) > 10


@pytest.mark.slow
def test_getting_started(tmp_path: Path, bendtrack: Bendtrack) -> None:
    # The page that says how to install: here each command is the installed program.
    run_document("docs/getting-started.md", tmp_path, bendtrack, installed=True)
    for suffix in ("csv", "h5", "json", "png"):
        assert (tmp_path / "bendtrack-angles" / f"trial.{suffix}").is_file()


@pytest.mark.slow
def test_readme(study: Path, tmp_path: Path, bendtrack: Bendtrack) -> None:
    # What a reader has: videos. One will do.
    film = "original_0.25Hz_50kPa"
    shutil.copytree(study / "films" / film, tmp_path / "films" / film)
    (tmp_path / "videos").mkdir()
    shutil.copy(tmp_path / "films" / film / f"{film}.mp4", tmp_path / "videos")
    with chdir(tmp_path):
        shutil.copy(render_trial(tmp_path / "one", **ONE_CYCLE).video_path, "video.mp4")
        run_document("README.md", tmp_path, bendtrack)
    assert (tmp_path / "my-study" / "results" / f"{film}.csv").is_file()
    assert (tmp_path / "my-study" / "study-report" / "report.html").is_file()
    assert (tmp_path / "bendtrack-angles" / "video.csv").is_file()


def test_every_block_is_run_or_the_reason_is_here() -> None:
    left = {
        beginning
        for document in RUN
        for block in blocks(document)
        if block.language == "sh"
        for command in commands(block)
        for beginning in NOT_RUN
        if command.startswith(beginning)
    }
    assert left == set(NOT_RUN), "a reason that nothing needs any more"
    languages = {block.language for document in RUN for block in blocks(document)}
    assert languages <= {"sh", "python", "powershell", "toml", "text"}
    # A fence that the pattern does not find would not be run.
    for document in RUN:
        fences = re.findall(r"^```(sh|python)$", (ROOT / document).read_text(encoding="utf-8"), re.MULTILINE)
        assert len(fences) == sum(block.language in ("sh", "python") for block in blocks(document))


@pytest.mark.parametrize(("document", "most"), [("README.md", 900), ("models/weights/README.md", 800)])
def test_nobody_has_to_read_too_much(document: str, most: int) -> None:
    assert len((ROOT / document).read_text(encoding="utf-8").split()) <= most


@pytest.mark.parametrize("document", PAGES)
def test_no_link_is_dead(document: str) -> None:
    path = ROOT / document
    text = re.sub(
        r"^```(?!\{include).*?^```$", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL
    )
    text = re.sub(r"`[^`\n]*`", "", text)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        file = target.partition("#")[0]
        if re.match(r"[a-z]+:", target) or not file:
            continue
        there = (path.parent / file).resolve()
        if "gallery" in there.parts:
            # Made by the build from the examples.
            there = there.parents[1] / "examples" / (f"{there.name}.py" if there.name != "index" else "")
        assert any(there.with_name(there.name + suffix).exists() for suffix in ("", ".md")), target


@pytest.mark.parametrize("document", PAGES)
def test_every_command_and_option_exists(document: str) -> None:
    """Of all blocks for a shell, also those that are not run: in the guides, in the reference, for PowerShell."""
    program = typer.main.get_command(app)
    for block in blocks(document):
        if block.language not in ("sh", "powershell"):
            continue
        for line in commands(block):
            for part in re.split(r"&&|;|\|", line.split(" #")[0]):
                words = shlex.split(part.replace("\\", "/"))
                if not words or Path(words[0]).name != "bendtrack":
                    continue
                command = program
                while hasattr(command, "commands") and len(words) > 1 and not words[1].startswith("-"):
                    assert words[1] in command.commands, line
                    command, words = command.commands[words[1]], words[1:]
                known = {option for parameter in command.params for option in parameter.opts} | {
                    "--help",
                    "--version",
                    "--quiet",
                    "--debug",
                }
                asked = {word.partition("=")[0] for word in words[1:] if word.startswith("--")}
                assert asked <= known, f"{document}:{block.line}: {line}"
