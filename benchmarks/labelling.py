"""A new user's first half hour: choose thirty frames, label them on the page by mouse and keyboard, train, track.

    python benchmarks/labelling.py                                 one rendered trial, 30 frames, a hand with 1 px error
    python benchmarks/labelling.py --seconds 1.5 --count 5 --steps 3        a run to see that it runs

Everything but the hand is what users have: the installed commands and their defaults, the page in Chromium, the
pointer's whole screen pixels, and no label that did not go through the page. The hand aims at the renderer's truth and
misses by `--noise`; some points it drops off the mark and brings home with the arrow keys. Angles are then compared
with the truth in the frames that were not labelled. Needs playwright and Chromium, as the tests do.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from playwright.sync_api import sync_playwright
from rendered import rms

from bendtrack.labeling.store import LabelStore
from bendtrack.tracker.angle import end_vector_px, label_noise_floor_deg
from bendtrack.tracker.project import Project
from bendtrack.tracker.results import read_results
from bendtrack.tracker.synthetic.trial import Trial, render_trial

sys.path.append(str(Path(__file__).parents[1] / "tests" / "browser"))
from page_driver import BROWSERS, Labeller, PageSession, Server, browser_path

BENDTRACK = Path(sys.executable).parent / "bendtrack"
DROPPED_PX = np.array([4.0, -3.0])
ARROWS = (("ArrowLeft", "ArrowRight"), ("ArrowUp", "ArrowDown"))


class Hand:
    """Places points near where they truly are."""

    def __init__(self, labeller: Labeller, trial: Trial, noise_px: float, seed: int) -> None:
        self._labeller, self._trial, self._noise_px = labeller, trial, noise_px
        self._rng = np.random.default_rng([seed, 3])
        self.clicks = self.keys = 0

    @property
    def page(self):
        """The page before it."""
        return self._labeller.page

    def label(self, image: str, *, closer: bool) -> None:
        """All points of the image that is open, from the fitted view or from closer."""
        meant = self._trial.xy[int(re.sub(r"\D", "", image))] + self._rng.normal(0, self._noise_px, (4, 2))
        if closer:
            self._labeller.zoom_to(3.0, meant.mean(axis=0))
        for k, xy in enumerate(meant):
            if closer:
                self._labeller.pan_to_middle(xy)
            dropped = k == 2 and not closer
            got = self._labeller.click(xy + DROPPED_PX if dropped else xy)
            self.clicks += 1
            if dropped:
                self._nudge(xy - got)
        if closer:
            self._press("0")

    def _nudge(self, away: np.ndarray) -> None:
        for axis in (0, 1):
            arrow = ARROWS[axis][int(away[axis] > 0)]
            whole, rest = divmod(round(abs(float(away[axis])) * 4), 4)
            self._press(*["Shift+" + arrow] * whole, *[arrow] * rest)

    def _press(self, *keys: str) -> None:
        self._labeller.press(*keys)
        self.keys += len(keys)


def label_all(session: PageSession, trial: Trial, args: argparse.Namespace) -> str:
    """Label what the page offers until nothing is left, then the blind repeats; what there is to say of it."""
    labeller = session.page()
    page = labeller.page
    hand = Hand(labeller, trial, args.noise, args.seed)
    shown: list[str] = []
    page.on(
        "response",
        lambda answer: (
            "/api/repeats/next" in answer.url
            and answer.status == 200
            and shown.append(answer.json()["image"])
        ),
    )
    begun = time.perf_counter()
    for index in range(args.count):
        if index:
            labeller.press("n")
        current = page.locator('[data-state="unlabelled"][aria-selected="true"]')
        video, _, image = current.get_attribute("data-id").partition("/")
        labeller.opened(image, video)
        hand.label(image, closer=index % 3 == 2)
        labeller.saved()
    taken = time.perf_counter() - begun
    words = page.locator("#progress-text").inner_text()
    said = f"{words}; {hand.clicks} clicks and {hand.keys} keys in {taken:.0f} s"
    labeller.press("r")
    for _ in range(args.count):
        page.wait_for_selector("body:not(.repeating), .point.target")
        if not page.locator(".repeating").count() or not shown:
            break
        hand.label(shown[-1], closer=False)
        labeller.press("Enter")
        page.wait_for_timeout(300)
    labeller.saved()
    return f"{said}; {len(shown)} blind repeats"


def run(*words: object) -> str:
    """A bendtrack command; what it printed."""
    begun = time.perf_counter()
    done = subprocess.run([str(BENDTRACK), *map(str, words)], capture_output=True, text=True)
    print(f"bendtrack {words[0]}: {time.perf_counter() - begun:.1f} s", flush=True)
    if done.returncode:
        sys.exit(f"bendtrack {words[0]} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    return done.stdout


def whole_job(folder: Path, browser_file: str, args: argparse.Namespace) -> None:
    """From a folder with a video to its angles."""
    trial = render_trial(
        folder / "trial",
        seed=args.seed,
        frequency_hz=2 / args.seconds,
        cycles=2,
        angle_max_deg=205.0,
        end_vector_px=args.end_vector,
    )
    root = folder / "study"
    run("new", root)
    if args.steps:
        settings = root / "bendtrack.toml"
        settings.write_text(settings.read_text().replace("[training]", f"[training]\nsteps = {args.steps}"))
    run("frames", root, trial.video_path, "--count", args.count)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=browser_file, args=["--no-sandbox", "--disable-gpu"]
        )
        session = PageSession(Server(BENDTRACK, root), browser)
        print(label_all(session, trial, args), flush=True)
        session.close()
        browser.close()
        if session.problems:
            sys.exit(f"the page reported: {session.problems}")
    frames = LabelStore.of(Project.open(root)).read()
    labelled = [int(re.sub(r"\D", "", frame.image_path.name)) for frame in frames]
    off = np.stack([frame.xy for frame in frames]) - trial.xy[labelled]
    print(
        f"labels: {len(frames)} frames, {rms(off):.2f} px from the truth along each axis (the hand: {args.noise:g})"
    )
    print(run("labels", "check", root).strip())
    run("train", root)
    run("track", root, trial.video_path)
    table = read_results(next((root / "results").glob("*.h5")))
    rest = np.ones(len(trial.angle_deg), bool)
    rest[labelled] = False
    error = (table.angle_deg - trial.angle_deg)[rest]
    found = np.isfinite(error)
    floor = label_noise_floor_deg(
        args.noise, len(frames), end_vector_px(trial.xy, trial.keypoints, table.definition)
    )
    print(
        f"angle RMSE {rms(error[found]):.2f} degrees in {found.sum()} of {rest.sum()} unlabelled frames,"
        f" {rms(error[found]) / floor:.2f} of the label-noise floor ({floor:.2f})"
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=9101, help="of the trial's look and of the hand")
    parser.add_argument("--seconds", type=float, default=12.0, help="length of the video")
    parser.add_argument("--end-vector", type=float, default=60.0, help="length of the end vectors, px")
    parser.add_argument("--count", type=int, default=30, help="frames to label")
    parser.add_argument("--noise", type=float, default=1.0, help="the hand's error along each axis, px")
    parser.add_argument("--steps", type=int, help="training steps, instead of the default")
    args = parser.parse_args()
    browser_file = browser_path()
    if browser_file is None:
        sys.exit(f"expected a browser, one of {', '.join(BROWSERS)}, got none")
    with tempfile.TemporaryDirectory(prefix="bendtrack-labelling-") as folder:
        whole_job(Path(folder), browser_file, args)


if __name__ == "__main__":
    main()
