"""Whether the stated uncertainty holds: the share of frames whose 95 % interval holds the truth, look by look.

    python benchmarks/coverage.py      six looks that pretraining never saw; 0, 1, 5, 10 and 30 labels
    python benchmarks/coverage.py --known --looks 3 --labels 30      looks of the training families
    python benchmarks/coverage.py --looks 1 --labels 1 --steps 3 --frames 40      a run to see that it runs

Films, labels and trainings are those of `few_labels.py`. For each look and number of labels: coverage of the 95 %
interval over the frames without a flag, the mean error (offset of the film), the standard deviation about it (scatter
from frame to frame), and the stated standard deviation. Then, over the looks, how often |error| / sd is within what a
normal distribution gives: an offset is one draw a film, so a single film is mostly all in or all out.
"""

from __future__ import annotations

import argparse

import numpy as np
from few_labels import Result, add_look_arguments, filmed_looks, rows_of

GOAL = (93.0, 97.0)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_look_arguments(parser, frames=120)
    parser.add_argument("--labels", type=int, action="append", help="may be given again; 0, 1, 5, 10 and 30")
    args = parser.parse_args()
    counts = sorted(args.labels or (0, 1, 5, 10, 30))
    rows: dict[str, list[Result]] = {}
    for index, look, film in filmed_looks(args):
        for _, key, result, _ in rows_of(film, look, counts, ["actuator"], args):
            rows.setdefault(key, []).append(result)
            print(
                f"look {index:2d} labels {key:>5s}  in the 95 % interval {100 * result.within_95:5.1f} %"
                f"  offset {result.offset_deg:+6.2f}  scatter {result.scatter_deg:5.2f}"
                f"  stated {result.stated_deg:5.2f} degrees  not flagged {100 * result.sound:5.1f} %",
                flush=True,
            )
    print(
        f"\nover the looks; goal: {GOAL[0]:g} to {GOAL[1]:g} % in each\n"
        "labels  mean %  lowest  highest  looks within the goal  rms error  rms stated, degrees"
    )
    for key, results in rows.items():
        share = 100 * np.array([result.within_95 for result in results])
        known = [result for result in results if np.isfinite(result.stated_deg)]
        rms, stated = (
            float(np.sqrt(np.mean(squares))) if known else float("nan")
            for squares in (
                [result.offset_deg**2 + result.scatter_deg**2 for result in known],
                [result.stated_deg**2 for result in known],
            )
        )
        inside = int(((share >= GOAL[0]) & (share <= GOAL[1])).sum())
        print(
            f"{key:>6s}  {share.mean():6.1f}  {share.min():6.1f}  {share.max():7.1f}"
            f"  {inside:14d} of {len(results):2d}  {rms:9.2f}  {stated:10.2f}"
        )


if __name__ == "__main__":
    main()
