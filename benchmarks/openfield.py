"""A real DeepLabCut project that bendtrack did not make: import, train on half of the frames, judge on the other half,
track its video, and write it back.

    python benchmarks/openfield.py PATH-TO-DEEPLABCUT-PROJECT [--minutes 15]

The network never sees the second half, and nothing in its training is chosen by it.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np

from bendtrack.labeling.interop.dlc import import_dlc, project_for
from bendtrack.labeling.interop.dlc_export import export_dlc
from bendtrack.labeling.store import LabelStore
from bendtrack.models.detector import NetworkDetector
from bendtrack.models.evaluation import evaluate
from bendtrack.models.training.settings import TrainingSettings
from bendtrack.models.training.trainer import Progress, train
from bendtrack.tracker.results import read_results, write_results
from bendtrack.tracker.tracking import track


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("project", type=Path)
    parser.add_argument("--minutes", type=float, default=15.0)
    parser.add_argument("--init", default="auto")
    parser.add_argument("--backbone", default="resnet18")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="keep the project, the model and the table here")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="bendtrack-openfield-") as folder:
        run(args, args.out or Path(folder))


def run(args: argparse.Namespace, out: Path) -> None:
    """The whole way, in `out`."""
    project = project_for(out / "project", args.project)
    report = import_dlc(args.project, project)
    print(report.summary())
    store = LabelStore.of(project)
    frames = store.read()
    order = np.random.default_rng(args.seed).permutation(len(frames))
    half = len(frames) // 2
    trained, judged = ([frames[i] for i in part] for part in (order[:half], order[half:]))
    definition = project.angle_definition(np.stack([frame.xy for frame in trained]))
    settings = TrainingSettings(
        backbone=args.backbone, init=args.init, max_minutes=args.minutes, seed=args.seed
    )
    begun = time.perf_counter()

    def told(p: Progress) -> None:
        if p.step % 100 == 0:
            print(
                f"  step {p.step}/{p.total}  held out {p.held_out_px:.2f} px  {p.elapsed_s:.0f} s", flush=True
            )

    checkpoint = train(trained, project.keypoints, definition, out / "model", settings, progress=told)
    minutes = (time.perf_counter() - begun) / 60
    summary = evaluate(checkpoint, judged).summary()
    print(
        f"started from {checkpoint.training['started_from']}, trained {minutes:.1f} min on {len(trained)} frames"
    )
    print(f"on the other {len(judged)} frames, px: {json.dumps(summary['error_px'])}")
    for name, figures in summary["per_keypoint_px"].items():
        print(f"  {name:12s} mean {figures['mean']}  median {figures['median']}  p95 {figures['p95']}")

    for video in sorted((args.project / "videos").glob("*")):
        begun = time.perf_counter()
        table = track(video, NetworkDetector.load(out / "model"), definition)
        seconds = time.perf_counter() - begun
        path = write_results(table, out / "results", video.stem)[0]
        again = read_results(path)
        flags = {str(f) or "sound": int((again.flag == f).sum()) for f in np.unique(again.flag)}
        print(f"{video.name}: {len(again.time_s)} rows in {seconds:.0f} s, {flags}")

    export_dlc(project, out / "exported")
    second = project_for(out / "again", out / "exported")
    import_dlc(out / "exported", second)
    back = LabelStore.of(second).read()
    same = [a.image_path.name for a in frames] == [b.image_path.name for b in back] and all(
        np.array_equal(a.xy, b.xy, equal_nan=True) and a.image_path.read_bytes() == b.image_path.read_bytes()
        for a, b in zip(frames, back, strict=True)
    )
    print(f"exported and read again: {'no difference' if same else 'DIFFERENT'} in {len(back)} frames")


if __name__ == "__main__":
    main()
