"""What is taken for the actuator in films with troubles: look-alikes that hardly move, light, a hand, shakes, a clamp.

    python benchmarks/look_alikes.py                    sixteen films of each trouble, with and without motion evidence
    python benchmarks/look_alikes.py --trouble tube     one trouble; may be given again
    python benchmarks/look_alikes.py --films 1 --frames 8 --trouble body --trouble shaking   a run to see that it runs

Each film is a slow inflation of a look of the training families. Nothing is labelled. A frame is right where the tip
is found within a tenth of the body's length of its place; frames that do not show the tip do not count.

Of rigs that shake and of clamps that yield the error of the angle is printed too, over the frames that are right and
show both ends: with the fixed end measured where it yields, and with it held. No network is fitted to a film.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from bendtrack.models.detector import NetworkDetector
from bendtrack.models.inference.stages import ALL_STAGES, StageSettings
from bendtrack.models.networks.shipped import working_copy
from bendtrack.tracker.angle import bending_angle
from bendtrack.tracker.errors import VideoError
from bendtrack.tracker.synthetic.stream import (
    TRAINING,
    Cable,
    Disturbances,
    Hand,
    Look,
    Renderer,
    Sample,
    Tube,
    drawn_look,
    inflation_deg,
)
from bendtrack.tracker.synthetic.stream.look_alike import second_arm, thick_tube
from bendtrack.tracker.synthetic.stream.rng import Rng
from bendtrack.tracker.types import FloatArray

STREAM, OTHERS = 9000, 9500
SIZE_WH = (640, 480)
NEAR = 0.1
APART = 2.5
"""Distance between two bodies, in their thicknesses: neither hides the other."""

TUBE_SLENDER, TUBE_BENDS_DEG = 0.6, 6.0
"""Thickness of a tube as a share of what was drawn for it, and how far it bends in step with the actuator."""

YIELD_DEG, SHAKE_PX = 8.0, 5.0
ENDS = [0, 1, -2, -1]

Stage = Callable[[Look, list[Sample], int], Renderer | None]
"""From a look, its samples at rest and bent, and its number: its renderer with one trouble; None where none fits."""


def another_body(look: Look, ends: list[Sample], index: int) -> Renderer | None:
    """Another look's body at rest."""
    other = look_alike(look, ends, index)
    return None if other is None else Renderer(look, [other])


def tube(look: Look, ends: list[Sample], index: int) -> Renderer | None:
    """A smooth tube of the body's own colour that bends a little."""
    other = look_alike(look, ends, index)
    if other is None:
        return None
    own, bend_deg = other
    smooth = replace(
        own.body, valley="none", half_px=TUBE_SLENDER * own.body.half_px, layer=0.0, cap="none", windings=0
    )
    own = replace(own, body=smooth, surface=look.surface)
    return Renderer(look, (), Disturbances(tubes=(Tube(own, (bend_deg, bend_deg + TUBE_BENDS_DEG)),)))


def thick(look: Look, ends: list[Sample], index: int) -> Renderer | None:
    """A tube of the body's own material and as thick as the body, that bends a little."""
    other = thick_tube(look, look.bend_deg[1], Rng(OTHERS, index))
    if other is None:
        return None
    own, bend_deg, _ = other
    return Renderer(look, (), Disturbances(tubes=(Tube(own, (bend_deg, bend_deg + TUBE_BENDS_DEG)),)))


def arm(look: Look, ends: list[Sample], index: int) -> Renderer | None:
    """A second arm of the same body, at rest, that the image's edge cuts."""
    alone = replace(look, place=replace(look.place, second_arm=None))
    other = second_arm(alone, look.bend_deg[1], Rng(OTHERS, index))
    return None if other is None else Renderer(alone, [other])


