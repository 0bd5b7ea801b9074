"""
Confidence and errors
=====================

Every depth has a standard error and a confidence. Lenses without a depth have a reason.
"""

import matplotlib.pyplot as plt
import numpy as np

import lfrender
from data_synth import SCENES, Camera, simulate

camera = Camera.design(size=(700, 520), pitch=23.2)
capture = simulate(SCENES["clutter"](camera), camera, samples=8, noise=(4000, 5))
truth = capture.truth
depth = lfrender.analyze(capture.flat, truth.calibration)

plain = (depth.mode != 0) & (truth.mode != 0) & ~truth.mixed
error = depth.patch_size[plain] - truth.patch_size[plain]
print(f"median error {np.median(np.abs(error)):.3f} px")
for code, reason in enumerate(
    ("resolved", "too little texture", "ambiguous", "image plane on the microlenses")
):
    print(f"{reason}: {(depth.reason == code).mean():.1%}")

fig, (left, right) = plt.subplots(1, 2, figsize=(8, 3.6), layout="constrained")
drawn = left.scatter(
    *truth.calibration.lattice.centres().T, c=depth.confidence, s=30, cmap="viridis", vmin=0, vmax=1
)
left.set(title="Confidence", aspect="equal", xlabel="x [px]", ylabel="y [px]")
left.invert_yaxis()
fig.colorbar(drawn, ax=left)
right.loglog(depth.standard_error[plain], np.abs(error) + 1e-4, ".", alpha=0.4)
right.plot([1e-3, 1], [1e-3, 1], color="tab:orange", label="one standard error")
right.set(xlabel="standard error [px]", ylabel="error [px]", title="Lenses that see one depth")
right.legend()
plt.show()
