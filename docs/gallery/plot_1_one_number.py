"""
One signed number
=================

Two neighbouring microlenses show the same feature, shifted by the signed patch size ``s``. This
example photographs a telescopic and a binocular plane, and compares two neighbouring microimages of
each over all shifts.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.ndimage import map_coordinates

from data_synth import SCENES, Camera, simulate

camera = Camera.design(size=(360, 260), pitch=30.0)
fig, axes = plt.subplots(2, 3, figsize=(8, 5), layout="constrained")
for row, ratio in zip(axes, (0.3, -0.3), strict=True):
    capture = simulate(SCENES["plane"](camera, ratio=ratio), camera, samples=8)
    gray = capture.flat.mean(2)
    lattice = capture.truth.calibration.lattice
    index = lattice.middle
    left, right = lattice.points(index + np.array([[0, 0], [1, 0]]))

    # Each microimage, about its centre:
    reach = np.arange(-9, 10)
    v, u = np.meshgrid(reach, reach, indexing="ij")
    for ax, centre, name in zip(row, (left, right), ("a lens", "its neighbour"), strict=False):
        ax.imshow(map_coordinates(gray, [v + centre[1], u + centre[0]], order=1), cmap="gray")
        ax.set(title=f"{name}, s = {ratio} D", xticks=[], yticks=[])

    # Correlation over the shift, along the line that joins the centres: its peak is at the true
    # ``s``.
    shifts = np.linspace(-14, 14, 113)
    along = (right - left) / lattice.pitch
    scores = []
    for shift in shifts:
        inside = np.hypot(u, v) < 9
        moved_u = u + shift * along[0]
        moved_v = v + shift * along[1]
        inside &= np.hypot(moved_u, moved_v) < 11
        here = map_coordinates(gray, [v + left[1], u + left[0]], order=1)[inside]
        there = map_coordinates(gray, [moved_v + right[1], moved_u + right[0]], order=1)[inside]
        scores.append(np.corrcoef(here, there)[0, 1])
    row[2].plot(shifts, scores)
    row[2].axvline(ratio * lattice.pitch, color="tab:orange", label="truth")
    row[2].set(xlabel="shift [px]", ylabel="correlation")
    row[2].legend()

found = shifts[int(np.argmax(scores))]
print(f"binocular plane: peak at {found:.2f} px, truth {ratio * lattice.pitch:.2f} px")
plt.show()
