"""Projects on disk: made, opened, moved, edited; and every mistake in bendtrack.toml gets one clear line."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.errors import AngleError, ProjectError
from bendtrack.tracker.project import Project

FOUR = ("base_1", "base_2", "tip_1", "tip_2")


def project_with(tmp_path: Path, text: str) -> Path:
    root = tmp_path / "study"
    root.mkdir()
    (root / "bendtrack.toml").write_text(text, encoding="utf-8")
    return root


def test_a_new_project_opens_again_and_says_what_it_measures(tmp_path: Path) -> None:
    made = Project.create(tmp_path / "deep" / "study", keypoints=FOUR)
    opened = Project.open(made.root)
    assert opened.settings == made.settings
    assert opened.keypoints == FOUR
    assert opened.angle_definition() == AngleDefinition("two-vector", FOUR, 1)
    assert [p.name for p in made.root.iterdir()] == ["bendtrack.toml"]


def test_a_project_can_be_moved(tmp_path: Path) -> None:
    made = Project.create(tmp_path / "study", keypoints=FOUR)
    shutil.move(made.root, tmp_path / "elsewhere")
    moved = Project.open(tmp_path / "elsewhere")
    assert moved.settings == made.settings
    assert moved.labels_dir == tmp_path / "elsewhere" / "labeled-data"
    assert str(tmp_path) not in (moved.root / "bendtrack.toml").read_text()


def test_three_keypoints_get_the_three_point_angle_unless_told(tmp_path: Path) -> None:
    assert (
        Project.create(tmp_path / "a", keypoints=["a", "b", "c"]).settings.angle.definition == "three-point"
    )
    assert (
        Project.create(tmp_path / "b", keypoints=["a", "b", "c"], angle="chord").settings.angle.definition
        == "chord"
    )


def test_every_setting_is_read(tmp_path: Path) -> None:
    root = project_with(
        tmp_path,
        """
        keypoints = ["Basis 1", "b.2", "mid", "tip-1", "Spitze_ü"]
        scorer = "Ana"
        [angle]
        definition = "arc-fit"
        points = ["b.2", "mid", "tip-1"]
        sign = "-"
        [actuators]
        thick = ["thick 40kPa", "videos/thick_45kPa.MP4"]
        [training]
        backbone = "resnet34"
        init = "imagenet"
        max_minutes = 3
        seed = 7
        [tracking]
        min_likelihood = 0.4
        """,
    )
    settings = Project.open(root).settings
    assert Project.open(root).angle_definition() == AngleDefinition("arc-fit", ("b.2", "mid", "tip-1"), -1)
    assert (settings.training.backbone, settings.training.max_minutes, settings.training.seed) == (
        "resnet34",
        3.0,
        7,
    )
    assert settings.tracking.min_likelihood == 0.4
    assert [settings.actuator_of(v) for v in ("thick 40kPa", "thick_45kPa", "other")] == [
        "thick",
        "thick",
        "default",
    ]


def test_a_file_from_a_windows_editor_is_read(tmp_path: Path) -> None:
    root = tmp_path / "study"
    root.mkdir()
    text = 'keypoints = ["a", "b", "c", "d"]\r\nscorer = "Zoë"\r\n'
    (root / "bendtrack.toml").write_bytes(text.encode("utf-8-sig"))
    assert Project.open(root).settings.scorer == "Zoë"


KEYPOINTS = 'keypoints = ["a", "b", "c", "d"]\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("keypoints = ['a',\n'b']\nscorer = me", "expected TOML, got a mistake: .*line 3"),
        (KEYPOINTS + "[angel]\nsign = '+'", "unknown key 'angel' (did you mean 'angle'?); expected"),
        (
            KEYPOINTS + "[training]\nbackbon = 'resnet18'",
            "unknown key 'training.backbon' (did you mean 'backbone'?); expected one of backbone, init,",
        ),
        (KEYPOINTS + "[training]\nseed = 'seven'", "training.seed: expected a valid integer, got 'seven'"),
        (KEYPOINTS + "[training]\nmax_minutes = -1", "training.max_minutes: expected greater than 0, got -1"),
        (KEYPOINTS + "[training]\nbackbone = 'vgg'", "'resnet34' or 'resnet50', got 'vgg'"),
        (KEYPOINTS + "[tracking]\nmin_likelihood = '0.6'", "expected a valid number, got '0.6'"),
        (KEYPOINTS + "[tracking]\nmin_likelihood = 60", "expected less than or equal to 1, got 60"),
        (KEYPOINTS + "[angle]\nsign = 'plus'", "angle.sign: expected 'auto', '+' or '-', got 'plus'"),
        (KEYPOINTS + "[angle]\npoints = ['a', 'b', 'c', 'e']", "some of the keypoints a, b, c, d, got e"),
        (KEYPOINTS + "[angle]\npoints = ['a', 'b', 'c']", "'two-vector' expected at least 4 points, got 3"),
        (KEYPOINTS + "training = 3", "training: expected a [section], got 3"),
        (KEYPOINTS + "[actuators]\nx = ['v.mp4']\ny = ['v']", "in one actuator, got 'v' in 'x' and in 'y'"),
        ("scorer = 'me'", "expected the key 'keypoints', got none"),
        ("keypoints = []", "keypoints: expected at least one name, got none"),
        ("keypoints = ['a', 'b', 'a', 'c']", "keypoints: expected distinct names, got 'a' twice"),
        ("keypoints = ['a', 'b,c', 'd', 'e']", "name of letters, digits, spaces and _ . + - (beginning"),
        ("keypoints = ['a', '=1+2', 'd', 'e']", "got '=1+2'"),
        ("keypoints = ['a', ' b', 'd', 'e']", "got ' b'"),
        ("keypoints = ['a', 2, 'd', 'e']", "keypoints[2]: expected a valid string, got 2"),
        ("keypoints = 'a'", "keypoints: expected a list, got 'a'"),
        ("keypoints = ['a', 'b']", "angle 'two-vector' expected at least 4 keypoints, got 2: a, b"),
    ],
)  # fmt: skip
def test_a_mistake_in_the_file_gets_one_line(tmp_path: Path, text: str, message: str) -> None:
    root = project_with(tmp_path, text)
    pattern = message if ".*" in message else re.escape(message)
    with pytest.raises(ProjectError, match=pattern) as caught:
        Project.open(root)
    assert "\n" not in str(caught.value)
    assert "bendtrack.toml" in str(caught.value)


def test_what_is_not_a_project_says_what_it_is(tmp_path: Path) -> None:
    with pytest.raises(ProjectError, match="got no such file or folder"):
        Project.open(tmp_path / "nowhere")
    (tmp_path / "file").touch()
    with pytest.raises(ProjectError, match="got a file"):
        Project.open(tmp_path / "file")
    with pytest.raises(ProjectError, match=r"with bendtrack\.toml in it"):
        Project.open(tmp_path)
    (tmp_path / "latin").mkdir()
    (tmp_path / "latin" / "bendtrack.toml").write_bytes(b'scorer = "Zo\xeb"')
    with pytest.raises(ProjectError, match="expected UTF-8"):
        Project.open(tmp_path / "latin")


def test_create_leaves_alone_what_is_there(tmp_path: Path) -> None:
    full = tmp_path / "full"
    full.mkdir()
    (full / "thesis.tex").write_text("precious")
    with pytest.raises(ProjectError, match="with files in it"):
        Project.create(full, keypoints=FOUR)
    assert [p.name for p in full.iterdir()] == ["thesis.tex"]

    made = Project.create(tmp_path / "study", keypoints=FOUR)
    before = (made.root / "bendtrack.toml").read_bytes()
    with pytest.raises(ProjectError, match="got a bendtrack project"):
        Project.create(made.root, keypoints=("a", "b", "c"))
    assert (made.root / "bendtrack.toml").read_bytes() == before

    (tmp_path / "file").touch()
    with pytest.raises(ProjectError, match="got a file"):
        Project.create(tmp_path / "file", keypoints=FOUR)


@pytest.mark.parametrize(
    ("keypoints", "angle"), [(("a", "b"), None), (FOUR[:3], "two-vector"), (FOUR, "arcfit")]
)
def test_create_with_keypoints_that_do_not_fit_makes_nothing(
    tmp_path: Path, keypoints: tuple[str, ...], angle: str | None
) -> None:
    with pytest.raises(ProjectError, match="the new project: "):
        Project.create(tmp_path / "study", keypoints=keypoints, angle=angle)
    assert not (tmp_path / "study").exists()


def test_auto_sign_is_judged_from_the_labels(tmp_path: Path) -> None:
    project = Project.create(tmp_path / "study", keypoints=FOUR)
    up_on_the_screen = np.array([[[0.0, 0.0], [10.0, 0.0], [20.0, -10.0], [20.0, -20.0]]])
    assert project.angle_definition(up_on_the_screen).sign == -1
    assert project.angle_definition(up_on_the_screen * [1, -1]).sign == 1
    with pytest.raises(AngleError, match="auto"):
        project.angle_definition(up_on_the_screen * np.nan)


def test_assigning_videos_keeps_the_users_comments_and_moves_a_video(tmp_path: Path) -> None:
    root = project_with(
        tmp_path,
        '# my study\nkeypoints = ["a", "b", "c", "d"]  # base first\n\n'
        '[actuators]\n# the first ones\nold = ["v1", "v2"]\n',
    )
    project = Project.open(root)
    project.assign_actuator("new", ["somewhere/v2.mp4", "v3"])
    text = (root / "bendtrack.toml").read_text()
    for comment in ("# my study", "# base first", "# the first ones"):
        assert comment in text
    again = Project.open(root)
    assert again.settings == project.settings
    assert dict(again.settings.actuators) == {"old": ("v1",), "new": ("v2", "v3")}


def test_assigning_to_a_name_that_cannot_be_changes_nothing(tmp_path: Path) -> None:
    project = Project.create(tmp_path / "study", keypoints=FOUR)
    before = (project.root / "bendtrack.toml").read_bytes()
    with pytest.raises(ProjectError, match="actuator name"):
        project.assign_actuator("a,b", ["v1"])
    assert (project.root / "bendtrack.toml").read_bytes() == before
    project.assign_actuator("first", ["v1"])
    assert project.actuator_of("v1") == "first"
