"""
Bending angle from points
=========================

Four points give the bending angle of a frame. This example shows one frame of the sample trial, computes
its angle, and compares the four definitions on a circular arc that bends past 180 degrees.
"""

# %%
# One frame of the sample trial
# -----------------------------
# ``truth.csv`` holds the exact points of every frame. We take the frame with the largest angle.

from dataclasses import replace
from importlib.resources import files

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from bendtrack.tracker import AngleDefinition, Video, bending_angle
from bendtrack.tracker.angle import sign_from_labels

sample = files("bendtrack.data_samples")
truth = pd.read_csv(str(sample / "truth.csv"))
keypoints = ("base_1", "base_2", "tip_1", "tip_2")
xy = (
    truth[[f"{name}_{axis}" for name in keypoints for axis in "xy"]]
    .to_numpy()
    .reshape(-1, 4, 2)
)

definition = AngleDefinition("two-vector", keypoints)
# Bending under pressure is positive, whichever way this actuator turns on the screen.
definition = replace(definition, sign=sign_from_labels(xy, keypoints, definition))
angle_deg, _, _ = bending_angle(xy, keypoints, definition)
largest = int(np.argmax(angle_deg))
print(
    f"frame {largest}: {angle_deg[largest]:.2f} degrees, exactly {truth['angle_deg'][largest]:.2f}"
)

# %%
# The two end vectors define the angle: 200 degrees, from a single frame and without a jump at 180.

for index, frame in enumerate(Video(str(sample / "video.mp4"))):
    if index == largest:
        image = frame.image
        break

figure, axes = plt.subplots(figsize=(6.4, 4.8))
axes.imshow(image)
for (x, y), (dx, dy), colour in zip(
    xy[largest, [0, 2]],
    np.diff(xy[largest], axis=0)[[0, 2]],
    ("#E69F00", "#56B4E9"),
    strict=True,
):
    axes.annotate(
        "",
        (x + dx, y + dy),
        (x, y),
        arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 3},
    )
axes.plot(*xy[largest].T, "o", color="white", markeredgecolor="black", markersize=6)
axes.set(xticks=[], yticks=[], title=f"{angle_deg[largest]:.1f} degrees")
figure.tight_layout()

# %%
# Four definitions
# ----------------
# Five points on a circular arc, held at a straight fixed end. The sum of turns follows the arc past 180
# degrees.

names = ("base_1", "base_2", "mid_1", "tip_1", "tip_2")
bend_deg = np.linspace(1, 260, 200)
place = np.linspace(0, 1, 5)
radius = 200 / np.radians(bend_deg)
turned = np.radians(bend_deg)[:, None] * place
arc = np.stack(
    [radius[:, None] * np.sin(turned), radius[:, None] * (1 - np.cos(turned))],
    axis=-1,
)

figure, axes = plt.subplots(figsize=(6.4, 4))
for name, points in (
    ("two-vector", names),
    ("arc-fit", names),
    ("chord", ("base_1", "base_2", "tip_2")),
    ("three-point", ("base_1", "mid_1", "tip_2")),
):
    measured_deg, _, _ = bending_angle(arc, names, AngleDefinition(name, points))
    axes.plot(bend_deg, measured_deg, label=name)
axes.axline((0, 0), slope=1, color="0.7", linestyle=":", label="the arc itself")
axes.set(xlabel="bend of the arc (deg)", ylabel="angle (deg)")
axes.legend()
figure.tight_layout()

# %%
# ``arc-fit`` equals the arc. ``two-vector`` measures between the middles of the first and the last segment,
# so with five points on a continuous arc it gives three quarters of the bend. Real actuators have straight
# ends, and there it gives all of it.
