"""COCO keypoints in and out: files as COCO, CVAT and Label Studio write them, built here."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bendtrack.labeling.interop.coco import export_coco, open_coco
from bendtrack.labeling.store import LabelStore
from bendtrack.tracker.errors import LabelError
from bendtrack.tracker.project import Project

NAMES = ["base_1", "base_2", "tip_1", "tip_2"]
FOUR = [10, 7, 2, 20.5, 7.25, 2, 30, 40, 2, 50, 60, 2]


def category(number: int = 1, name: str = "gripper", **changes: Any) -> dict[str, Any]:
    return {"id": number, "name": name, "supercategory": "", "keypoints": NAMES, "skeleton": []} | changes


def annotation(image: int, keypoints: Any = FOUR, kind: int = 1, **changes: Any) -> dict[str, Any]:
    return {"id": 10 * image, "image_id": image, "category_id": kind, "keypoints": keypoints} | changes


def write(
    path: Path, files: list[str], annotations: list[dict[str, Any]], categories: list[dict[str, Any]]
) -> Path:
    images = [{"id": i, "file_name": name} for i, name in enumerate(files, start=1)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"images": images, "annotations": annotations, "categories": categories}))
    return path


def labels(project: Project) -> dict[str, list[list[float]]]:
    frames = LabelStore.of(Project.open(project.root)).read()
    return {f"{frame.video}/{frame.image_path.name}": frame.xy.tolist() for frame in frames}


# --- out -------------------------------------------------------------------------------------------------


def test_out_and_in_again_is_exact(rich, take, contents, actuators, tmp_path: Path) -> None:
    report = export_coco(rich, tmp_path / "out")
    assert (report.labelled, report.images, report.warnings) == (9, 12, [])
    again, report = take(tmp_path / "out")
    assert (report.labelled, report.images, report.unlabelled) == (9, 12, 3)
    assert (report.skipped, report.warnings) == ([], [])
    assert again.keypoints == rich.keypoints
    assert contents(again) == contents(rich)
    assert actuators(again) == {"arm": "original", "arm again": "original", "größe 1.5Hz": "Größer"}
    _, report = take(tmp_path / "out")
    assert (report.labelled, report.unchanged, report.images) == (0, 9, 0)


def test_the_file_is_what_coco_defines(rich: Project, tmp_path: Path) -> None:
    export_coco(rich, tmp_path / "out")
    document = json.loads((tmp_path / "out/annotations/person_keypoints_default.json").read_text("utf-8"))
    assert [c["name"] for c in document["categories"]] == ["Größer", "original"]
    for kind in document["categories"]:
        assert kind["keypoints"] == list(rich.keypoints)
        assert kind["skeleton"] == [[1, 2], [2, 3], [3, 4]]
    images = {image["id"]: image for image in document["images"]}
    assert len(images) == 12
    for image in images.values():
        pixels = cv2.imread(str(tmp_path / "out" / "images" / image["file_name"]))
        assert pixels.shape == (image["height"], image["width"], 3)
    assert len({a["id"] for a in document["annotations"]}) == 9
    one = next(a for a in document["annotations"] if images[a["image_id"]]["file_name"] == "arm/img00014.png")
    xy = LabelStore.of(rich).read()[1].xy
    assert one["keypoints"] == [*xy[0], 2, *xy[1], 2, 0, 0, 0, *xy[3], 2]
    assert one["num_keypoints"] == 3
    x, y, width, height = one["bbox"]
    # From the corner of the image, where the pixel at index i begins at i and ends at i + 1.
    assert (x, y) == (np.nanmin(xy[:, 0]), np.nanmin(xy[:, 1]))
    assert x + width == pytest.approx(np.nanmax(xy[:, 0]) + 1)
    assert y + height == pytest.approx(np.nanmax(xy[:, 1]) + 1)
    assert one["area"] == pytest.approx(width * height)


def test_another_program_reads_it(rich: Project, tmp_path: Path) -> None:
    sleap_io = pytest.importorskip("sleap_io", reason="sleap-io is not installed (bendtrack[sleap])")
    export_coco(rich, tmp_path / "out")
    theirs = sleap_io.load_coco(
        str(tmp_path / "out/annotations/person_keypoints_default.json"),
        dataset_root=str(tmp_path / "out/images"),
    )
    ours = LabelStore.of(rich).read()
    found = sorted(np.asarray(frame.instances[0].numpy()).tobytes() for frame in theirs if frame.instances)
    assert found == sorted(f.xy.astype(np.float32).astype(np.float64).tobytes() for f in ours)


def test_export_never_writes_over_something(rich: Project, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    with pytest.raises(LabelError, match="with something in it"):
        export_coco(rich, tmp_path / "out")
    empty = Project.create(tmp_path / "empty", keypoints=NAMES)
    with pytest.raises(LabelError, match="expected labelled frames to export, got none"):
        export_coco(empty, tmp_path / "new")
    assert not (tmp_path / "new").exists()


# --- in --------------------------------------------------------------------------------------------------


def test_a_keypoint_is_the_index_of_a_pixel(tmp_path: Path, take) -> None:
    image = np.zeros((72, 96, 3), np.uint8)
    image[7, 10] = 255
    (tmp_path / "in").mkdir()
    cv2.imwrite(str(tmp_path / "in" / "spot.png"), image)
    write(tmp_path / "in" / "labels.json", ["spot.png"], [annotation(1)], [category()])
    project, _ = take(tmp_path / "in")
    [frame] = LabelStore.of(project).read()
    assert frame.xy[0].tolist() == [10, 7]
    assert cv2.imread(str(frame.image_path))[7, 10, 0] == 255


def test_a_cvat_task(tmp_path: Path, take, save_image) -> None:
    # As its "COCO Keypoints 1.0" unpacks: flat names, hidden points v = 1, points outside v = 0 with a position.
    root = tmp_path / "Gripper task"
    for i in range(3):
        save_image(root / "images" / "default" / f"frame_{i:06d}.PNG", i)
    hidden = [10, 7, 2, 20.5, 7.25, 1, 30, 40, 2, 50, 60, 0]
    write(
        root / "annotations" / "person_keypoints_default.json",
        [f"frame_{i:06d}.PNG" for i in range(3)],
        [annotation(1, hidden, attributes={"occluded": False}, bbox=[10, 7, 20, 33]), annotation(3)],
        [category(skeleton=[[1, 2], [2, 3], [3, 4]])],
    )
    project, report = take(root)
    assert project.keypoints == tuple(NAMES)
    assert (report.labelled, report.images, report.unlabelled, report.skipped) == (2, 3, 1, [])
    assert report.warnings == ["1 points are marked as hidden (v = 1); their positions are taken"]
    found = labels(project)
    assert list(found) == ["Gripper task/frame_000000.PNG", "Gripper task/frame_000002.PNG"]
    first = found["Gripper task/frame_000000.PNG"]
    assert first[:3] == [[10, 7], [20.5, 7.25], [30, 40]]
    assert np.isnan(first[3]).all()
    assert project.actuator_of("Gripper task") == "default"


def test_a_label_studio_export(tmp_path: Path, take, save_image) -> None:
    # Whole pixels, a category of boxes without points beside the one named "default", Windows' separators.
    root = tmp_path / "project-3-at-2026"
    save_image(root / "images" / "4f1c9a2e-img00012.png", 1)
    write(
        root / "result.json",
        ["images\\4f1c9a2e-img00012.png"],
        [
            {"id": 0, "image_id": 1, "category_id": 0, "bbox": [1, 2, 3, 4], "segmentation": []},
            annotation(1, [10, 7, 2, 20, 7, 2, 30, 40, 2, 0, 0, 0]),
        ],
        [{"id": 0, "name": "Arm"}, category(name="default", supercategory="default")],
    )
    project, report = take(root / "result.json")
    assert (report.labelled, report.skipped) == (1, [])
    assert labels(project)["project-3-at-2026/4f1c9a2e-img00012.png"][:3] == [[10, 7], [20, 7], [30, 40]]


def test_images_may_be_elsewhere(tmp_path: Path, take, save_image) -> None:
    save_image(tmp_path / "disk" / "old" / "arm" / "img00001.png", 1)
    save_image(tmp_path / "disk" / "new" / "leg" / "img00001.png", 2)
    file = write(
        tmp_path / "in" / "labels.json",
        ["/home/ana/arm/img00001.png", "C:\\data\\leg\\img00001.png"],
        [annotation(1), annotation(2)],
        [category()],
    )
    project, report = take(file, images=tmp_path / "disk")
    assert (report.labelled, report.skipped) == (2, [])
    for video, folder in (("arm", "old"), ("leg", "new")):
        copied = project.labels_dir / video / "img00001.png"
        assert copied.read_bytes() == (tmp_path / "disk" / folder / video / "img00001.png").read_bytes()


def test_nothing_is_overwritten_where_names_are_alike(tmp_path: Path, take, save_image) -> None:
    files = ["monday/arm/img1.png", "tuesday/arm/img1.png", "tuesday/ARM/img1.png", "leg/img1.png"]
    root = tmp_path / "in"
    for number, name in enumerate(files):
        save_image(root / name, number)
    write(root / "a.json", files, [annotation(i) for i in (1, 2, 3, 4)], [category()])
    project, report = take(root)
    assert (report.labelled, report.images, report.skipped) == (4, 4, [])
    kept = {path.read_bytes() for path in project.labels_dir.rglob("*.png")}
    assert kept == {(root / name).read_bytes() for name in files}
    names = [path.name.casefold() for path in project.labels_dir.iterdir()]
    assert sorted(names) == ["leg", "monday_arm", "tuesday_arm", "tuesday_arm_2"]


def test_categories_are_actuators_where_there_are_several(
    tmp_path: Path, take, save_image, actuators
) -> None:
    root = tmp_path / "bench"
    files = [f"img{i}.png" for i in range(4)]
    for i, name in enumerate(files):
        save_image(root / name, i)
    write(
        root / "labels.json",
        files,
        [annotation(1), annotation(2, kind=2), annotation(3, kind=2)],
        [category(1, "soft"), category(2, "stiff/er")],
    )
    project, report = take(root)
    assert list(labels(project)) == [
        "bench_soft/img0.png",
        "bench_stiff_er/img1.png",
        "bench_stiff_er/img2.png",
    ]
    assert (report.labelled, report.unlabelled) == (3, 1)
    assert actuators(project)["bench_soft"] == "soft"
    # A name that cannot be an actuator's is said, and the labels are taken all the same.
    assert actuators(project)["bench_stiff_er"] == "default"
    [warning] = report.warnings
    assert warning.startswith("bench_stiff_er: left to the actuator 'default': ")


def test_the_project_says_which_actuator_a_video_shows(rich, tmp_path: Path) -> None:
    from bendtrack.labeling.interop.importing import import_source

    export_coco(rich, tmp_path / "out")
    rich.assign_actuator("stiff", ["arm"])
    report = import_source(open_coco(tmp_path / "out"), rich)
    assert report.warnings == ["arm: actuator 'stiff' in the project, 'original' in the source; kept"]
    assert rich.actuator_of("arm") == "stiff"


def test_several_files_of_one_data_set(tmp_path: Path, take, save_image) -> None:
    for number, part in enumerate(("train", "val"), start=1):
        save_image(tmp_path / "set" / "images" / part / f"{part}.png", number)
        file = tmp_path / "set" / "annotations" / f"person_keypoints_{part}.json"
        write(file, [f"{part}/{part}.png"], [annotation(1)], [category()])
    (tmp_path / "set" / "annotations" / "captions.json").write_text('{"annotations": [], "images": []}')
    project, report = take(tmp_path / "set")
    assert report.labelled == 2
    assert list(labels(project)) == ["train/train.png", "val/val.png"]


def test_frames_come_out_of_the_video_where_there_are_no_images(
    tmp_path: Path, take, write_arm_video
) -> None:
    video = write_arm_video(tmp_path / "arm.mp4")
    file = write(tmp_path / "in" / "a.json", ["arm/img00007.png"], [annotation(1)], [category()])
    project, report = take(file, videos=(video,))
    assert (report.labelled, report.images, report.skipped) == (1, 1, [])
    assert list(labels(project)) == ["arm/img00007.png"]


def test_what_cannot_be_used_is_left_out_and_said(tmp_path: Path, take, save_image) -> None:
    root = tmp_path / "in"
    files = [f"arm/img{i}.png" for i in range(1, 10)]
    for i in (1, 2, 3, 4, 5, 6, 7):
        save_image(root / files[i - 1], i)
    save_image(root / "a" / "elsewhere" / "img9.png", 9)
    save_image(root / "b" / "elsewhere" / "img9.png", 10)
    outside = [200, 7, 2, *FOUR[3:]]
    write(
        root / "labels.json",
        files,
        [
            annotation(1),
            annotation(2, FOUR[:-3]),
            annotation(3),
            annotation(3, id=31),
            annotation(4, [10, 7, 3, *FOUR[3:]]),
            annotation(5, ["10", 7, 2, *FOUR[3:]]),
            annotation(6, outside),
            annotation(7, [float("nan"), 7, 2, *FOUR[3:]]),
            annotation(8),
            annotation(9),
            annotation(77),
        ],
        [category()],
    )
    project, report = take(root)
    assert report.skipped == [
        "arm/img2.png: labels.json annotation 20: expected 12 numbers as keypoints (x, y, v each), got 9",
        "arm/img3.png: expected one actuator in each image, got 2",
        "arm/img4.png: labels.json annotation 40: expected 0, 1 or 2 as the visibility of 'base_1', got 3",
        "arm/img5.png: labels.json annotation 50: expected numbers as keypoints, got something else",
        "labels.json: 1 annotations of images that it does not list",
        f"arm/img9.png: expected one image of that name, got {root}/a/elsewhere/img9.png "
        f"and {root}/b/elsewhere/img9.png",
        f"arm/img8.png: no such image in {root}",
        "arm/img6.png: expected 'base_1' inside the 96 x 72 px, got (200, 7)",
        "arm/img7.png: labels.json annotation 70, column base_1 x: expected a number of px, got 'nan'",
    ]
    found = labels(project)
    assert list(found) == ["arm/img1.png", "arm/img6.png", "arm/img7.png"]
    assert np.isnan(found["arm/img6.png"][0]).all()
    assert found["arm/img6.png"][1:] == [[20.5, 7.25], [30, 40], [50, 60]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected JSON, got a mistake"),
        ('{"images": [', "expected JSON, got a mistake"),
        ("[" * 100_000, "expected JSON, got a mistake"),
        ("\x00\xff", "expected JSON, got a mistake"),
        ("[]", "expected COCO keypoints, got a JSON list"),
        ("{}", "with a list of images, got None"),
        ('{"images": {}, "annotations": [], "categories": []}', "with a list of images, got {}"),
        ('{"images": [1], "annotations": [], "categories": []}', r"with a list of images, got \[1\]"),
        ('{"images": [], "annotations": [], "categories": []}', "got no category with keypoints"),
        (
            '{"images": [], "annotations": [], "categories": [{"id": 1, "keypoints": "nose"}]}',
            "expected a category's keypoints to be names, got nose",
        ),
        (
            '{"images": [], "annotations": [], "categories": [{"id": 1, "keypoints": ["a", "a"]}]}',
            "expected distinct keypoints, got a, a",
        ),
        (
            '{"images": [{"id": 1}], "annotations": [], "categories": [{"id": 1, "keypoints": ["a"]}]}',
            "expected every image to have a file_name",
        ),
        (
            '{"images": [{"id": 1, "file_name": "../.."}], "annotations": [], '
            '"categories": [{"id": 1, "keypoints": ["a"]}]}',
            "expected every image to have a file_name",
        ),
        (
            '{"images": [{"id": 1, "file_name": "a.png"}], "annotations": [], '
            '"categories": [{"id": 1, "keypoints": ["a"]}]}',
            "expected labelled COCO keypoints, got none",
        ),
        (
            '{"images": [{"id": 1, "file_name": "a.png"}], "categories": [{"id": 1, "keypoints": ["a"]}], '
            '"annotations": [{"id": 5, "image_id": 1, "category_id": 1, "keypoints": [1]}]}',
            r"got none \(a.png: x.json annotation 5: expected 3 numbers",
        ),
    ],
)
def test_a_file_that_cannot_be_says_why_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "x.json"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(LabelError, match=message) as caught:
        open_coco(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)
