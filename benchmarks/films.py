"""Odd films: what is said of sound and of damaged ones, row by row against the truth.

    python benchmarks/films.py                          every film: some 180 sound and 500 damaged ones, 4 minutes
    python benchmarks/films.py --only vp9 --seeds 1     films with this in their name
    python benchmarks/films.py --list                   also a line for each film that is not right

The films are drawn and encoded here (`tests/odd_films`): four coloured discs that turn by a known angle. A detector
that needs no network finds the discs. Goals: no row without a flag wrong by more than a degree, no film short without
a word, no traceback, no sound film called damaged.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import zlib
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from odd_films import damage, sound
from odd_films.encoding import write
from odd_films.verdict import Judged, Verdict, judge


def main() -> None:
    """Write, judge and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default="", help="part of the names of films")
    parser.add_argument(
        "--seeds", type=int, default=2, help="copies of each kind of damage that chance decides"
    )
    parser.add_argument("--list", action="store_true", help="a line for each film that is not right")
    args = parser.parse_args()

    with tempfile.TemporaryDirectory(prefix="bendtrack-films-") as name:
        folder = Path(name)
        found = {"sound": _sound(folder, args.only), "damaged": _damaged(folder, args.only, args.seeds)}
    if args.list:
        for films in found.values():
            for name, judged in films.items():
                if judged.verdict != Verdict.RIGHT:
                    print(_line(name, judged))
    print(f"{'films':10s}{'tried':>7s}{'right':>7s}{'said':>7s}{'silent':>8s}{'short':>7s}", end="")
    print(f"{'tracebacks':>12s}{'wrong rows':>18s}")
    for kind, films in found.items():
        count = Counter(judged.verdict for judged in films.values())
        wrong = f"{sum(j.wrong for j in films.values())} of {sum(j.rows for j in films.values())}"
        print(
            f"{kind:10s}{len(films):7d}{count[Verdict.RIGHT]:7d}{count[Verdict.SAID]:7d}{count[Verdict.SILENT]:8d}"
            f"{count[Verdict.SHORT]:7d}{count[Verdict.TRACEBACK]:12d}{wrong:>18s}"
        )
    alarms = sum(not judged.complete or judged.flagged > 0 for judged in found["sound"].values())
    print(f"sound films called damaged, or with a flag: {alarms} (goal 0)")


def _sound(folder: Path, only: str) -> dict[str, Judged]:
    found = {}
    for name, recipe in sound.sound_films():
        if only in name:
            path = sound.write_film(name, recipe, folder)
            found[name] = judge(path, recipe.frame_times_s)
            path.unlink()
    return found


def _damaged(folder: Path, only: str, seeds: int) -> dict[str, Judged]:
    found = {}
    for codec, suffix, kind in damage.damaged_films():
        if only not in f"{codec}_{kind}{suffix}":
            continue
        recipe, whole = sound.recipe(codec, suffix), folder / f"{codec}{suffix}"
        if not whole.exists():
            write(recipe, whole)
        for seed in range(1 if kind in damage.WITHOUT_CHANCE else seeds):
            name = f"{codec}_{kind}_{seed}{suffix}"
            path = damage.damaged(whole, folder / name, kind, zlib.crc32(name.encode()))
            found[name] = judge(path, recipe.frame_times_s)
            path.unlink()
    return found


def _line(name: str, judged: Judged) -> str:
    return (
        f"{name:32s} {judged.verdict:10s} {judged.rows} rows, {judged.flagged} flagged, {judged.wrong} wrong, worst"
        f" {judged.worst_deg:.1f} deg; {'; '.join(judged.words[:2])}"
    )


if __name__ == "__main__":
    main()