def cable(look: Look, ends: list[Sample], index: int) -> Renderer | None:
    """A cable as long as a body, in its own colour, that sways a little."""
    other = look_alike(look, ends, index)
    if other is None:
        return None
    own, bend_deg = other
    knots = Renderer(own).frame(bend_deg).midline_xy[::12]
    rng = np.random.default_rng([index, 1])
    colour = tuple(rng.uniform(0.05, 0.9, 3).tolist())
    hung = Cable(tuple((x, y) for x, y in knots.tolist()), colour, rng.uniform(4, 9))
    return Renderer(look, (), Disturbances(cable=hung))


def shadow(look: Look, ends: list[Sample], index: int) -> Renderer | None:
    """A shadow that passes over the picture once."""
    return Renderer(look, (), Disturbances(shadow=float(np.random.default_rng(index).uniform(0.25, 0.5))))


def hand(look: Look, ends: list[Sample], index: int) -> Renderer | None:
    """A hand that comes in once, from the side where most room is, for one frame in ten."""
    swept = np.concatenate([sample.midline_xy for sample in ends])
    w, h = SIZE_WH
    sides = [((0, 0.5 * h), 0.0), ((w, 0.5 * h), 180.0), ((0.5 * w, 0), 90.0), ((0.5 * w, h), -90.0)]
    xy, heading = max(sides, key=lambda side: np.linalg.norm(swept - side[0], axis=1).min())
    toward = np.array([np.cos(np.radians(heading)), np.sin(np.radians(heading))])
    x, y = (np.array(xy) + 40 * toward).tolist()
    return Renderer(look, (), Disturbances(hand=Hand((x, y), heading, (0.4, 0.5))))


def shaking(look: Look, ends: list[Sample], index: int) -> Renderer | None:
    """A rig that shakes as a whole."""
    return Renderer(look, (), Disturbances(shake_px=SHAKE_PX))


def clamp(look: Look, ends: list[Sample], index: int) -> Renderer | None:
    """A clamp that yields, to either side."""
    return Renderer(look, (), Disturbances(yield_deg=YIELD_DEG if index % 2 else -YIELD_DEG))


TROUBLES: Mapping[str, tuple[str, Stage]] = {
    "body": ("another body at rest", another_body),
    "tube": ("a tube of the body's colour that bends a little", tube),
    "thick": ("a tube as thick as the body that bends a little", thick),
    "arm": ("a second arm at rest that the edge cuts", arm),
    "cable": ("a cable that sways", cable),
    "shadow": ("a shadow that passes", shadow),
    "hand": ("a hand that comes in once", hand),
    "shaking": ("a rig that shakes", shaking),
    "clamp": ("a clamp that yields", clamp),
}
WITH_ANGLE = ("shaking", "clamp")


