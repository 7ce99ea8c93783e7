"""Does DeepLabCut itself use a project that bendtrack exported?

    python benchmarks/deeplabcut_opens.py DLC_PYTHON [--out FOLDER] [--analyze FRAMES]

DLC_PYTHON is the interpreter of an environment with DeepLabCut in it, made so (6 GB):

    python3.11 -m venv dlc && dlc/bin/pip install deeplabcut==3.0.2

The bundled sample trial, and three frames of a second video with an awkward name and a missing point, are exported,
with the labels as CSV and .h5 and as CSV alone; DeepLabCut makes a training set of them, and the labels in that set are
compared with ours, number for number. --analyze also lets its analyze_videos run on the first frames of the sample's
video, with a network of random weights, as its own come from a hub: that it runs is shown, not how well.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def main() -> None:
    """Make, export, hand over, compare."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dlc_python", type=Path)
    parser.add_argument("--out", type=Path, help="keep the projects here")
    parser.add_argument("--analyze", type=int, default=0, metavar="FRAMES")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="bendtrack-dlc-") as temporary:
        run(args, args.out or Path(temporary))


def run(args: argparse.Namespace, out: Path) -> None:
    """The whole way, in `out`."""
    import numpy as np

    from bendtrack.data_samples import __path__ as samples
    from bendtrack.labeling.interop.dlc import export_dlc, import_dlc, project_for
    from bendtrack.labeling.store import LabelStore

    out.mkdir(parents=True, exist_ok=True)
    sample = out / "video.mp4"
    shutil.copy(Path(samples[0], "video.mp4"), sample)
    labels = Path(samples[0], "labels.csv")
    project = project_for(out / "project", labels)
    print(f"sample trial: {import_dlc(labels, project, videos=[sample]).summary()}")
    store = LabelStore.of(project)
    second = "größe 1.5Hz"
    (store.labels_dir / second).mkdir(exist_ok=True)
    for frame in store.read()[:3]:
        shutil.copy(frame.image_path, store.labels_dir / second)
        xy = frame.xy.copy()
        xy[1] = np.nan
        store.write(second, {frame.image_path.name: xy})
    ours = {f"labeled-data/{f.video}/{f.image_path.name}": f.xy.ravel().tolist() for f in store.read()}

    for name in ("csv and h5", "csv alone"):
        folder = out / f"exported {name}"
        report = export_dlc(project, folder, videos=[sample])
        for warning in report.warnings:
            print(f"warning: {warning}")
        written = sorted(folder.rglob("*.h5"))
        if name == "csv alone":
            for path in written:
                path.unlink()
        elif not written:
            print(f"{name}: skipped, PyTables is not installed here")
            continue
        print(f"\n{name}: {report.labelled} labelled frames exported")
        command = [str(args.dlc_python), __file__, "--inside", str(folder.resolve())]
        if args.analyze and name == "csv and h5":
            command.append(str(first_frames(sample, args.analyze, out / "cut.mp4").resolve()))
        done = subprocess.run(command, env={**os.environ, "DLClight": "True"}, capture_output=True, text=True)
        (out / f"{name}.log").write_text(done.stdout + done.stderr)
        if done.returncode:
            sys.exit(f"DeepLabCut ended with {done.returncode}:\n{done.stdout[-2000:]}{done.stderr[-4000:]}")
        inside = json.loads((folder / "inside.json").read_text())
        for line in inside["said"]:
            print(f"  {line}")
        theirs = inside["labels"]
        same = theirs.keys() == ours.keys() and all(
            np.array_equal(ours[image], theirs[image], equal_nan=True) for image in ours
        )
        print(
            f"  labels in its training set: {len(theirs)}, {'the same as ours, every digit' if same else 'DIFFERENT'}"
        )
        if not same:
            sys.exit(1)


def first_frames(video: Path, count: int, out: Path) -> Path:
    """The beginning of a video as a video."""
    from itertools import islice

    from bendtrack.tracker.video import Video
    from bendtrack.tracker.video_writer import VideoWriter

    reader = Video(video)
    with VideoWriter(out, reader.size_wh, 30.0) as writer:
        for frame in islice(reader, count):
            assert frame.image is not None
            writer.write(frame.image, frame.time_s)
    return out


def inside(folder: Path, video: Path | None) -> None:
    """In DeepLabCut's environment."""
    begun = time.perf_counter()
    import deeplabcut
    import pandas as pd

    said = [f"DeepLabCut {deeplabcut.__version__}, imported in {time.perf_counter() - begun:.0f} s"]
    config = str(folder / "config.yaml")
    if not list(folder.glob("labeled-data/*/*.h5")):
        deeplabcut.convertcsv2h5(config, userfeedback=False)
        said.append("convertcsv2h5 made its .h5 of the CSV")
    [[fraction, shuffle, (train, test)]] = deeplabcut.create_training_dataset(config)
    said.append(
        f"create_training_dataset: shuffle {shuffle}, {fraction:.0%}: {len(train)} to train, {len(test)} to test"
    )
    [merged] = (folder / "training-datasets").rglob("CollectedData_*.h5")
    table = pd.read_hdf(merged)
    labels = {"/".join(index): row.tolist() for index, row in zip(table.index, table.to_numpy(), strict=True)}
    deeplabcut.check_labels(config, draw_skeleton=True)
    drawn = list((folder / "labeled-data").glob("*_labeled/*.png"))
    said.append(f"check_labels drew {len(drawn)} pictures")
    known: dict[str, object] = {"said": said, "labels": labels}
    if video is not None:
        rows, seconds = analyze(config, folder, video)
        known["analyzed_frames_per_s"] = rows / seconds
        said.append(
            f"analyze_videos (random weights): {rows} frames in {seconds:.0f} s, {rows / seconds:.2f} frames/s"
        )
    (folder / "inside.json").write_text(json.dumps(known))


def analyze(config: str, folder: Path, video: Path) -> tuple[int, float]:
    """Its analyze_videos, with a snapshot of random weights in the place of a trained one: frames and seconds."""
    import deeplabcut
    import pandas as pd
    import torch
    import yaml
    from deeplabcut.pose_estimation_pytorch.models import PoseModel

    [settings] = folder.glob("dlc-models-pytorch/*/*/train/pytorch_config.yaml")
    network = PoseModel.build(yaml.safe_load(settings.read_text())["model"], pretrained_backbone=False)
    torch.save(
        {"model": network.state_dict(), "metadata": {"epoch": 1}}, settings.with_name("snapshot-001.pt")
    )
    begun = time.perf_counter()
    deeplabcut.analyze_videos(config, [str(video)], save_as_csv=True, device="cpu", destfolder=str(folder))
    seconds = time.perf_counter() - begun
    [found] = folder.glob(f"{video.stem}DLC*.csv")
    return len(pd.read_csv(found, header=[0, 1, 2], index_col=0)), seconds


if __name__ == "__main__":
    if sys.argv[1:2] == ["--inside"]:
        inside(Path(sys.argv[2]), Path(sys.argv[3]) if len(sys.argv) > 3 else None)
    else:
        main()
