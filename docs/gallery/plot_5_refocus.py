"""
Refocus and look around
=======================

One flat is drawn in focus on the branches and on the house, and as two eyes see it.
"""

import matplotlib.pyplot as plt
import numpy as np

import lfrender
from data_synth import SCENES, Camera, simulate

camera = Camera.design(size=(700, 520), pitch=20.3)
capture = simulate(SCENES["house"](camera), camera, samples=8)
calibration = capture.truth.calibration
lattice = calibration.lattice
depth = lfrender.analyze(capture.flat, calibration)

near, far = lfrender.focal_stack(
    capture.flat, calibration, [-0.3 * lattice.pitch, 0.3 * lattice.pitch], scale=6.0
)

# From aside, no lens may see the border of the picture and places behind near objects. So the
# offset is moderate, and only the part that both eyes see is shown.
offset = 0.3 * lattice.radius
left, right = lfrender.views(
    capture.flat, calibration, depth, offsets=[(-offset, 0), (offset, 0)], scale=6.0
)
seen = left.valid & right.valid
rows, columns = (np.flatnonzero(seen.mean(1 - side) > 0.98) for side in (0, 1))
part = np.ix_(np.arange(rows[0], rows[-1] + 1), np.arange(columns[0], columns[-1] + 1))
print(f"seen by a lens: {seen[part].mean():.2%}")

fig, axes = plt.subplots(2, 2, figsize=(8, 6), layout="constrained")
for ax, name, picture in zip(
    axes[0], ("on the branches", "on the house"), (near, far), strict=True
):
    picture.plot(ax)
    ax.set(title=name, xlabel="", ylabel="", xticks=[], yticks=[])
for ax, name, picture in zip(axes[1], ("left eye", "right eye"), (left, right), strict=True):
    ax.imshow(picture.image[part])
    ax.set(title=name, xticks=[], yticks=[])
plt.show()
