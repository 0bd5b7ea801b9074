"""
Scenes and cameras, one command each
====================================

``lfsynth`` simulates a capture: flat, white image and truth. Each figure was made by the command
above it, followed by ``lfrender render flat.png -o picture.tif``, which calibrates the camera on the
scene. Here flats are smaller, and traced with fewer rays, than those of the command.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import lfcal
import lfrender
from data_synth.cli import main as lfsynth


def show(command: str) -> None:
    """Run `lfsynth`, calibrate, analyse and render; a piece of the flat, the picture, the depth."""
    with tempfile.TemporaryDirectory() as folder:
        words = command.split()[1:]
        words[words.index("-o") + 1] = folder
        small = ["--size", "560x420", "--samples", "8", "--quiet"]
        lfsynth.main([*words, *small], standalone_mode=False)
        flat = lfcal.read_flat(Path(folder, "flat.png"))
    camera = lfcal.calibrate(flat)
    depth = lfrender.analyze(flat, camera)
    picture = lfrender.render(flat, camera, depth)

    fig, axes = plt.subplots(1, 3, figsize=(9, 2.7), layout="constrained")
    middle = np.s_[150:270, 200:360]
    axes[0].imshow(flat[middle], cmap="gray")
    axes[0].set_title("the flat, a piece of it")
    picture.plot(axes[1]).set_title("in focus everywhere")
    depth.plot(axes[2])
    fig.axes[-1].set_ylabel("magnification")
    for ax in axes:
        ax.set(xlabel="", ylabel="", xticks=[], yticks=[])
    plt.show()


# %%
# Both modes
# ----------
# A house (telescopic) behind branches (binocular).

show("lfsynth house -o capture")

# %%
# Depth edges everywhere
# ----------------------
# Balls, boxes and cards. The array is square and rotated; the sensor has noise.

show("lfsynth clutter -o capture --lattice square --rotation 3 --noise 9000,5")

# %%
# Three lens types
# ----------------
# A slanted plane. Microlenses of three focal lengths are in focus at different depths.

show("lfsynth slope -o capture --types 3")

# %%
# Square apertures
# ----------------
# Microimages are square, with dark gaps between them.

show("lfsynth house -o capture --square-aperture --microimage-fill 0.8 --lattice square")

# %%
# Colour filters
# --------------
# The flat is a raw mosaic, as a sensor delivers it.

show("lfsynth clutter -o capture --mosaic RGGB")

# %%
# Texture that repeats
# --------------------
# Several depths match equally well. The lenses stay without a depth, a warning says so, and the
# picture is the traditional one, with one pixel per microlens.

show("lfsynth periodic -o capture")

# %%
# A Siemens star
# --------------
# The picture shows how fine the detail is that remains.

show("lfsynth star -o capture --pitch 30")
