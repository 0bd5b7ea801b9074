"""What a scene is made of: textured, unlit patches and balls in object space [mm]."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Patch", "Scene", "Sphere", "box"]

Texture = NDArray[np.float32]


def _checked_texture(texture: ArrayLike) -> Texture:
    array = np.ascontiguousarray(texture, dtype=np.float32)
    if array.ndim != 3 or array.shape[2] not in (3, 4) or array.size == 0:
        raise ValueError(f"texture must have shape (h, w, 3) or (h, w, 4), got {array.shape}")
    if not np.isfinite(array).all() or array.min() < 0:
        raise ValueError("texture must hold finite radiances of at least 0")
    return array


def _checked_vector(value: ArrayLike, name: str) -> NDArray[np.float64]:
    vector = np.array(value, dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"{name} must be three finite numbers [mm], got {value!r}")
    return vector


@dataclass(frozen=True)
class Patch:
    """A flat parallelogram `corner + u * across + v * down` with `u, v` in 0..1.

    Parameters
    ----------
    corner, across, down : (3,) float64 [mm]
        Order `x, y, z`; `z` is the distance in front of the main lens.
    texture : (h, w, 3) or (h, w, 4) float32
        Linear radiance over `v, u`, 1 is white. A fourth channel cuts the patch away where it is
        below one half.

    Examples
    --------
    >>> import numpy as np
    >>> from data_synth import Patch
    >>> texture = np.full((4, 4, 3), 0.5, np.float32)
    >>> Patch((-100, -100, 1000), (200, 0, 0), (0, 200, 0), texture).bounds.tolist()
    [[-100.0, -100.0, 1000.0], [100.0, 100.0, 1000.0]]
    """

    corner: NDArray[np.float64]
    across: NDArray[np.float64]
    down: NDArray[np.float64]
    texture: Texture

    def __post_init__(self) -> None:
        for name in ("corner", "across", "down"):
            object.__setattr__(self, name, _checked_vector(getattr(self, name), name))
        object.__setattr__(self, "texture", _checked_texture(self.texture))
        if np.linalg.norm(np.cross(self.across, self.down)) < 1e-12:
            raise ValueError("across and down must span a parallelogram")
        if self.bounds[0, 2] <= 0:
            raise ValueError("a surface must lie in front of the main lens (z > 0)")

    @property
    def bounds(self) -> NDArray[np.float64]:
        """(2, 3) smallest and largest `x, y, z` [mm]."""
        corners = np.array(
            [self.corner + u * self.across + v * self.down for u in (0, 1) for v in (0, 1)]
        )
        return np.array([corners.min(0), corners.max(0)])


@dataclass(frozen=True)
class Sphere:
    """A ball, its texture wrapped once around in longitude and latitude.

    Parameters
    ----------
    centre : (3,) float64 [mm]
    radius : float [mm]
    texture : (h, w, 3) float32
        Linear radiance; the middle column faces the camera.

    Examples
    --------
    >>> import numpy as np
    >>> from data_synth import Sphere
    >>> Sphere((0, 0, 1000), 50, np.full((4, 4, 3), 0.5, np.float32)).radius
    50
    """

    centre: NDArray[np.float64]
    radius: float
    texture: Texture

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", _checked_vector(self.centre, "centre"))
        object.__setattr__(self, "texture", _checked_texture(self.texture))
        if not (np.isfinite(self.radius) and self.radius > 0):
            raise ValueError(f"radius must be a positive number of mm, got {self.radius!r}")
        if self.bounds[0, 2] <= 0:
            raise ValueError("a surface must lie in front of the main lens (z > 0)")

    @property
    def bounds(self) -> NDArray[np.float64]:
        """(2, 3) smallest and largest `x, y, z` [mm]."""
        return np.array([self.centre - self.radius, self.centre + self.radius])


@dataclass(frozen=True)
class Scene:
    """Surfaces before an evenly lit background that has no depth.

    Parameters
    ----------
    name : str
    surfaces : tuple of Patch and Sphere
        In any order; the nearest along each ray is seen.
    background : (float, float, float)
        Linear radiance where no surface is hit.

    Examples
    --------
    >>> import numpy as np
    >>> from data_synth import Patch, Scene
    >>> grey = np.full((4, 4, 3), 0.5, np.float32)
    >>> wall = Patch((-100, -100, 1000), (200, 0, 0), (0, 200, 0), grey)
    >>> Scene("wall", (wall,)).name
    'wall'
    """

    name: str
    surfaces: tuple[Patch | Sphere, ...]
    background: tuple[float, float, float] = field(default=(0.5, 0.5, 0.5))


def box(centre: ArrayLike, axes: ArrayLike, texture: ArrayLike) -> tuple[Patch, ...]:
    """The six sides of a box.

    Parameters
    ----------
    centre : (3,) array_like [mm]
    axes : (3, 3) array_like [mm]
        Rows are the half edges.
    texture : (h, w, 3) array_like
        The same on every side.

    Examples
    --------
    >>> import numpy as np
    >>> from data_synth import box
    >>> len(box((0, 0, 1000), 50 * np.eye(3), np.full((4, 4, 3), 0.5, np.float32)))
    6
    """
    middle = _checked_vector(centre, "centre")
    half = np.array(axes, dtype=np.float64)
    sides = []
    for k in range(3):
        u = half[(k + 1) % 3]
        v = half[(k + 2) % 3]
        w = half[k]
        sides += [
            Patch(middle + sign * w - u - v, 2 * u, 2 * v, _checked_texture(texture))
            for sign in (-1, 1)
        ]
    return tuple(sides)
