"""
Hysteresis of a loop
====================

From a pressure log and angles to the hysteresis ratio. The sample trial was rendered with a ratio of 0.25
in every cycle, so the result can be checked.
"""

# %%
# Bring the log to the frames
# ---------------------------
# The log has 400 samples per second, the video 30 frames. The pressure at a frame is a line fitted to the
# samples around it.

from importlib.resources import files

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from bendtrack.tracker import analyse_study
from bendtrack.tracker.study.hysteresis import hysteresis_ratio, loop_area_deg_kpa
from bendtrack.tracker.study.pressure_log import read_pressure_log
from bendtrack.tracker.study.resampling import pressure_at_frames
from bendtrack.tracker.study.trial import Kind, Shift, TrialData

sample = files("bendtrack.data_samples")
truth = pd.read_csv(str(sample / "truth.csv"))
log = read_pressure_log(str(sample / "pressure.csv"))
time_s = truth["time_s"].to_numpy()
angle_deg = truth["angle_deg"].to_numpy() + np.random.default_rng(0).normal(
    0, 0.3, len(truth)
)
pressure_kpa, rate_kpa_s = pressure_at_frames(time_s, log.time_s, log.pressure_kpa)

# %%
# One loop
# --------
# A cycle lasts 6.67 s. Its area over the rectangle from the axes to the largest pressure and angle is the
# hysteresis ratio.

cycle = (time_s >= 1 / 0.15) & (time_s <= 2 / 0.15)
loop = np.column_stack([pressure_kpa[cycle], angle_deg[cycle]])
area = loop_area_deg_kpa(loop)
ratio = hysteresis_ratio(area, loop[:, 0].max(), loop[:, 1].max())
print(f"area {area:.0f} deg kPa, hysteresis ratio {ratio:.3f}")

figure, axes = plt.subplots(figsize=(6, 4.4))
axes.fill(*loop.T, color="#56B4E9", alpha=0.3)
axes.plot(*loop.T, color="#0072B2")
axes.plot(
    [0, loop[:, 0].max(), loop[:, 0].max()],
    [loop[:, 1].max(), loop[:, 1].max(), 0],
    color="0.5",
    ls="--",
)
axes.set(
    xlabel="pressure (kPa)",
    ylabel="bending angle (deg)",
    xlim=(0, None),
    ylim=(0, None),
)
axes.set_title(f"hysteresis ratio {ratio:.3f}")
figure.tight_layout()

# %%
# With intervals
# --------------
# ``analyse_study`` finds the cycles, fits the largest angle, and carries the clock's uncertainty into a 95
# % interval.

trial = TrialData(
    name="sample",
    design="sample",
    kind=Kind.DYNAMIC,
    frequency_hz=0.15,
    pressure_pp_kpa=50.0,
    time_s=time_s,
    angle_deg=angle_deg,
    angle_sd_deg=np.full(len(time_s), 0.3),
    pressure_kpa=pressure_kpa,
    pressure_rate_kpa_s=rate_kpa_s,
    log_time_s=log.time_s,
    log_pressure_kpa=log.pressure_kpa,
    shift=Shift(delay_s=0.0, sd_s=0.0, method="shared clock"),
)
results = analyse_study([trial], baseline=None)
results.dynamic[
    ["trial", "hysteresis_ratio", "hysteresis_ratio_low", "hysteresis_ratio_high"]
].round(3)

# %%
# A wrong clock looks like hysteresis
# -----------------------------------
# Shift the log by a few frames and the ratio changes, although the actuator did the same. This is why
# bendtrack never fits the shift by making the loop small.

frames = np.arange(-3, 4)
ratios = []
for shift in frames:
    shifted_kpa, _ = pressure_at_frames(
        time_s, log.time_s + shift / 30, log.pressure_kpa
    )
    moved = np.column_stack([shifted_kpa[cycle], angle_deg[cycle]])
    ratios.append(
        hysteresis_ratio(
            loop_area_deg_kpa(moved), moved[:, 0].max(), moved[:, 1].max()
        )
    )

figure, axes = plt.subplots(figsize=(6, 3.4))
axes.plot(frames, ratios, "o-", color="#D55E00")
axes.axhline(0.25, color="0.6", ls=":")
axes.set(
    xlabel="shift of the log (frames at 30 per second)", ylabel="hysteresis ratio"
)
figure.tight_layout()
