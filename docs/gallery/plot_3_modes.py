"""
Two modes in one picture
========================

The house is telescopic, and the branches in front of it are binocular. With one patch size for all
places, only one of them is sharp. With the own mode of each lens, both are sharp.
"""

import matplotlib.pyplot as plt

import lfrender
from data_synth import SCENES, Camera, simulate

camera = Camera.design(size=(700, 520), pitch=20.3)
capture = simulate(SCENES["house"](camera), camera, samples=8)
calibration = capture.truth.calibration

depth = lfrender.analyze(capture.flat, calibration)
print(f"telescopic {(depth.mode == 1).mean():.0%}, binocular {(depth.mode == -1).mean():.0%}")

size = 0.3 * calibration.lattice.pitch
fig, axes = plt.subplots(2, 2, figsize=(8, 6), layout="constrained")
for ax, name, picture in (
    (axes[0, 0], "telescopic for all", lfrender.render(capture.flat, calibration, patch_size=size)),
    (axes[0, 1], "binocular for all", lfrender.render(capture.flat, calibration, patch_size=-size)),
    (axes[1, 0], "each place in its own", lfrender.render(capture.flat, calibration, depth)),
):
    picture.plot(ax)
    ax.set(title=name, xlabel="", ylabel="", xticks=[], yticks=[])
depth.plot(axes[1, 1]).set(xlabel="", ylabel="", xticks=[], yticks=[])
plt.show()
