"""
Static curve against a model
============================

A staircase of pressure gives the static curve of an actuator. This example finds the stairs, reads the
angle at the steady end of each, and compares the curve with a model, for example a finite-element
simulation.
"""

# %%
# A simulated staircase
# ---------------------
# Steps of 5 kPa from 0 to 50 kPa, each held for 3 s. The angle creeps a little after each step and has 0.4
# degrees of noise.

import matplotlib.pyplot as plt
import numpy as np

from bendtrack.tracker import analyse_study
from bendtrack.tracker.study.trial import Kind, Shift, TrialData
from bendtrack.tracker.synthetic.response import (
    HystereticResponse,
    staircase_duration_s,
    staircase_kpa,
)

response = HystereticResponse(
    pressure_peak_kpa=50, angle_min_deg=0, angle_max_deg=182, hysteresis_ratio=0.1
)
duration_s = staircase_duration_s(50)
time_s = np.arange(int(duration_s * 30)) / 30
log_time_s = np.arange(int(duration_s * 400)) / 400
rng = np.random.default_rng(3)
pressure_kpa = staircase_kpa(time_s, 50)
settled_deg = response.angle_deg(pressure_kpa)
lag = np.exp(-np.arange(0, 60) / 9)
angle_deg = np.convolve(settled_deg, lag / lag.sum())[: len(time_s)] + rng.normal(
    0, 0.4, len(time_s)
)

# %%
# The model curve
# ---------------
# Here the model is a little too stiff at high pressure.

model_kpa = np.linspace(0, 50, 26)
model_deg = response.angle_deg(model_kpa) * (1 - 0.0016 * model_kpa)

# %%
# Analyse
# -------

trial = TrialData(
    name="staircase",
    design="original",
    kind=Kind.STATIC,
    frequency_hz=None,
    pressure_pp_kpa=None,
    time_s=time_s,
    angle_deg=angle_deg,
    angle_sd_deg=np.full(len(time_s), 0.4),
    pressure_kpa=pressure_kpa,
    pressure_rate_kpa_s=np.gradient(pressure_kpa, time_s),
    log_time_s=log_time_s,
    log_pressure_kpa=staircase_kpa(log_time_s, 50)
    + rng.normal(0, 0.05, len(log_time_s)),
    shift=Shift(delay_s=0.0, sd_s=0.0, method="shared clock"),
    model_pressure_kpa=model_kpa,
    model_angle_deg=model_deg,
)
results = analyse_study([trial], baseline=None)
static = results.static.iloc[0]
print(
    f"RMSE {static['rmse_deg']:.2f} degrees, NRMSE {100 * static['nrmse']:.1f} % of the measured range"
)
results.static_steps[
    ["number", "pressure_kpa", "angle_deg", "spread_deg", "model_angle_deg"]
].round(2)

# %%
# The stairs in time, and the curve
# ---------------------------------

steps = results.static_steps
figure, (left, right) = plt.subplots(1, 2, figsize=(9.4, 3.8))
left.plot(time_s, angle_deg, color="0.7", lw=0.8)
for _, step in steps.iterrows():
    left.plot(
        [step["start_s"], step["end_s"]],
        [step["angle_deg"]] * 2,
        color="#0072B2",
        lw=2,
    )
left.set(xlabel="time (s)", ylabel="bending angle (deg)", title="stairs")
right.plot(model_kpa, model_deg, color="#D55E00", label="model")
right.plot(
    steps["pressure_kpa"],
    steps["angle_deg"],
    "o",
    color="#0072B2",
    label="measured",
)
right.set(
    xlabel="pressure (kPa)",
    ylabel="bending angle (deg)",
    title=f"RMSE {static['rmse_deg']:.2f}°",
)
right.legend()
figure.tight_layout()
