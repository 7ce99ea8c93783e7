"""
Rendering a synthetic trial
===========================

A rendered trial looks like a film of a soft actuator, and everything about it is known exactly. It serves
to try settings, to teach, and to test your own analysis.
"""

# %%
# Render
# ------
# One cycle of a triangle wave at 0.5 Hz, small and short so that this page builds quickly. ``seed`` draws
# the look.

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from bendtrack.tracker import Video
from bendtrack.tracker.synthetic.trial import render_trial

folder = Path(tempfile.mkdtemp()) / "trial"
trial = render_trial(
    folder,
    seed=386,
    frequency_hz=0.5,
    cycles=1,
    angle_max_deg=200,
    hysteresis_ratio=0.25,
    frame_rate=15,
    size_wh=(320, 240),
    end_vector_px=30,
)
print(sorted(path.name for path in folder.iterdir()))

# %%
# Look at it
# ----------
# The exact points of every frame are part of the trial.

wanted = np.linspace(0, int(np.argmax(trial.angle_deg)), 4).astype(int)
images = {
    i: frame.image for i, frame in enumerate(Video(trial.video_path)) if i in wanted
}
figure, panels = plt.subplots(1, 4, figsize=(10, 2.4))
for axes, index in zip(panels, wanted, strict=True):
    axes.imshow(images[index])
    axes.plot(*trial.xy[index].T, "o-", color="#E69F00", ms=3.5, lw=1.2)
    axes.set(xticks=[], yticks=[], title=f"{trial.angle_deg[index]:.0f}°")
figure.tight_layout()

# %%
# Pressure and angle
# ------------------
# The angle follows the pressure with hysteresis, a Prandtl-Ishlinskii operator, whose ratio is exact.

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4))
left.plot(trial.time_s, trial.angle_deg, color="#0072B2", label="angle (deg)")
left.plot(trial.time_s, trial.pressure_kpa, color="#D55E00", label="pressure (kPa)")
left.set(xlabel="time (s)")
left.legend()
right.plot(trial.pressure_kpa, trial.angle_deg, color="#0072B2")
right.set(
    xlabel="pressure (kPa)",
    ylabel="angle (deg)",
    title=f"hysteresis ratio {trial.hysteresis_ratio}",
)
figure.tight_layout()
