"""
Reading a results table
=======================

``bendtrack track`` leaves a table for every video. This example writes one, reads it back, and plots the
angle with its uncertainty and its flagged rows.
"""

# %%
# A table
# -------
# So that the example runs anywhere, the table is made from the sample trial's exact points, with 0.3 px of
# noise and a stretch in which the tip was hidden. Yours comes from ``bendtrack track``.

import tempfile
from dataclasses import replace
from importlib.resources import files

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from bendtrack.tracker import (
    AngleDefinition,
    AngleTable,
    bending_angle,
    read_results,
    write_results,
)
from bendtrack.tracker.angle import sign_from_labels

keypoints = ("base_1", "base_2", "tip_1", "tip_2")
truth = pd.read_csv(str(files("bendtrack.data_samples") / "truth.csv"))
xy = (
    truth[[f"{name}_{axis}" for name in keypoints for axis in "xy"]]
    .to_numpy()
    .reshape(-1, 4, 2)
)
rng = np.random.default_rng(1)
noise_px = np.full((len(xy), 4), 0.3)
hidden = slice(240, 275)
noise_px[hidden, 2:] = 6.0
xy = xy + rng.normal(size=xy.shape) * noise_px[..., None]
covariance = np.eye(2) * noise_px[..., None, None] ** 2
likelihood = np.where(noise_px > 1, 0.2, 0.9)
definition = AngleDefinition("two-vector", keypoints)
definition = replace(definition, sign=sign_from_labels(xy, keypoints, definition))
angle_deg, angle_sd_deg, _ = bending_angle(xy, keypoints, definition, covariance)
flag = np.where((likelihood < 0.6).any(axis=1), "low_likelihood", "")
made = AngleTable(
    time_s=truth["time_s"].to_numpy(),
    angle_deg=angle_deg,
    angle_sd_deg=angle_sd_deg,
    flag=flag,
    xy=xy,
    likelihood=likelihood,
    covariance=covariance,
    keypoints=keypoints,
    definition=definition,
)
folder = tempfile.mkdtemp()
write_results(made, folder, "sample")

# %%
# Read it
# -------
# The ``.h5`` has full precision and the covariances; the ``.csv`` opens in any spreadsheet.

table = read_results(f"{folder}/sample.h5")
table.to_dataframe().head()

# %%
# Summarise it
# ------------
# Keep the sound rows: an empty flag.

sound = table.flag == ""
print(f"{len(table)} frames, {sound.sum()} sound")
print(f"largest angle {table.angle_deg[sound].max():.1f} degrees")
print(
    f"median standard deviation {np.median(table.angle_sd_deg[sound]):.2f} degrees"
)
pd.Series(table.flag).replace("", "(sound)").value_counts()

# %%
# Plot it
# -------

figure, axes = plt.subplots(figsize=(7, 3.8))
low, high = (
    table.angle_deg - 2 * table.angle_sd_deg,
    table.angle_deg + 2 * table.angle_sd_deg,
)
axes.fill_between(
    table.time_s,
    low,
    high,
    alpha=0.25,
    color="#0072B2",
    linewidth=0,
    label="± 2 sd",
)
axes.plot(
    table.time_s,
    np.where(sound, table.angle_deg, np.nan),
    color="#0072B2",
    lw=1.2,
    label="bending angle",
)
axes.plot(
    table.time_s[~sound],
    table.angle_deg[~sound],
    "o",
    ms=3.5,
    color="#E69F00",
    label="low_likelihood",
)
axes.set(xlabel="time (s)", ylabel="bending angle (deg)")
axes.legend(loc="upper right")
figure.tight_layout()
