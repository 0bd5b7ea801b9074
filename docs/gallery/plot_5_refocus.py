"""
Refocus and look around
=======================

The same flat in focus on the branches and on the house, and as two eyes see it.
"""

import matplotlib.pyplot as plt

import lfrender
from data_synth import SCENES, Camera, simulate

camera = Camera.design(size=(700, 520), pitch=20.3)
capture = simulate(SCENES["house"](camera), camera, samples=8)
calibration = capture.truth.calibration
lattice = calibration.lattice
depth = lfrender.analyze(capture.flat, calibration)

near, far = lfrender.focal_stack(capture.flat, calibration, [-0.3 * lattice.pitch, 0.3 * lattice.pitch], scale=6.0)
offset = 0.6 * lattice.radius
left, right = lfrender.views(capture.flat, calibration, depth, offsets=[(-offset, 0), (offset, 0)], scale=6.0)

fig, axes = plt.subplots(2, 2, figsize=(10, 8), layout="constrained")
for ax, name, picture in zip(
    axes.flat, ("on the branches", "on the house", "left eye", "right eye"), (near, far, left, right), strict=True
):
    picture.plot(ax)
    ax.set_title(name)
plt.show()
