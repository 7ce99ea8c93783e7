"""import bendtrack as bt: what a Python program does with a project, a video and a study."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import bendtrack as bt
from bendtrack.models.detector import NetworkDetector
from bendtrack.tracker.errors import BendtrackWarning, LabelError, ProjectError, StudyError, VideoError
from bendtrack.tracker.project import Project as ProjectFolder

ROOT = Path(__file__).parents[1]


def test_a_new_project_is_opened_again(tmp_path: Path) -> None:
    made = bt.new_project(tmp_path / "study", keypoints=("root", "knee", "tip"))
    opened = bt.open_project(tmp_path / "study")
    assert opened.path == made.path == tmp_path / "study"
    assert opened.keypoints == ("root", "knee", "tip")
    assert opened.settings.angle.definition == "three-point"
    assert (opened.labels, opened.models) == ([], [])
    with pytest.raises(ProjectError, match="expected a new folder"):
        bt.new_project(tmp_path / "study")


def test_from_video_to_frames_and_labels_out_and_in(
    project: ProjectFolder, write_arm_video, tmp_path: Path
) -> None:
    own = bt.open_project(project.root)
    report = own.add_frames(write_arm_video(tmp_path / "a.mp4", 40), count=5)
    assert [len(images) for images in report.saved.values()] == [5]
    assert len(own.labels) == 10
    assert own.export(tmp_path / "dlc", format="dlc").labelled == 10
    other = bt.new_project(tmp_path / "other")
    assert other.import_labels(tmp_path / "dlc").labelled == 10
    assert [frame.xy.tolist() for frame in other.labels] == [frame.xy.tolist() for frame in own.labels]


def test_without_labels_it_says_what_comes_first(tmp_path: Path) -> None:
    own = bt.new_project(tmp_path / "my study")
    with pytest.raises(LabelError) as refused:
        own.train()
    said = str(refused.value)
    for command in ("frames", "label", "import"):
        assert f"`bendtrack {command} '{own.path}'" in said
    assert said.index("frames") < said.index("label '") < said.index("import")


def test_a_network_is_trained_judged_and_tracks(
    project: ProjectFolder, write_arm_video, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = bt.open_project(project.root)
    trained = own.train("mine", seed=3)
    assert trained.folder == project.models_dir / "mine"
    assert trained.steps == 2
    assert trained.evaluation is not None
    assert own.models == ["mine"]
    assert own.evaluate().error_px.shape == (2, 4)
    video = write_arm_video(tmp_path / "a.mp4", 12)
    table = own.track(video, engine="torch")
    assert table.angle_deg.shape == (12,)
    assert len(table.to_dataframe()) == 12
    stored = bt.read_results(project.results_dir / "a.h5")
    np.testing.assert_array_equal(stored.angle_deg, table.angle_deg)
    again = own.track([video, video.parent], engine="torch", overlay=True)
    assert [len(one) for one in again] == [12]
    assert (project.results_dir / "a.overlay.mp4").is_file()
    assert capsys.readouterr().out == ""  # only the command line prints


def test_the_others_are_done_when_a_video_fails(
    trained_project: ProjectFolder, write_arm_video, tmp_path: Path
) -> None:
    good = write_arm_video(tmp_path / "good.mp4", 5)
    bad = tmp_path / "bad.mp4"
    bad.write_bytes(b"no video at all")
    with pytest.raises(VideoError, match=r"bad\.mp4: not a video"):
        bt.open_project(trained_project.root).track([bad, good])
    assert len(bt.read_results(trained_project.results_dir / "good.h5")) == 5


def test_another_angle_in_the_settings_is_warned_of(
    trained_project: ProjectFolder, write_arm_video, tmp_path: Path
) -> None:
    toml = trained_project.root / "bendtrack.toml"
    toml.write_text(toml.read_text().replace('definition = "two-vector"', 'definition = "arc-fit"'))
    with pytest.warns(BendtrackWarning, match="names another angle"):
        bt.open_project(trained_project.root).track(write_arm_video(tmp_path / "a.mp4", 5))


def test_measure_finds_the_actuator_and_writes_nothing(
    trained_project: ProjectFolder, write_arm_video, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What `for_video` finds is tested with the network; here: that it is asked, and what becomes of it."""
    asked = []

    def for_video(detector: NetworkDetector, frames: object, progress: object) -> NetworkDetector:
        asked.append(detector.stages.self_training)
        return detector

    monkeypatch.setattr(NetworkDetector, "for_video", for_video)
    (tmp_path / "films").mkdir()
    video = write_arm_video(tmp_path / "films" / "a.mp4", 9)
    table = bt.measure(video, model=trained_project.models_dir / "model", adapt=False)
    assert len(table) == 9
    assert asked == [False]
    assert [path.name for path in video.parent.iterdir()] == ["a.mp4"]


