"""
Into movement and back
======================

`movement <https://movement.neuroinformatics.dev>`_ analyses poses over time. ``AngleTable.to_xarray`` gives
its dataset, with the bending angle next to the poses; ``AngleTable.from_xarray`` takes it back.

Both need an extra, installed from the copy of the repository: ``.venv/bin/pip install '.[movement]'``.
"""

# %%
# A table
# -------
# Yours comes from ``bt.measure("a.mp4")`` or ``project.track("a.mp4")``. Here it is made from the sample
# trial's exact points, so that the example runs in a second.

from dataclasses import replace
from importlib.resources import files

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from movement.kinematics import compute_speed

from bendtrack.tracker import AngleDefinition, AngleTable, bending_angle
from bendtrack.tracker.angle import sign_from_labels

keypoints = ("base_1", "base_2", "tip_1", "tip_2")
truth = pd.read_csv(str(files("bendtrack.data_samples") / "truth.csv"))
columns = [f"{name}_{axis}" for name in keypoints for axis in "xy"]
xy = truth[columns].to_numpy().reshape(-1, 4, 2)
definition = AngleDefinition("two-vector", keypoints)
definition = replace(definition, sign=sign_from_labels(xy, keypoints, definition))
covariance = np.tile(0.1 * np.eye(2), (*xy.shape[:2], 1, 1))
angle_deg, angle_sd_deg, _ = bending_angle(xy, keypoints, definition, covariance)
table = AngleTable(
    time_s=truth["time_s"].to_numpy(),
    angle_deg=angle_deg,
    angle_sd_deg=angle_sd_deg,
    flag=np.full(len(xy), ""),
    xy=xy,
    likelihood=np.ones(xy.shape[:2]),
    covariance=covariance,
    keypoints=keypoints,
    definition=definition,
)

# %%
# Into movement
# -------------
# The dataset has movement's dimensions: time, space, keypoints and individuals. The angle lies on time, and
# its unit is in the attributes.

dataset = table.to_xarray()
dataset

# %%
# movement's own functions take it as it is: the tip's speed, in px/s.

speed = compute_speed(dataset.position).sel(keypoints="tip_2").squeeze()
figure, (above, below) = plt.subplots(2, 1, figsize=(7, 4.2), sharex=True)
above.plot(dataset.time, dataset.angle, color="#0072B2")
above.set_ylabel("bending angle (deg)")
below.plot(dataset.time, speed, color="#D55E00")
below.set(xlabel="time (s)", ylabel="speed of tip_2 (px/s)")
for axes in (above, below):
    axes.spines[["top", "right"]].set_visible(False)

# %%
# And back
# --------

again = AngleTable.from_xarray(dataset)
print(np.abs(again.angle_deg - table.angle_deg).max(), "degrees changed")
