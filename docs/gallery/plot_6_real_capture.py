"""
A real capture
==============

Fujita2 is a frame of a Raytrix R5 from the MPEG lenslet sequences. Only its pixels are given. If
the captures (folder ``shared`` beside the sources) are missing, a simulated capture is used.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import lfcal
import lfrender

places = [folder / "shared/captures/Fujita2.png" for folder in (Path.cwd(), *Path.cwd().parents)]
file = next((place for place in places if place.exists()), None)
flat = lfrender.data.clutter().flat if file is None else lfcal.read_flat(file)

camera = lfcal.calibrate(flat)
depth = lfrender.analyze(flat, camera)
picture = lfrender.render(flat, camera, depth)
print(camera, depth, sep="\n")

fig, axes = plt.subplots(2, 2, figsize=(8, 7.5), layout="constrained")
height, width = flat.shape[:2]
middle = np.s_[
    int(0.45 * height) : int(0.45 * height) + 160, int(0.45 * width) : int(0.45 * width) + 160
]
axes[0, 0].imshow(flat[middle])
axes[0, 0].set_title("the flat, a piece of it")
axes[0, 1].imshow(lfrender.traditional(flat, camera).image)
axes[0, 1].set_title("one pixel per microlens")
picture.plot(axes[1, 0]).set_title("in focus everywhere")
depth.plot(axes[1, 1])
for ax in axes.flat:
    ax.set(xlabel="", ylabel="", xticks=[], yticks=[])

# %%
# At 100 %
# --------
# The same part of both pictures: the right one has more detail.

rows, columns = picture.image.shape[:2]
part = np.s_[rows // 20 : rows // 20 + rows // 3, columns // 4 : columns // 4 + columns // 3]
small = lfrender.traditional(flat, camera).image
k = rows / small.shape[0]
fig, (left, right) = plt.subplots(1, 2, figsize=(8, 4.2), layout="constrained")
left.imshow(
    small[
        int(part[0].start / k) : int(part[0].stop / k),
        int(part[1].start / k) : int(part[1].stop / k),
    ]
)
left.set(title="one pixel per microlens", xticks=[], yticks=[])
right.imshow(picture.image[part])
right.set(title="lfrender", xticks=[], yticks=[])
plt.show()