def test_a_study_that_cannot_be_read_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match="expected a study file"):
        bt.analyse(tmp_path / "none.toml")


# --- without torch ---------------------------------------------------------------------------------------

WITHOUT_TORCH = """\
import sys


class NotInstalled:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("torch", "torchvision", "nncf"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, NotInstalled())
sys.argv = ["bendtrack", *sys.argv[1:]]
from bendtrack.tracker.cli import main
main()
"""


def without_torch(*words: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", WITHOUT_TORCH, *map(str, words)], capture_output=True, text=True, check=False
    )


def test_a_compiled_network_tracks_without_torch(
    trained_project: ProjectFolder, write_arm_video, tmp_path: Path
) -> None:
    ran = without_torch("track", trained_project.root, write_arm_video(tmp_path / "a.mp4", 12), "--overlay")
    assert (ran.returncode, ran.stderr) == (0, "")
    assert len(bt.read_results(trained_project.results_dir / "a.csv")) == 12


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (("train",), "needs torch"),
        (("evaluate",), "evaluating needs torch"),
        (("track", "VIDEO", "--engine", "torch"), "'model' with engine torch needs torch"),
    ],
)
def test_what_needs_torch_says_so_in_one_line(
    trained_project: ProjectFolder, write_arm_video, tmp_path: Path, words: tuple[str, ...], what: str
) -> None:
    video = write_arm_video(tmp_path / "a.mp4", 5)
    command, *rest = (video if word == "VIDEO" else word for word in words)
    ran = without_torch(command, trained_project.root, *rest)
    assert ran.returncode == 2
    assert ran.stderr.count("\n") == 1
    assert what in ran.stderr
    assert ran.stderr.endswith(
        "which is not installed: in the copy of the repository run .venv/bin/pip install .\n"
    )


def test_a_network_that_is_not_compiled_says_so_without_torch(
    trained_project: ProjectFolder, write_arm_video, tmp_path: Path
) -> None:
    (trained_project.models_dir / "model" / "engine" / "engine.json").unlink()
    ran = without_torch("track", trained_project.root, write_arm_video(tmp_path / "a.mp4", 5))
    assert ran.returncode == 2
    assert "'model' is not compiled for this machine yet, which needs torch" in ran.stderr


def test_from_the_root_of_the_repository_one_copy_is_imported() -> None:
    """Whatever is installed: a front door of this copy with rooms of another would be worse than none."""
    if not (ROOT / "bendtrack").is_dir():
        pytest.skip("the tests run without the packages next to them")
    code = (
        "import bendtrack, bendtrack.tracker as t, bendtrack.models as m; print(t.__path__[0], m.__path__[0])"
    )
    done = subprocess.run(
        [sys.executable, "-I", "-c", f"import sys; sys.path.insert(0, {str(ROOT)!r}); {code}"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == [str(ROOT / "tracker"), str(ROOT / "models")]


def test_the_front_door_is_installed_next_to_the_rooms() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    assert "bendtrack" in settings["packages"]
    assert settings["package-dir"]["bendtrack"] == "bendtrack"
