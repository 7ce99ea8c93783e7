"""How fast the stream of rendered actuators is on one core, and where its time goes.

    python benchmarks/stream.py                              1000 pictures of 256 x 256, and a video of 640 x 480
    python benchmarks/stream.py --pictures 12 --frames 3     a run to see that it runs

The goal is 100 pictures/s. Beside the wall clock stands the processor's, which other people's work on the machine
touches less, and the time of a Gaussian blur, by which two machines can be compared.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence

import cv2
import numpy as np

from bendtrack.tracker.synthetic.stream import HELD_OUT, KINDS, Renderer, draw, drawn_look, inflation_deg
from bendtrack.tracker.types import FloatArray

# Fields of noise are drawn at the first use of each.
_WARM_UP = 20


def milliseconds(works: Sequence[Callable[[], object]]) -> FloatArray:
    """Wall and processor time of each, (N, 2) ms."""
    mapping = []
    for work in works:
        begun = time.perf_counter(), time.process_time()
        work()
        mapping.append((time.perf_counter() - begun[0], time.process_time() - begun[1]))
    return 1e3 * np.array(mapping)


def line(name: str, taken_ms: FloatArray) -> str:
    """Median, spread and rate."""
    low, median, high = np.percentile(taken_ms[:, 0], [5, 50, 95])
    rate, rate_cpu = 1e3 / taken_ms.mean(axis=0)
    return (
        f"{name:22s} median {median:5.1f} ms (5 to 95 %: {low:.1f} to {high:.1f}), "
        f"{rate:.0f} pictures/s, {rate_cpu:.0f} by processor time"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--pictures", type=int, default=1000)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    for index in range(min(_WARM_UP, args.pictures)):
        draw(args.seed + 1, index, kinds=KINDS)
    noise = np.random.default_rng(0).integers(0, 255, (256, 256, 3)).astype(np.uint8)
    blur = milliseconds([lambda: cv2.GaussianBlur(noise, (0, 0), 1.0)] * 200)
    print(f"Gaussian blur of a picture: {np.median(blur[:, 0]):.2f} ms")
    # In turn, so that both meet the same machine.
    both = milliseconds(
        [
            lambda i=index, k=kinds: draw(args.seed, i, kinds=k)
            for index in range(args.pictures)
            for kinds in ((), KINDS)
        ]
    )
    print(line("256 x 256, every look", both[::2]))
    print(line("256 x 256, with extras", both[1::2]))
    wall, cpu = both[1::2].sum(axis=0) / both[::2].sum(axis=0) - 1
    print(f"extras take {100 * wall:.0f} % longer, {100 * cpu:.0f} % by processor time")
    look = drawn_look(args.seed, size_wh=(640, 480), families=HELD_OUT)
    renderer = Renderer(look)
    renderer.frame(0)
    bends = inflation_deg(look, args.frames)
    print(line("640 x 480, one look", milliseconds([lambda b=bend: renderer.frame(b) for bend in bends])))


if __name__ == "__main__":
    main()
