"""What is taken for the actuator where something that looks like one lies next to it and does not move.

    python benchmarks/look_alikes.py                    sixteen films, with and without motion evidence
    python benchmarks/look_alikes.py --films 1 --frames 8       a run to see that it runs

Each film is a slow inflation of a look of the training families, with the body of another look at rest in the picture.
Nothing is labelled. A frame is right where the tip is found within a tenth of the body's length of its place.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from bendtrack.models.detector import NetworkDetector
from bendtrack.models.inference.stages import ALL_STAGES
from bendtrack.models.networks.shipped import working_copy
from bendtrack.tracker.errors import VideoError
from bendtrack.tracker.synthetic.stream import TRAINING, Look, Renderer, Sample, drawn_look, inflation_deg

STREAM, OTHERS = 9000, 9500
SIZE_WH = (640, 480)
NEAR = 0.1
APART = 2.5
"""Distance between the two bodies, in their thicknesses: neither hides the other."""


def films(count: int, frames: int) -> Iterator[tuple[int, list[Sample]]]:
    """Number of the look, and its probe frames with a body that does not move."""
    index = -1
    while count:
        index += 1
        look = drawn_look(STREAM, index, size_wh=SIZE_WH, families=TRAINING, bend_deg=(0.0, 150.0))
        bends = inflation_deg(look, frames)
        alone = Renderer(look)
        ends = [alone.frame(float(bends[i])) for i in (0, frames // 2)]
        if not all(sample.visible[[0, 1, -2, -1]].all() for sample in ends):
            continue
        other = look_alike(look, ends, index)
        if other is None:
            continue
        stage = Renderer(look, [other])
        yield (
            index,
            [stage.frame(float(bend), noise_seed=i, moment=i / frames) for i, bend in enumerate(bends)],
        )
        count -= 1


def look_alike(look: Look, ends: list[Sample], index: int) -> tuple[Look, float] | None:
    """Another look's body and its bend, beside the film's body at both its extremes; None where none fits."""
    bend_deg = float(np.random.default_rng(index).uniform(0, 140))
    for attempt in range(60):
        other = drawn_look(
            OTHERS, index * 100 + attempt, size_wh=SIZE_WH, families=TRAINING, bend_deg=(0.0, 150.0)
        )
        seen = Renderer(other).frame(bend_deg)
        distance = min(
            np.linalg.norm(seen.midline_xy[:, None] - end.midline_xy, axis=2).min() for end in ends
        )
        if seen.visible.all() and distance > APART * 2 * max(look.body.half_px, other.body.half_px):
            return other, bend_deg
    return None


def share_right(samples: list[Sample], motion_evidence: bool) -> float:
    """Share of the frames in which the tip is found; NaN where the film is refused."""
    # What corrects the ends afterwards does not change what is found.
    stages = replace(
        ALL_STAGES,
        motion_evidence=motion_evidence,
        end_regression=False,
        self_training=False,
        edge_orientation=False,
    )
    detector = NetworkDetector.load(working_copy("resnet18"), engine="torch", stages=stages)
    frames = [sample.image for sample in samples]
    try:
        found = detector.for_video(frames).detect(frames)
    except VideoError:
        return float("nan")
    body_px = np.linalg.norm(np.diff(samples[0].midline_xy, axis=0), axis=1).sum()
    off_px = [
        np.linalg.norm(xy[-1] - sample.keypoints_xy[-1]) for xy, sample in zip(found.xy, samples, strict=True)
    ]
    return float((np.array(off_px) < NEAR * body_px).mean())


def main() -> None:
    """Draw, measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--films", type=int, default=16)
    parser.add_argument("--frames", type=int, default=32, help="of each film")
    args = parser.parse_args()
    shares = []
    for index, samples in films(args.films, args.frames):
        shares.append([share_right(samples, motion) for motion in (True, False)])
        print(
            f"look {index:3d}: tip found in {100 * shares[-1][0]:5.1f} % of the frames with motion evidence,"
            f" {100 * shares[-1][1]:5.1f} % without",
            flush=True,
        )
    right = (np.array(shares) > 0.9).sum(axis=0)
    print(
        f"the actuator in at least 90 % of its frames: {right[0]} of {len(shares)} films with, {right[1]} without"
    )


if __name__ == "__main__":
    main()
