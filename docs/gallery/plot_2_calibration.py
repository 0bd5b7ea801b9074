"""
A white image and its lattice
=============================

A square lattice, rotated by 3.7 degrees, is found on a simulated white image. The residuals of the
fit are noise.
"""

import matplotlib.pyplot as plt
import numpy as np

import lfcal
from data_synth import SCENES, Camera, simulate

camera = Camera.design(size=(520, 400), pitch=24.3, lattice="square", rotation=3.7)
capture = simulate(SCENES["blank"](camera), camera, samples=4, noise=(9000, 5))
found = lfcal.calibrate(capture.white, kind="white")

true = capture.truth.calibration.lattice
index = found.lattice.indices()
nearest = np.linalg.norm(found.lattice.centres()[:, None] - true.centres()[None], axis=2).min(1)
print(f"pitch {found.lattice.pitch:.4f} px, truth {true.pitch:.4f} px")
print(
    f"centres within {nearest.max():.4f} px, mean standard error "
    f"{found.errors.of_centres(found.lattice).mean():.4f} px"
)

fig, (left, right) = plt.subplots(1, 2, figsize=(9.5, 4), layout="constrained")
left.imshow(capture.white, cmap="gray")
left.plot(*found.lattice.centres().T, "+", color="tab:orange")
left.set(title="Centres on the white image", xlim=(0, 160), ylim=(120, 0))
found.plot(right)
plt.show()
