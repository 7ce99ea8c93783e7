"""
Uncertainty, and where to place points
======================================

How exactly can the angle be known? This example carries the uncertainty of points into the angle, checks it
by simulation, and draws the label-noise floor.
"""

# %%
# From points to the angle
# ------------------------
# Each point is off by 0.5 px in x and in y. The standard deviation of the angle follows to first order.

import matplotlib.pyplot as plt
import numpy as np

from bendtrack.tracker import AngleDefinition, bending_angle
from bendtrack.tracker.angle import label_noise_floor_deg

keypoints = ("base_1", "base_2", "tip_1", "tip_2")
definition = AngleDefinition("two-vector", keypoints)


def arm(end_vector_px: float, angle_deg: float = 90.0) -> np.ndarray:
    """Points (4, 2) px of an actuator with straight ends."""
    turn = np.radians(angle_deg)
    base = np.array([[0.0, 0.0], [end_vector_px, 0.0]])
    tip = base[1] + 200 * np.array([np.cos(turn / 2), np.sin(turn / 2)])
    return np.stack(
        [*base, tip, tip + end_vector_px * np.array([np.cos(turn), np.sin(turn)])]
    )


sigma_px = 0.5
covariance = np.broadcast_to(np.eye(2) * sigma_px**2, (1, 4, 2, 2))
for length_px in (20, 40, 60, 100):
    _, sd_deg, _ = bending_angle(
        arm(length_px)[None], keypoints, definition, covariance
    )
    print(f"L = {length_px:3d} px: standard deviation {sd_deg[0]:.2f} degrees")

# %%
# A simulation agrees
# -------------------
# Twenty thousand noisy copies of the same four points, for two lengths of the end vectors.

rng = np.random.default_rng(0)
figure, axes = plt.subplots(figsize=(6.4, 3.6))
for length_px, colour in ((20, "#E69F00"), (60, "#0072B2")):
    noisy = arm(length_px) + rng.normal(0, sigma_px, (20_000, 4, 2))
    measured_deg, _, _ = bending_angle(noisy, keypoints, definition)
    _, sd_deg, _ = bending_angle(
        arm(length_px)[None], keypoints, definition, covariance
    )
    axes.hist(
        measured_deg,
        bins=80,
        density=True,
        alpha=0.55,
        color=colour,
        label=f"L = {length_px} px",
    )
    x = np.linspace(84, 96, 400)
    density = np.exp(-0.5 * ((x - 90) / sd_deg[0]) ** 2) / (
        sd_deg[0] * np.sqrt(2 * np.pi)
    )
    axes.plot(x, density, color=colour)
axes.set(xlabel="measured angle (deg)", ylabel="density", xlim=(84, 96))
axes.legend()
figure.tight_layout()

# %%
# The label-noise floor
# ---------------------
# A network learns from *n* labels that are each off by about 1 px. Averaged over the labels, the angle
# cannot be known better than :math:`2 \sigma / (\sqrt{n} L)`. Twice the length of the end vectors is worth
# four times the labels.

length_px = np.linspace(15, 120, 200)
figure, axes = plt.subplots(figsize=(6.4, 4))
for labels in (5, 10, 30, 100):
    floor_deg = [label_noise_floor_deg(1.0, labels, length) for length in length_px]
    axes.plot(length_px, floor_deg, label=f"{labels} labels")
axes.axvspan(15, 40, color="0.93", zorder=0)
axes.text(17, 0.06, "place the points\nfarther apart", color="0.35")
axes.set(
    xlabel="length L of the end vectors (px)",
    ylabel="label-noise floor (deg)",
    ylim=(0, 4),
)
axes.legend()
figure.tight_layout()