def films(stage: Stage, count: int, frames: int) -> Iterator[tuple[int, list[Sample]]]:
    """Number of the look, and the probe frames of a film with one trouble."""
    index = -1
    while count:
        index += 1
        look = drawn_look(STREAM, index, size_wh=SIZE_WH, families=TRAINING, bend_deg=(0.0, 150.0))
        bends = inflation_deg(look, frames)
        alone = Renderer(look)
        ends = [alone.frame(float(bends[i])) for i in (0, frames // 2)]
        if not all(sample.visible[ENDS].all() for sample in ends):
            continue
        renderer = stage(look, ends, index)
        if renderer is None:
            continue
        yield (
            index,
            [renderer.frame(float(bend), noise_seed=i, moment=i / frames) for i, bend in enumerate(bends)],
        )
        count -= 1


def look_alike(look: Look, ends: list[Sample], index: int) -> tuple[Look, float] | None:
    """Another look's body and its bend, next to the film's body at both its extremes; None where none fits."""
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


@dataclass(frozen=True)
class Found:
    """What was found in a film.

    Attributes
    ----------
    share : float
        Of the frames that show the tip, those in which it is found; NaN where the film is refused.
    error_deg : ndarray
        (M,) errors of the angle in those of them that show both ends.
    fixed_end : str
        Whether it was "held" or "measured"; "refused" where the film is.
    """

    share: float
    error_deg: FloatArray
    fixed_end: str

    @property
    def rmse_deg(self) -> float:
        """Root mean square error of the angle, degrees; NaN without any."""
        return float(np.sqrt(np.mean(self.error_deg**2))) if len(self.error_deg) else float("nan")


def found_in(samples: list[Sample], stages: StageSettings) -> Found:
    """Find the actuator in a film and compare it with its truth."""
    detector = NetworkDetector.load(working_copy("resnet18"), engine="torch", stages=stages)
    frames = [sample.image for sample in samples]
    try:
        own = detector.for_video(frames)
        found = own.detect(frames)
    except VideoError:
        return Found(float("nan"), np.zeros(0), "refused")
    body_px = np.linalg.norm(np.diff(samples[0].midline_xy, axis=0), axis=1).sum()
    truth = np.stack([sample.keypoints_xy for sample in samples])
    visible = np.stack([sample.visible for sample in samples])
    right = np.linalg.norm(found.xy[:, -1] - truth[:, -1], axis=1) < NEAR * body_px
    definition = replace(own.metadata.definition, sign=1)
    angle_deg, _, _ = bending_angle(found.xy, own.keypoints, definition)
    error_deg = angle_deg - np.array([sample.angle_deg for sample in samples])
    compared = right & visible[:, ENDS].all(axis=1) & np.isfinite(error_deg)
    return Found(float(right[visible[:, -1]].mean()), error_deg[compared], str(own.findings["fixed_end"]))


def measured_row(name: str, count: int, frames: int) -> None:
    """Measure the films of one trouble, and print."""
    title, stage = TROUBLES[name]
    # What corrects the ends afterwards does not change what is found.
    quick = replace(ALL_STAGES, end_regression=False, self_training=False, edge_orientation=False)
    whole = replace(ALL_STAGES, self_training=False)
    full = whole if name in WITH_ANGLE else quick
    settings = [full, replace(quick, motion_evidence=False)]
    rows: list[list[Found]] = []
    for index, samples in films(stage, count, frames):
        rows.append([found_in(samples, stages) for stages in settings])
        if name in WITH_ANGLE:
            # Where it is held anyway, the stage changes nothing.
            is_measured = rows[-1][0].fixed_end == "measured"
            rows[-1].append(
                found_in(samples, replace(full, base_measurement=False)) if is_measured else rows[-1][0]
            )
        with_motion, without, *held = rows[-1]
        text = (
            f"look {index:3d}, {title}: tip found in {100 * with_motion.share:5.1f} % of the frames with motion"
            f" evidence, {100 * without.share:5.1f} % without"
        )
        if held:
            text += (
                f"; fixed end {with_motion.fixed_end}: angle RMSE {with_motion.rmse_deg:.2f} degrees, held"
                f" {held[0].rmse_deg:.2f}"
            )
        print(text, flush=True)
    right = (np.array([[found.share for found in row[:2]] for row in rows]) > 0.9).sum(axis=0)
    print(
        f"{title}: the actuator in at least 90 % of its frames: {right[0]} of {len(rows)} films with,"
        f" {right[1]} without"
    )
    for column, said in ((0, "fixed end measured where it yields"), (2, "fixed end held")):
        if name in WITH_ANGLE:
            rmse_deg = np.array([row[column].rmse_deg for row in rows])
            known = rmse_deg[np.isfinite(rmse_deg)]
            middle, low, high = (np.median(known), known.min(), known.max()) if len(known) else (np.nan,) * 3
            print(f"{title}: angle RMSE, {said}: median {middle:.2f} degrees ({low:.2f} to {high:.2f})")
    if name in WITH_ANGLE:
        measured = sum(row[0].fixed_end == "measured" for row in rows)
        print(f"{title}: the fixed end is said to yield in {measured} of {len(rows)} films")


def main() -> None:
    """Draw, measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--films", type=int, default=16, help="of each trouble")
    parser.add_argument("--frames", type=int, default=32, help="of each film")
    parser.add_argument(
        "--trouble", action="append", choices=TROUBLES, help="may be given again; default: all"
    )
    args = parser.parse_args()
    for name in args.trouble or TROUBLES:
        measured_row(name, args.films, args.frames)


if __name__ == "__main__":
    main()
