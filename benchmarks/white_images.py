"""White images of microlens arrays with known centres, for measuring a calibration against the
truth.

The renderer integrates discs over the area of each pixel and shares no formula with `lfcal`:
lattice, distortion, mechanical vignetting (cat-eye), natural vignetting, dust, hot pixels and noise
are drawn from their definitions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

__all__ = ["WhiteImage", "cut_cases", "random_cases", "standard_cases"]

_SUBPIXELS = 4
_SHAPES = {"hexagonal": ((1.0, 0.0), (0.5, np.sqrt(0.75))), "square": ((1.0, 0.0), (0.0, 1.0))}


@njit(cache=True, nogil=True)
def _pass_edge(inside, soft, normal):
    """Light at a distance `inside` an edge [px]: a ramp, or a normal distribution."""
    return (
        0.5 * (1 + math.erf(inside / soft * math.sqrt(0.5)))
        if normal
        else min(max(inside / soft + 0.5, 0.0), 1.0)
    )


@njit(cache=True, nogil=True, parallel=True)
def _draw(
    height,
    width,
    origin,
    basis,
    inverse,
    middle,
    reach,
    k1,
    radius,
    soft,
    gap,
    inner,
    outer,
    cut,
    ratio,
    light,
):
    # Edges of both discs that are blurred one by one are given as (deviation of the lens, of the
    # cut), else as (ramp,).
    normal = len(soft) > 1
    n = 1 if normal else _SUBPIXELS
    dark = radius + (5.0 if normal else 0.5) * soft[0]
    lenses = 4 if normal else 2
    for y in prange(height):
        for x in range(width):
            total = 0.0
            for sub in range(n * n):
                px = x + (sub % n + 0.5) / n - 0.5
                py = y + (sub // n + 0.5) / n - 0.5
                # Undistorted place, by two fixed-point steps: good to far below a lens.
                ux = px - middle[0]
                uy = py - middle[1]
                for _ in range(2 if k1 != 0 else 0):
                    stretch = 1 + k1 * (ux * ux + uy * uy) / (reach * reach)
                    ux = (px - middle[0]) / stretch
                    uy = (py - middle[1]) / stretch
                wx = ux + middle[0] - origin[0]
                wy = uy + middle[1] - origin[1]
                i0 = np.floor(wx * inverse[0, 0] + wy * inverse[1, 0]) - (lenses - 2) // 2
                j0 = np.floor(wx * inverse[0, 1] + wy * inverse[1, 1]) - (lenses - 2) // 2
                value = 0.0
                for corner in range(lenses * lenses):
                    i = i0 + corner % lenses
                    j = j0 + corner // lenses
                    mx = origin[0] + i * basis[0, 0] + j * basis[1, 0] - middle[0]
                    my = origin[1] + i * basis[0, 1] + j * basis[1, 1] - middle[1]
                    stretch = 1 + k1 * (mx * mx + my * my) / (reach * reach)
                    mx = mx * stretch
                    my = my * stretch
                    dx = px - middle[0] - mx
                    dy = py - middle[1] - my
                    if dx * dx + dy * dy >= dark * dark:
                        continue
                    r = np.sqrt(dx * dx + dy * dy)
                    disc = _pass_edge(radius - r, soft[0], normal)
                    if cut != 0 and disc > 0:
                        dx -= cut * radius * mx / reach
                        dy -= cut * radius * my / reach
                        far = np.sqrt(dx * dx + dy * dy)
                        disc *= _pass_edge(radius * ratio - far, soft[-1], normal)
                    disc *= 1 - inner * r * r / (radius * radius)
                    value = value + disc if normal else max(value, disc)
                total += value
            field = ((x - middle[0]) ** 2 + (y - middle[1]) ** 2) / (reach * reach)
            light[y, x] = (gap + (1 - gap) * total / (n * n)) * (1 - outer * field)


@dataclass(frozen=True)
class WhiteImage:
    """Description of a white image that `image` draws.

    Parameters
    ----------
    shape : {"hexagonal", "square"}
    pitch : float [px]
    degrees : float
        Angle of the first lattice vector, clockwise on the screen from +x; 90 is the other
        hexagonal orientation.
    decibels : float
        RMS of the light over the standard deviation of the noise, as 20 log10.
    bits : {8, 16}
    strength : float
        Cat-eye: displacement of the second disc in the corner over the radius of a disc, positive
        outwards.
    ratio : float
        Radius of the second disc over that of the first.
    k1 : float
        Radial displacement of centres in the corner over their distance from the middle.
    hot, dust : int
        Number of hot pixels and of dust specks.
    fill : float
        Disc diameter over the distance to the nearest neighbour.
    soft : float [px]
        Width of the ramp at the edge of a disc, before it is integrated over the pixel.
    edges : {"ramp", "product", "overlap"}
        "ramp": both discs have such ramps. "product": each disc is blurred by itself, pixels
        included, to a normal distribution of deviation `blur`, and what they let through
        multiplies. "overlap": the overlap of discs with ramps is blurred. In the last two
        neighbours add their light.
    blur : float [px]
        Standard deviation of the blur, for "product" and "overlap".
    cut_blur : float
        Blur of the edge of the second disc over that of the first, for "product".
    gap : float
        Light between discs over light in them.
    inner, outer : float
        Loss of light at the edge of each disc and in the corners of the field.
    size : (int, int) [px]
        Width and height.
    seed : int
        Of noise, hot pixels and dust, and of the place of the origin.
    """

    shape: str = "hexagonal"
    pitch: float = 14.3
    degrees: float = 0.0
    decibels: float = 40.0
    bits: int = 16
    strength: float = 0.0
    ratio: float = 1.0
    k1: float = 0.0
    hot: int = 0
    dust: int = 0
    fill: float = 0.94
    soft: float = 0.5
    edges: str = "ramp"
    blur: float = 0.6
    cut_blur: float = 1.0
    gap: float = 0.02
    inner: float = 0.15
    outer: float = 0.3
    size: tuple[int, int] = (2000, 1500)
    seed: int = 0

    @cached_property
    def basis(self) -> NDArray[np.float64]:
        """(2, 2) rows `a1, a2` [px] of the undistorted lattice."""
        cos = np.cos(np.radians(self.degrees))
        sin = np.sin(np.radians(self.degrees))
        return self.pitch * np.array(_SHAPES[self.shape]) @ np.array([[cos, sin], [-sin, cos]])

    @cached_property
    def origin(self) -> NDArray[np.float64]:
        """(2,) a centre near the middle of the image [px]."""
        return self.middle + np.random.default_rng(self.seed).uniform(-0.5, 0.5, 2) * self.pitch

    @property
    def middle(self) -> NDArray[np.float64]:
        """(2,) middle of the image [px], where distortion and vignetting are centred."""
        return (np.array(self.size) - 1) / 2

    @property
    def reach(self) -> float:
        """Half diagonal of the image [px]."""
        return float(np.hypot(*self.size) / 2)

    def centres(self, index: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 2) true centres [px] of the microimages with lattice indices (n, 2)."""
        straight = self.origin + index @ self.basis - self.middle
        return self.middle + straight * (
            1 + self.k1 * (straight**2).sum(1, keepdims=True) / self.reach**2
        )

    def index_of(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 2) indices of the true centres next to `points` (n, 2) [px]."""
        offset = points - self.middle
        straight = offset
        for _ in range(20):
            straight = offset / (1 + self.k1 * (straight**2).sum(1, keepdims=True) / self.reach**2)
        return np.rint((straight + self.middle - self.origin) @ np.linalg.inv(self.basis))

    def light(self, shift: tuple[float, float] = (0.0, 0.0)) -> NDArray[np.float64]:
        """(h, w) light without noise and defects, 1 in an unshaded disc, all centres moved by
        `shift` [px].
        """
        width, height = self.size
        drawn = np.empty((height, width))
        soft = np.array(
            [self.blur, self.blur * self.cut_blur] if self.edges == "product" else [self.soft]
        )
        distance = np.hypot(*(np.array([(1, 0), (0, 1), (1, -1)]) @ self.basis).T).min()
        _draw(
            height,
            width,
            self.origin + shift,
            self.basis,
            np.linalg.inv(self.basis),
            self.middle,
            self.reach,
            self.k1,
            self.fill * distance / 2,
            soft,
            self.gap,
            self.inner,
            self.outer,
            self.strength,
            self.ratio,
            drawn,
        )
        return (
            gaussian_filter(drawn, self.blur, mode="nearest") if self.edges == "overlap" else drawn
        )

    @cached_property
    def noise(self) -> float:
        """Standard deviation of the noise; the light in an unshaded disc is 1."""
        return float(
            np.sqrt((replace(self, size=(400, 300)).light() ** 2).mean())
            * 10 ** (-self.decibels / 20)
        )

    def _draw_specks(self, rng: np.random.Generator) -> NDArray[np.float64]:
        return rng.uniform((0, 0, 1), (*self.size, 6), (self.dust, 3))

    @property
    def specks(self) -> NDArray[np.float64]:
        """(n, 3) place x, y and radius of the specks of dust [px]."""
        return self._draw_specks(np.random.default_rng(self.seed + 1))

    def image(self, exposure: float = 1.0, kind: str = "") -> NDArray[Any]:
        """(h, w) the white image, with the light times `exposure`: uint8 or uint16, or of `kind`
        u1, u2 or f4.
        """
        rng = np.random.default_rng(self.seed + 1)
        light = self.light()
        height, width = light.shape
        y, x = np.mgrid[:height, :width]
        for cx, cy, r in self._draw_specks(rng):
            box = np.s_[
                max(0, int(cy - 5 * r)) : int(cy + 5 * r), max(0, int(cx - 5 * r)) : int(cx + 5 * r)
            ]
            light[box] *= 1 - 0.6 * np.exp(-((x[box] - cx) ** 2 + (y[box] - cy) ** 2) / (2 * r * r))
        light += self.noise * rng.standard_normal(light.shape)
        light *= 0.8 * exposure
        light[rng.integers(0, height, self.hot), rng.integers(0, width, self.hot)] = 1.0
        light = np.clip(light, 0, 1)
        if kind == "f4":
            return light.astype(np.float32)
        pixel = np.dtype(kind or f"u{self.bits // 8}")
        return np.rint(light * np.iinfo(pixel).max).astype(pixel)

    def bound(self) -> float:
        """Cramer-Rao bound: least RMS error [px] of a centre over the field, for six unknown
        lattice parameters.

        Fisher information summed over all pixels, from the change of the light with the place of
        its microimage.
        """
        step = 0.05
        height = self.size[1]
        width = self.size[0]
        y, x = np.mgrid[:height, :width]
        index = self.index_of(np.column_stack([x.ravel(), y.ravel()]).astype(float))
        slopes = [
            ((self.light(shift) - self.light((-shift[0], -shift[1]))) / (2 * step)).ravel()
            for shift in ((step, 0.0), (0.0, step))
        ]
        design = np.column_stack([np.ones(len(index)), index])
        rows = [design * slope[:, None] for slope in slopes]
        information = np.block([[a.T @ b for b in rows] for a in rows]) / self.noise**2
        covariance = np.linalg.inv(information)
        lenses = np.unique(index, axis=0)
        lenses = np.column_stack([np.ones(len(lenses)), lenses])
        moments = lenses.T @ lenses / len(lenses)
        return float(
            np.sqrt((covariance[:3, :3] * moments).sum() + (covariance[3:, 3:] * moments).sum())
        )


def standard_cases() -> dict[str, WhiteImage]:
    """Whole, cut, distorted and dirty white images over the range of pitches, angles, noise and
    bits, by name.
    """
    lattices = [
        ("hexagonal", 9.97, 0.0),
        ("hexagonal", 14.3, 90.7),
        ("square", 12.1, 3.0),
        ("hexagonal", 23.2, 11.0),
        ("square", 35.4, 0.0),
        ("hexagonal", 70.4, 90.0),
    ]
    cases: dict[str, WhiteImage] = {}
    for number, (shape, pitch, degrees) in enumerate(lattices):
        plain = WhiteImage(shape, pitch, degrees, seed=number)
        name = f"{shape[:3]} {pitch:g} {degrees:g}"
        cases[f"{name} 40 dB"] = plain
        cases[f"{name} 26 dB 8 bit"] = replace(plain, decibels=26, bits=8)
        cases[f"{name} 18 dB"] = replace(plain, decibels=18)
        cases[f"{name} cat-eye 26 dB"] = replace(plain, decibels=26, strength=0.3)
        cases[f"{name} cat-eye 18 dB 8 bit"] = replace(
            plain, decibels=18, bits=8, strength=-0.3, ratio=1.05
        )
        cases[f"{name} distorted 26 dB"] = replace(plain, decibels=26, k1=(-1) ** number * 0.005)
        cases[f"{name} dirty 26 dB"] = replace(plain, decibels=26, hot=300, dust=40)
    return cases


def random_cases(count: int, seed: int) -> dict[str, WhiteImage]:
    """White images drawn over the range of the standard ones, edges, gaps and shading of discs
    included, by name.
    """
    rng = np.random.default_rng(seed)
    cases: dict[str, WhiteImage] = {}
    for number in range(count):
        shape = str(rng.choice(["hexagonal", "square"]))
        kind = str(rng.choice(["", "cat-eye", "distorted", "dirty"]))
        pitch = float(np.exp(rng.uniform(np.log(9.97), np.log(70.4))))
        degrees = float(rng.uniform(0, 11))
        degrees += 90 * float(rng.integers(2)) * (shape == "hexagonal")
        decibels = float(rng.choice([40, 26, 18]))
        bits = int(rng.choice([8, 16]))
        sign = float(rng.choice([-1, 1]))
        cases[
            f"{number} {shape[:3]} {pitch:.2f} {degrees:.1f} {kind} {decibels:g} dB {bits} bit"
        ] = WhiteImage(
            shape,
            pitch,
            degrees,
            decibels,
            bits,
            strength=sign * float(rng.uniform(0.15, 0.35)) if kind == "cat-eye" else 0.0,
            ratio=float(rng.uniform(1, 1.1)),
            k1=sign * float(rng.uniform(0.002, 0.01)) if kind == "distorted" else 0.0,
            hot=300 if kind == "dirty" else 0,
            dust=40 if kind == "dirty" else 0,
            fill=float(rng.uniform(0.8, 0.98)),
            soft=float(rng.uniform(0.3, 1.2)),
            gap=float(rng.uniform(0, 0.1)),
            inner=float(rng.uniform(0.05, 0.3)),
            outer=float(rng.uniform(0.1, 0.5)),
            seed=1000 * seed + number,
        )
    return cases


def cut_cases(count: int, seed: int) -> dict[str, WhiteImage]:
    """Cut white images whose edges are blurred in other ways than those of the standard ones, some
    distorted, by name.

    Half of them have two discs that are blurred one by one and multiply, half a blurred overlap of
    two discs.
    """
    rng = np.random.default_rng(seed)
    cases: dict[str, WhiteImage] = {}
    for number in range(count):
        shape = str(rng.choice(["hexagonal", "square"]))
        edges = ("product", "overlap")[number % 2]
        pitch = float(np.exp(rng.uniform(np.log(10), np.log(45))))
        degrees = float(rng.uniform(0, 11))
        degrees += 90 * float(rng.integers(2)) * (shape == "hexagonal")
        decibels = float(rng.choice([40, 30, 26, 18]))
        bits = int(rng.choice([8, 16]))
        blur = float(rng.choice([0.6, 0.6, rng.uniform(0.3, 0.11 * pitch)]))
        cut_blur = float(rng.choice([1.0, rng.uniform(0.8, 1.5)])) if edges == "product" else 1.0
        strength = float(rng.choice([-1, -1, 1]) * rng.uniform(0.2, 0.5))
        k1 = float(rng.choice([0, rng.uniform(-4e-3, 4e-3)]))
        name = f"{number} {edges} {shape[:3]} {pitch:.2f} {degrees:.1f} {decibels:g} dB {bits} bit"
        cases[f"{name} blur {blur:.2f} x {cut_blur:.2f} k1 {k1:.4f}"] = WhiteImage(
            shape,
            pitch,
            degrees,
            decibels,
            bits,
            strength=strength,
            ratio=float(rng.uniform(1.03, 1.1)),
            k1=k1,
            fill=float(rng.uniform(0.85, 0.95)),
            edges=edges,
            blur=blur,
            cut_blur=cut_blur,
            inner=float(rng.uniform(0.0, 0.1)),
            outer=float(rng.uniform(0.1, 0.4)),
            seed=1000 * seed + number,
        )
    return cases
