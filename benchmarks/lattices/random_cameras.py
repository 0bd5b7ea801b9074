"""Flats of random cameras of all kinds, drawn from the rendering formula alone (no ray tracing),
with true centres.

A pixel at `delta` from the centre `c` of its lens shows the scene at `X = c - delta * D / s`
(docs/geometry.md). Each flat takes milliseconds, so that hundreds of cameras can be drawn.
Apertures are discs, squares or spots; gaps are black, grey, bright, or absent; scenes are textured
planes, one before another, boards with large tiles, letters and dim objects on black ground, in
focus or not; arrays have one, two or three lens types.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["CONTENTS", "CameraFlat", "draw_camera"]

CONTENTS = (
    "white",
    "white",
    "spots",
    "planes",
    "planes",
    "planes",
    "unfocused",
    "board",
    "letters",
    "objects",
)
_TEXTURE = 1024
_SHAPES = {
    "hexagonal": ((1.0, 0.0), (0.5, 0.75**0.5)),
    "hexagonal, upright": ((0.0, 1.0), (-(0.75**0.5), 0.5)),
    "square": ((1.0, 0.0), (0.0, 1.0)),
    "rectangular": ((1.0, 0.0), (0.0, 1.12)),
    "sheared": ((1.0, 0.0), (0.2, 1.0)),
}


@dataclass(frozen=True)
class CameraFlat:
    """A flat of a random camera.

    Parameters
    ----------
    name : str
        What was drawn.
    image : (h, w) or (h, w, 3) uint8 or uint16
    centres : (n, 2) float64 [px]
        True centres of the lenses that lie wholly on the flat.
    pitch : float [px]
    white : bool
        Whether it is a white image.
    """

    name: str
    image: NDArray[Any]
    centres: NDArray[np.float64]
    pitch: float
    white: bool


def draw_camera(seed: int) -> CameraFlat:
    """The flat of the random camera of a seed; the kinds of content come in turn."""
    rng = np.random.default_rng([seed, 2208])
    content = CONTENTS[seed % len(CONTENTS)]
    shape = str(rng.choice(list(_SHAPES), p=[0.3, 0.2, 0.3, 0.1, 0.1]))
    pitch = float(np.exp(rng.uniform(*np.log((10.0, 70.0)))))
    across = rng.uniform(18, 40)
    width = int(np.clip(pitch * across, 420, 1200))
    height = int(width * rng.uniform(0.6, 1.0))
    straight = rng.random() < 0.5
    turned = float(rng.normal(0, 0.3) if straight else rng.uniform(-30, 30))
    basis = _basis(shape, pitch, turned)
    middle = (np.array([width, height]) - 1) / 2
    origin = middle + rng.uniform(-0.5, 0.5, 2) @ basis
    places = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).astype(np.float64)
    index, delta = _nearest_lens(places, origin, basis)
    aperture = _draw_aperture(rng, shape, content, pitch, basis)
    kinds = _lens_kinds(rng, shape, index)
    inside = aperture.transmission(delta, kinds)
    if content not in ("white", "spots") and rng.random() < 0.35:
        # Flattened by its white image, or lenses that light each other's gaps.
        least = float(rng.uniform(0.5, 0.9))
        inside = least + (1 - least) * inside
    gap = _gap_tone(rng, content)
    light = _light_of_lenses(rng, content, index, places, middle)
    shown, described = _draw_content(rng, content, places - delta, delta, pitch)
    picture = inside * shown * light + (1 - inside) * gap.tone
    image, saved = _expose(rng, picture)
    name = (
        f"{content}{described}, {shape}, {pitch:.1f} px, {turned:+.1f} degrees, {aperture.name}, "
        f"{len(np.unique(kinds))} types, gaps {gap.name}, {saved}"
    )
    centres = _whole_lenses(origin, basis, (width, height), pitch)
    return CameraFlat(name, image, centres, pitch, content in ("white", "spots"))


def _basis(shape: str, pitch: float, degrees: float) -> NDArray[np.float64]:
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return pitch * np.array(_SHAPES[shape]) @ turn


def _nearest_lens(
    places: NDArray[np.float64], origin: NDArray[np.float64], basis: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Index (h, w, 2) of the lens nearest to each place (h, w, 2), and the offset (h, w, 2) from it
    [px].
    """
    first = np.rint((places - origin) @ np.linalg.inv(basis))
    best = first
    offset = places - origin - first @ basis
    for step in [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]:
        other = first + step
        moved = places - origin - other @ basis
        nearer = (moved**2).sum(-1) < (offset**2).sum(-1) - 1e-9
        best = np.where(nearer[..., None], other, best)
        offset = np.where(nearer[..., None], moved, offset)
    return best.astype(np.int64), offset


