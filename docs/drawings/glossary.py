"""Draw the figures of `docs/glossary.md` as SVG: `python docs/drawings/glossary.py`.

Microimages are drawn by the formula of docs/geometry.md: lens `c` shows scene position `X` at `p =
c - (X - c) s / D`.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path

FOLDER = Path(__file__).parent
Point = tuple[float, float]

_RED, _BLUE, _ORANGE, _GRAY = "#c0392b", "#2171b5", "#e67e22", "#777"
_LENS = "#9ecae1"
# A house, a tree and the sun, in a box of 100 x 100 about the origin.
_SCENE = (
    '<rect x="-400" y="-400" width="800" height="800" fill="#dceaf5"/>'
    '<rect x="-400" y="40" width="800" height="360" fill="#a9c991"/>'
    '<rect x="-34" y="-8" width="46" height="50" fill="#d08770"/>'
    '<path d="M-40,-8 L-11,-36 L18,-8 Z" fill="#8f4f3c"/>'
    '<rect x="-24" y="8" width="11" height="34" fill="#5b3a29"/>'
    '<rect x="-6" y="4" width="12" height="12" fill="#fff3c4"/>'
    '<rect x="32" y="10" width="6" height="32" fill="#7a5a3a"/><circle cx="35" cy="0" r="17" '
    'fill="#4d8a4a"/>'
    '<circle cx="40" cy="-40" r="8" fill="#f2c14e"/>'
)


def _text(
    x: float, y: float, words: str, anchor: str = "middle", size: int = 15, colour: str = "#222"
) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" font-size="{size}" fill="{colour}">'
        f"{words}</text>"
    )


def _arrow(start: Point, end: Point, colour: str, both: bool = False, width: float = 2) -> str:
    """A line with a head at its end, or at both ends."""
    tail = f' marker-start="url(#head{colour[1:]})"' if both else ""
    return (
        f'<line x1="{start[0]:.1f}" y1="{start[1]:.1f}" x2="{end[0]:.1f}" y2="{end[1]:.1f}" '
        f'stroke="{colour}" '
        f'stroke-width="{width}" marker-end="url(#head{colour[1:]})"{tail}/>'
    )


def _line(*points: Point, colour: str = _ORANGE, width: float = 1.5, dash: str = "") -> str:
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    dashed = f' stroke-dasharray="{dash}"' if dash else ""
    return (
        f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="{width}"{dashed}/>'
    )


def _hexagonal(middle: Point, pitch: float, rows: int, columns: int) -> list[Point]:
    """Centres of a hexagonal array, row by row."""
    return [
        (
            middle[0] + (column - (columns - 1) / 2 + (0.5 if row % 2 else 0) - 0.25) * pitch,
            middle[1] + (row - (rows - 1) / 2) * pitch * 0.75**0.5,
        )
        for row, column in product(range(rows), range(columns))
    ]


def _microimage(
    centre: Point, radius: float, ratio: float, middle: Point, size: float, name: str
) -> str:
    """The piece of the scene, `size` times as large about `middle`, that a lens shows with `s =
    ratio D`.
    """
    x, y = (c * (1 + ratio) - ratio * m for c, m in zip(centre, middle, strict=True))
    return (
        f'<clipPath id="{name}"><circle cx="{centre[0]:.1f}" cy="{centre[1]:.1f}" '
        f'r="{radius:.1f}"/></clipPath>'
        f'<g clip-path="url(#{name})"><g transform="translate({x:.1f} {y:.1f}) '
        f'scale({-ratio * size:.4f})">'
        f"{_SCENE}</g></g>"
    )


def _array(
    middle: Point, pitch: float, ratio: float, size: float, rows: int, columns: int, name: str
) -> str:
    return "".join(
        _microimage(centre, 0.48 * pitch, ratio, middle, size, f"{name}{number}")
        for number, centre in enumerate(_hexagonal(middle, pitch, rows, columns))
    )


def _write(name: str, width: int, height: int, title: str, *parts: str) -> None:
    heads = "".join(
        f'<marker id="head{colour[1:]}" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" '
        f'markerHeight="7" '
        f'orient="auto-start-reverse"><path d="M0,0 L10,5 L0,10 Z" fill="{colour}"/></marker>'
        for colour in (_RED, _BLUE, _ORANGE, "#222222")
    )
    (FOLDER / f"{name}.svg").write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
        f'height="{height}" '
        f'font-family="Helvetica, Arial, sans-serif"><title>{title}</title><defs>{heads}</defs>'
        f'<rect width="{width}" height="{height}" rx="8" fill="#fff"/>{"".join(parts)}</svg>\n',
        encoding="utf-8",
    )


def flat() -> None:
    """Flat, microimage, pitch and radius."""
    middle = (235.0, 180.0)
    pitch = 58.0
    centres = _hexagonal(middle, pitch, 7, 8)
    one = centres[26]
    two = centres[27]
    radius = 0.48 * pitch
    _write(
        "flat",
        720,
        360,
        "A flat with its microimages",
        '<clipPath id="sensor"><rect x="20" y="20" width="430" height="320"/></clipPath><g '
        'clip-path="url(#sensor)">'
        '<rect x="20" y="20" width="430" height="320" fill="#16181c"/>',
        _array(middle, pitch, 0.36, 3.4, 7, 8, "f"),
        "</g>",
        f'<circle cx="{one[0]}" cy="{one[1]}" r="{radius}" fill="none" stroke="{_RED}" '
        f'stroke-width="3"/>',
        f'<circle cx="{two[0]}" cy="{two[1]}" r="{radius}" fill="none" stroke="{_RED}" '
        f'stroke-width="3"/>',
        _arrow((one[0], one[1]), (two[0], two[1]), "#222222", both=True, width=3),
        _line((two[0] + 8, two[1] - 4), (480, 130), colour="#222"),
        _line((one[0] + 12, one[1] + radius - 5), (480, 236), colour=_RED),
        _text(490, 60, "flat", "start", 20),
        _text(490, 80, "the raw image of the sensor", "start", 14, "#444"),
        _text(490, 135, "pitch D", "start", 20),
        _text(490, 155, "from centre to centre [px]", "start", 14, "#444"),
        _text(490, 240, "microimage", "start", 20, _RED),
        _text(490, 260, "the picture of one microlens", "start", 14, "#444"),
        _text(490, 278, "on the sensor", "start", 14, "#444"),
    )


def mode() -> None:
    """Telescopic and binocular microimages, and the scene that both show."""
    parts = [
        f'<clipPath id="whole"><rect x="20" y="55" width="200" height="220"/></clipPath><g '
        f'clip-path="url(#whole)">'
        f'<g transform="translate(120 165) scale(2.1)">{_SCENE}</g></g>',
        _text(120, 38, "the scene", size=18),
    ]
    for left, ratio, name, words, colour in (
        (250, 0.36, "telescopic, s &gt; 0", "upside down", "#b35900"),
        (480, -0.36, "binocular, s &lt; 0", "upright", _BLUE),
    ):
        middle = (left + 100.0, 165.0)
        clip = f"m{left}"
        parts += [
            f'<clipPath id="{clip}"><rect x="{left}" y="55" width="200" height="220"/></clipPath>'
            f'<g clip-path="url(#{clip})">'
            f'<rect x="{left}" y="55" width="200" height="220" fill="#16181c"/>',
            _array(middle, 64, ratio, 2.6, 5, 5, clip),
            "</g>",
            _text(middle[0], 38, name, size=18, colour=colour),
            _text(middle[0], 298, f"every microimage is {words}", size=14),
        ]
    _write("mode", 720, 315, "Telescopic and binocular microimages of one scene", *parts)


def patch_size() -> None:
    """The same detail in two neighbouring microimages, shifted by `s`."""
    pitch = 210.0
    ratio = -0.3
    size = 4.6
    left = (130.0, 165.0)
    right = (130.0 + pitch, 165.0)
    middle = (235.0, 165.0)
    # The tip of the roof, as each of the two lenses shows it.
    tip = middle[0] - 11 * size, middle[1] - 36 * size
    shown = [
        tuple(c * (1 + ratio) - ratio * x for c, x in zip(lens, tip, strict=True))
        for lens in (left, right)
    ]
    other = shown[0][0] + pitch, shown[0][1]
    radius = 0.48 * pitch
    parts = [
        _microimage(lens, radius, ratio, middle, size, f"p{number}")
        for number, lens in enumerate((left, right))
    ]
    parts += [
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}" fill="none" stroke="#222"/>'
        for x, y in (left, right)
    ]
    parts += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="6" fill="{_RED}"/>' for x, y in shown]
    parts += [
        f'<circle cx="{other[0]:.1f}" cy="{other[1]:.1f}" r="6" fill="none" stroke="{_RED}" '
        f'stroke-width="2"/>',
        _line(other, (other[0], 36), dash="4 3", colour=_RED),
        _line(shown[1], (shown[1][0], 36), dash="4 3", colour=_RED),
        _arrow((other[0], 42), (shown[1][0], 42), _RED, width=3),
        _text((other[0] + shown[1][0]) / 2, 26, "s", size=20, colour=_RED),
        _arrow((left[0], 290), (right[0], 290), "#222222", both=True),
        _text(middle[0], 312, "D", size=18),
        _text(470, 90, "patch size s", "start", 20, _RED),
        _text(470, 114, "how far the same detail moves", "start", 14, "#444"),
        _text(470, 132, "from a microimage to the next", "start", 14, "#444"),
        _text(470, 150, "(ring: where it would be if", "start", 14, "#444"),
        _text(470, 168, "it did not move)", "start", 14, "#444"),
        _text(470, 206, "Near and far detail move", "start", 14, "#444"),
        _text(470, 224, "differently: s is the depth.", "start", 14, "#444"),
    ]
    _write("patch_size", 720, 330, "The same detail in two neighbouring microimages", *parts)


def magnification() -> None:
    """How many lenses in a row show the same detail."""
    pitch = 84.0
    parts = []
    for top, ratio, words in (
        (95.0, -1 / 3, "|s| = D / 3, M = 3: large patches, few lenses"),
        (255.0, -0.2, "|s| = D / 5, M = 5: small patches, many lenses"),
    ):
        middle = (350.0, top)
        tip = middle[0], middle[1]
        for number in range(-3, 4):
            lens = (middle[0] + number * pitch, top)
            parts.append(
                _microimage(lens, 0.48 * pitch, ratio, middle, 4.0, f"g{int(top)}_{number}")
            )
            at = tuple(c * (1 + ratio) - ratio * x for c, x in zip(lens, tip, strict=True))
            seen = abs(at[0] - lens[0]) < 0.47 * pitch
            parts.append(
                f'<circle cx="{lens[0]:.1f}" cy="{top}" r="{0.48 * pitch:.1f}" fill="none" '
                f'stroke="{_RED if seen else "#bbb"}" stroke-width="{3 if seen else 1}"/>'
            )
            if seen:
                parts.append(f'<circle cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="6" fill="{_RED}"/>')
        parts.append(_text(350, top + 70, words, size=16))
    parts.append(_text(350, 32, "Lenses that show the same detail (red dot)", size=18, colour=_RED))
    _write(
        "magnification",
        720,
        345,
        "Magnification M: how many lenses in a row show the same detail",
        *parts,
    )


def camera() -> None:
    """Where the image of the main lens lies in each mode, seen from the side."""
    parts = []
    for top, telescopic, words, colour in (
        (120.0, True, "telescopic: the image lies in front of the microlenses", "#b35900"),
        (340.0, False, "binocular: it would lie behind them", _BLUE),
    ):
        image = (470.0 if telescopic else 640.0, top + 14)
        parts += [
            _text(350, top - 82, words, size=17, colour=colour),
            f'<ellipse cx="170" cy="{top}" rx="13" ry="68" fill="{_LENS}" stroke="{_BLUE}"/>',
            _line((560, top - 68), (560, top + 68), colour="#ccc"),
            _line((612, top - 68), (612, top + 68), colour="#222", width=4),
            _line((image[0], top - 56), (image[0], top + 56), colour=colour, dash="6 4", width=2),
        ]
        parts += [
            f'<ellipse cx="560" cy="{top + y}" rx="5" ry="15" fill="{_LENS}" stroke="{_BLUE}"/>'
            for y in (-48, -16, 16, 48)
        ]
        parts.append(f'<circle cx="40" cy="{top - 10}" r="5" fill="{_RED}"/>')
        for edge in (-56, 0, 56):
            slope = (image[1] - (top + edge)) / (image[0] - 170)
            end = (560.0, top + edge + slope * 390)
            parts.append(
                _line(
                    (40, top - 10),
                    (170, top + edge),
                    (min(image[0], 560.0), top + edge + slope * (min(image[0], 560.0) - 170)),
                    end,
                )
            )
            lens = top + min((-48, -16, 16, 48), key=lambda y, at=end[1] - top: abs(at - y))
            chief = (image[1] - lens) / (image[0] - 560)
            parts.append(_line(end, (612, lens + chief * 52), width=1.5))
            if not telescopic:
                parts.append(_line(end, image, colour=_GRAY, dash="3 3", width=1))
        parts.append(f'<circle cx="{image[0]}" cy="{image[1]}" r="5" fill="{_RED}"/>')
    parts += [
        _text(40, 212, "scene", size=14),
        _text(170, 212, "main lens", size=14),
        _text(548, 212, "microlenses", "end", size=14),
        _text(622, 212, "sensor", "start", size=14),
    ]
    _write(
        "camera",
        720,
        430,
        "The image of the main lens before and behind the microlenses, from the side",
        *parts,
    )


if __name__ == "__main__":
    for draw in (flat, mode, patch_size, magnification, camera):
        draw()
