"""Named scenes. Each places its surfaces by the wanted `s / D`, so that any camera can photograph
it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .camera import Camera
from .scenery.facade import facade
from .scenery.foliage import branches, leaf_mass
from .scenery.textures import bricks, dead_leaves, fractal_noise, text_page
from .surfaces import Patch, Scene, Sphere, box

__all__ = [
    "SCENES",
    "blank",
    "clutter",
    "edge",
    "house",
    "periodic",
    "plane",
    "ramp",
    "slope",
    "star",
]

# Texels are as wide as the pixels of the reference picture; on the flat everything is two to eight
# times coarser. Beyond the largest side they widen, to bound memory.
_TEXEL = 2.0
_LARGEST_TEXTURE = 6000
Texture = NDArray[np.float32]


def house(camera: Camera, *, far: float = 0.3, near: float = -0.3, seed: int = 0) -> Scene:
    """The paper's house behind branches: telescopic front of the house, binocular branches and
    leaves, one flat.

    Parameters
    ----------
    far, near : float
        `s / D` of the house and of the middle layer of branches.
    """
    rng = np.random.default_rng(seed)
    shape = _texels(camera, far)
    unit = shape[1] / 60
    surfaces = [_sheet(camera, far, facade(shape, unit, rng))]
    shape = _texels(camera, near)
    scale = shape[1] / 60
    cover = np.zeros((64, 64), np.float32)
    cover[:, :5] = 0.9
    cover[54:, :12] = 0.9
    thicket = leaf_mass(shape, rng, cover, leaf=1.8 * scale)
    surfaces.append(_sheet(camera, near - 0.05, thicket))
    boughs = [
        [(-0.02, 0.95, -0.75)],
        [(1.02, 0.3, 2.8)],
        [(1.02, 0.98, 3.6)],
    ]
    for roots, ratio in zip(boughs, (near, near * 0.93, near * 1.1), strict=True):
        wood = branches(shape, rng, roots, thickness=2.2 * scale, leaf=1.8 * scale)
        surfaces.append(_sheet(camera, ratio, wood))
    return Scene("house", tuple(surfaces))


def plane(camera: Camera, *, ratio: float = -0.3, seed: int = 0) -> Scene:
    """One plane facing the camera, rich in detail, at `s / D = ratio`."""
    return Scene("plane", (_sheet(camera, ratio, _rich(_texels(camera, ratio), seed)),))


def slope(camera: Camera, *, left: float = -0.55, right: float = -0.14, seed: int = 0) -> Scene:
    """One slanted plane, whose `s / D` runs from `left` to `right`, both of one sign."""
    if left * right <= 0:
        raise ValueError(
            "left and right must have the same sign (the focal plane lies between), "
            f"got {left}, {right}"
        )
    width = camera.width
    height = camera.height
    depths = camera.depth_at([left, right])
    corners = camera.place([(0, 0), (width, 0), (0, height)], [depths[0], depths[1], depths[0]])
    # A lens sees beyond the flat by its magnification; the plane is carried on by as much, in
    # object space.
    across = corners[1] - corners[0]
    down = corners[2] - corners[0]
    down = down * depths.max() / depths[0]
    centre = camera.place((width / 2, height / 2), 0.5 * (corners[0, 2] + corners[1, 2]))
    margin = 1 + 2 * max(_margin(camera, left), _margin(camera, right)) / min(width, height)
    across = across * min(margin, 1.9)
    down = down * margin
    if centre[2] - abs(across[2]) / 2 <= 0:
        raise ValueError(f"no plane in front of the camera runs from s/D = {left} to {right}")
    texture = _rich(_texels(camera, min(left, right, key=abs)), seed)
    return Scene("slope", (Patch(centre - across / 2 - down / 2, across, down, texture),))


def clutter(
    camera: Camera, *, far: float = -0.55, near: float = -0.15, count: int = 40, seed: int = 0
) -> Scene:
    """Balls, boxes and tilted cards before a wall at `far`, up to `near`: binocular, depth edges
    everywhere.

    Parameters
    ----------
    far, near : float
        `s / D` of the wall and of the nearest object; of binocular places the nearest have the
        smallest `|s|`.
    """
    rng = np.random.default_rng(seed)
    unit = min(camera.width, camera.height)
    tile = (max(48, unit // 8),) * 2
    textures = [
        _rich(tile, seed + 1),
        bricks(tile, rng, course=tile[0] / 8),
        text_page(tile, rng, size=max(0.4, tile[0] / 150)),
        dead_leaves(tile, rng, smallest=3, largest=tile[0] / 5),
        text_page(
            tile, rng, ink=(250, 240, 120), paper=(120, 30, 40), size=max(0.4, tile[0] / 110)
        ),
    ]
    surfaces: list[Patch | Sphere] = [_sheet(camera, far, _rich(_texels(camera, far), seed))]
    for k in range(count):
        ratio = far + (near - far) * (0.1 + 0.9 * rng.random())
        depth = camera.depth_at(ratio)
        at = rng.random(2) * (camera.width, camera.height)
        centre = camera.place(at, depth)
        size = (
            camera.place(at + np.array([unit * rng.uniform(0.04, 0.11), 0]), depth)[0] - centre[0]
        )
        axes = size * _rotation(rng)
        texture = textures[k % len(textures)]
        if k % 3 == 0:
            surfaces.append(Sphere(centre, size, texture))
        elif k % 3 == 1:
            surfaces += box(centre, axes * rng.uniform(0.5, 1.0, (3, 1)), texture)
        else:
            across = 2 * axes[0] * (1, 1, 0.3)
            down = 2 * axes[1] * (1, 1, 0.3)
            surfaces.append(Patch(centre - across / 2 - down / 2, across, down, texture))
    return Scene("clutter", tuple(surfaces))


def ramp(camera: Camera, *, ratio: float = -0.3, seed: int = 0) -> Scene:
    """A smooth ramp of brightness: hardly any texture. `seed` is accepted and not needed."""
    level = np.linspace(0.08, 0.9, 256, dtype=np.float32)
    return Scene(
        "ramp", (_sheet(camera, ratio, np.repeat(np.tile(level, (2, 1))[..., None], 3, 2)),)
    )


def blank(camera: Camera, *, ratio: float = -0.3, seed: int = 0) -> Scene:
    """An even grey plane without texture. `seed` is accepted and not needed."""
    return Scene("blank", (_sheet(camera, ratio, np.full((2, 2, 3), 0.5, np.float32)),))


def periodic(camera: Camera, *, ratio: float = -0.3, period: float = 0.5, seed: int = 0) -> Scene:
    """A grid that repeats every `period * D` inside each microimage.

    `seed` is accepted and not needed.
    """
    height, width = _texels(camera, ratio)
    step = period / abs(ratio) * camera.pitch * width / (camera.width + 2 * _margin(camera, ratio))
    rows, columns = np.mgrid[0:height, 0:width] * (2 * np.pi / step)
    pattern = (0.5 + 0.22 * np.sin(columns) + 0.22 * np.sin(rows)).astype(np.float32)
    return Scene("periodic", (_sheet(camera, ratio, np.repeat(pattern[..., None], 3, 2)),))


def edge(camera: Camera, *, ratio: float = -0.3, angle: float = 5.0, seed: int = 0) -> Scene:
    """Slanted edges, `angle` degrees off the columns, every four pitches: what resolution is
    measured on.

    `seed` is accepted and not needed.
    """
    rows, columns, pitch = _grid(camera, ratio)
    turn = np.radians(angle)
    across = (columns * np.cos(turn) + rows * np.sin(turn)) / (4 * pitch)
    # One texel of each edge is grey, in proportion: the edge lies between texels.
    soft = np.clip(0.5 + (np.abs(across % 2 - 1) - 0.5) * 4 * pitch, 0, 1)
    return _grey_sheet(camera, ratio, 0.15 + 0.6 * soft)


def star(camera: Camera, *, ratio: float = -0.3, spokes: int = 36, seed: int = 0) -> Scene:
    """A Siemens star of so many pairs of spokes about the middle of the flat. `seed` is accepted
    and not needed.
    """
    rows, columns, _ = _grid(camera, ratio)
    turn = np.arctan2(rows - rows.mean(), columns - columns.mean())
    return _grey_sheet(camera, ratio, 0.45 + 0.3 * np.sin(spokes * turn))


def _grid(camera: Camera, ratio: float) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Rows and columns of the texels of a sheet, and the pitch [texel]."""
    height, width = _texels(camera, ratio)
    rows, columns = np.mgrid[:height, :width].astype(float)
    return rows, columns, camera.pitch * width / (camera.width + 2 * _margin(camera, ratio))