@dataclass(frozen=True)
class _Aperture:
    name: str
    radius: NDArray[
        np.float64
    ]  # [px] of each lens type: of the disc, or half the side of the square
    blur: NDArray[np.float64]  # [px] width of the ramp at its edge, of each lens type
    axes: Any  # (2, 2) directions of the sides of a square; None of a disc

    def transmission(
        self, delta: NDArray[np.float64], kinds: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        """Share (h, w) of the light that passes at `delta` (h, w, 2) from the centre of a lens of
        each kind.
        """
        round_one = self.axes is None
        far = (
            np.hypot(delta[..., 0], delta[..., 1])
            if round_one
            else np.abs(delta @ self.axes.T).max(-1)
        )
        return np.clip((self.radius[kinds] - far) / self.blur[kinds] + 0.5, 0, 1)


def _draw_aperture(
    rng: np.random.Generator, shape: str, content: str, pitch: float, basis: NDArray[np.float64]
) -> _Aperture:
    nearest = float(np.hypot(*basis.T).min())
    blur: Any = rng.uniform(0.6, 2.0) * np.ones(3)
    if content == "spots":
        radius = rng.uniform(1.2, max(1.5, 0.12 * pitch)) * np.ones(3)
        return _Aperture("spots", radius, np.minimum(blur, radius), None)
    if shape in ("square", "rectangular") and rng.random() < 0.6:
        side = float(rng.choice([1.1, rng.uniform(0.8, 0.97)]))
        if content == "white":
            # A white image of squares without gaps shows nothing.
            side = min(side, 0.95)
        sides = basis / np.hypot(*basis.T)[:, None]
        return _Aperture(
            "squares without gaps" if side > 1 else "squares",
            0.5 * side * nearest * np.ones(3),
            blur,
            sides,
        )
    fill = rng.uniform(0.78, 1.0) * np.array([1.0, *rng.uniform(0.88, 1.0, 2)])
    if content not in ("white", "spots"):
        softness = float(rng.choice([1.0, 1.0, max(1.0, 0.05 * pitch)]))
        blur = np.asarray(blur) * softness
    return _Aperture(
        "discs",
        np.asarray(0.5 * fill * nearest),
        blur * np.array([1.0, *rng.uniform(1, 2, 2)]),
        None,
    )


def _lens_kinds(
    rng: np.random.Generator, shape: str, index: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Lens type (h, w) of the lens that each pixel belongs to."""
    drawn = rng.random()
    if shape.startswith("hexagonal") and drawn < 0.3:
        return (index[..., 0] - index[..., 1]) % 3
    if shape == "square" and drawn < 0.1:
        return (index[..., 0] - index[..., 1]) % 2
    return np.zeros(index.shape[:2], np.int64)


@dataclass(frozen=True)
class _Gap:
    name: str
    tone: float


def _gap_tone(rng: np.random.Generator, content: str) -> _Gap:
    drawn = rng.random()
    if content not in ("white", "spots") and drawn < 0.12:
        return _Gap("bright", float(rng.uniform(0.7, 1.2)))
    if content != "spots" and drawn < 0.45:
        return _Gap("grey", float(rng.uniform(0.05, 0.25)))
    return _Gap("black", 0.0)


def _light_of_lenses(
    rng: np.random.Generator,
    content: str,
    index: NDArray[np.int64],
    places: NDArray[np.float64],
    middle: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Light (h, w) that falls off to the corners, differs a little from lens to lens, and has dust
    on a few.
    """
    far = ((places - middle) ** 2).sum(-1) / (middle**2).sum()
    each = 1 + rng.uniform(0, 0.03) * rng.standard_normal((64, 64))
    if rng.random() < 0.2:
        each[rng.random((64, 64)) < 0.01] *= 0.5
    return (1 - rng.uniform(0, 0.6) * far) * each[index[..., 1] % 64, index[..., 0] % 64]


def _draw_content(
    rng: np.random.Generator,
    content: str,
    centre: NDArray[np.float64],
    delta: NDArray[np.float64],
    pitch: float,
) -> tuple[NDArray[np.float64], str]:
    """What pixels (h, w) at `delta` from lens centres (h, w, 2) show, and its description."""
    if content in ("white", "spots"):
        return 1 - rng.uniform(0, 0.1) * (delta**2).sum(-1) / (pitch / 2) ** 2, ""
    ratio = float(rng.uniform(0.15, 0.55) * rng.choice([-1, 1]))
    if content == "unfocused" or (content == "objects" and rng.random() < 0.5):
        ratio = float(rng.uniform(0.02, 0.1) * rng.choice([-1, 1]))
    scale = pitch * float(rng.uniform(0.02, 0.08)) / abs(ratio) ** 0.5
    texture = _texture(rng, content)
    shown = _sample(texture, centre - delta / ratio, scale)
    if content == "planes" and rng.random() < 0.6:
        front = float(np.clip(ratio * rng.uniform(0.5, 1.9), -0.6, 0.6))
        mask = _texture(rng, "leaves")
        place = centre - delta / front
        covered = _sample(mask, place, 4 * scale) > 0.5
        shown = np.where(covered, _sample(_texture(rng, "planes"), place, scale), shown)
    return shown, f" at s = {ratio:.2f} D"


def _sample(
    texture: NDArray[np.float32], place: NDArray[np.float64], scale: float
) -> NDArray[np.float64]:
    """A periodic texture, one of whose pixels is `scale` flat pixels wide, at scene coordinates (h,
    w, 2).
    """
    at = (place / scale % _TEXTURE).astype(np.float32)
    padded = cv2.copyMakeBorder(texture, 1, 2, 1, 2, cv2.BORDER_WRAP)
    x = np.ascontiguousarray(at[..., 0] + 1)
    y = np.ascontiguousarray(at[..., 1] + 1)
    return cv2.remap(padded, x, y, cv2.INTER_LINEAR).astype(np.float64)


def _texture(rng: np.random.Generator, content: str) -> Any:
    """A periodic picture (1024, 1024) of values 0 to 1."""
    size = _TEXTURE
    if content == "board":
        side = int(rng.choice([64, 128, 256]))
        tile = np.indices((size, size)) // side
        board = (tile.sum(0) % 2).astype(np.float32)
        return cv2.GaussianBlur(0.05 + 0.9 * board, (0, 0), 2.0)
    picture = np.full((size, size), 0.0 if content == "objects" else 0.5, np.float32)
    ground = float(rng.choice([0.01, 0.05, 0.15]))
    if content == "letters":
        drawn = np.zeros((size, size), np.uint8)
        for _ in range(60):
            place = (int(rng.integers(0, size)), int(rng.integers(0, size)))
            letter = chr(int(rng.integers(65, 91)))
            cv2.putText(drawn, letter, place, 0, float(rng.uniform(1, 4)), 255.0, 6, cv2.LINE_AA)
        return cv2.GaussianBlur(ground + 0.85 * (drawn / 255).astype(np.float32), (0, 0), 1.5)
    if content == "objects":
        for _ in range(70):
            place = (int(rng.integers(0, size)), int(rng.integers(0, size)))
            cv2.circle(
                picture,
                place,
                int(rng.integers(4, 60)),
                float(rng.uniform(0.2, 1)),
                -1,
                cv2.LINE_AA,
            )
        return cv2.GaussianBlur(ground + 0.85 * picture, (0, 0), 3.0)
    for _ in range(900):
        place = (int(rng.integers(0, size)), int(rng.integers(0, size)))
        radius = int(min(3 * rng.random() ** -0.8, 150))
        cv2.circle(picture, place, radius, float(rng.uniform(0.05, 1)), -1, cv2.LINE_AA)
    if content == "leaves":
        return picture
    fine = cv2.GaussianBlur(rng.standard_normal((size, size)).astype(np.float32), (0, 0), 1.5)
    return np.clip(cv2.GaussianBlur(picture, (0, 0), 1.0) + 0.5 * fine, 0, 1)


def _expose(rng: np.random.Generator, picture: NDArray[np.float64]) -> tuple[NDArray[Any], str]:
    """The picture as a camera saves it: noise, tone curve, bits, compression; and how."""
    exposure = float(rng.uniform(0.3, 0.95))
    electrons = float(np.exp(rng.uniform(*np.log((150.0, 20000.0)))))
    light = exposure * np.maximum(picture, 0)
    light = light + rng.standard_normal(light.shape) * np.sqrt(
        light / electrons + (3 / electrons) ** 2
    )
    light = np.clip(light, 0, 1)
    drawn = rng.random()
    if drawn < 0.3:
        return np.rint(65535 * light).astype(np.uint16), "16 bits"
    if drawn < 0.6:
        return np.rint(255 * light).astype(np.uint8), "8 bits"
    curved = np.rint(255 * light ** (1 / 2.2)).astype(np.uint8)
    if drawn < 0.8:
        return curved, "gamma"
    coded = cv2.imencode(".jpg", curved, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(70, 95))])[1]
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_UNCHANGED)), "JPEG"


def _whole_lenses(
    origin: NDArray[np.float64], basis: NDArray[np.float64], size: tuple[int, int], pitch: float
) -> NDArray[np.float64]:
    span = np.arange(-200, 201)
    index = np.stack(np.meshgrid(span, span), -1).reshape(-1, 2)
    centres = origin + index @ basis
    most = np.array(size) - 1 - pitch / 2
    whole = (centres >= pitch / 2).all(1) & (centres <= most).all(1)
    return centres[whole]