def _grey_sheet(camera: Camera, ratio: float, grey: NDArray[np.float64]) -> Scene:
    return Scene(
        "chart", (_sheet(camera, ratio, np.repeat(grey.astype(np.float32)[..., None], 3, 2)),)
    )


SCENES: dict[str, Callable[..., Scene]] = {
    "house": house,
    "plane": plane,
    "slope": slope,
    "clutter": clutter,
    "ramp": ramp,
    "blank": blank,
    "periodic": periodic,
    "edge": edge,
    "star": star,
}


def _margin(camera: Camera, ratio: float) -> float:
    """How far beyond the flat its outermost lenses see the plane at `s / D = ratio`, with reserve
    [px].
    """
    return camera.pitch * (1.0 + 0.75 / abs(ratio))


def _texels(camera: Camera, ratio: float) -> tuple[int, int]:
    """Height and width of a texture for a whole sheet."""
    margin = _margin(camera, ratio)
    size = np.array([camera.height, camera.width]) + 2 * margin
    height, width = (
        np.ceil(size * min(1 / _TEXEL, _LARGEST_TEXTURE / size.max())).astype(int).tolist()
    )
    return height, width


def _sheet(camera: Camera, ratio: float, texture: Texture) -> Patch:
    """A plane facing the camera that fills the field of view at `s / D = ratio`."""
    margin = _margin(camera, ratio)
    left = -margin
    top = -margin
    right = camera.width - 1 + margin
    bottom = camera.height - 1 + margin
    corner, across, down = camera.place(
        [(left, top), (right, top), (left, bottom)], camera.depth_at(ratio)
    )
    return Patch(corner, across - corner, down - corner, texture)


def _rich(shape: tuple[int, int], seed: int) -> Texture:
    """Detail at every scale with every lens-sized place textured."""
    rng = np.random.default_rng(seed)
    leaves = dead_leaves(shape, rng, smallest=3.0, largest=max(20.0, min(shape) / 12))
    grain = np.exp(0.3 * fractal_noise(shape, rng, coarsest=64, persistence=0.75))[..., None]
    return np.clip(leaves * grain, 0, 1).astype(np.float32)


def _rotation(rng: np.random.Generator) -> NDArray[np.float64]:
    """A rotation drawn evenly from all of them."""
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    return q * np.sign(np.diag(r))
