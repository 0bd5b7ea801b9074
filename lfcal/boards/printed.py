"""Boards to print, as SVG or PDF in true size, with a bar to measure the print by."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..runtime.output_file import atomic_write, check_output
from .board import Board

__all__ = ["write_board"]

_POINT = 72 / 25.4  # per mm, the unit of PDF
_KAPPA = 0.5522847498  # of a quarter circle as a Bezier curve


@dataclass(frozen=True)
class _Drawing:
    """Black shapes on a white page; all in mm, x right, y down."""

    width: float
    height: float
    rectangles: tuple[tuple[float, float, float, float], ...]  # x, y, width, height
    circles: tuple[tuple[float, float, float], ...]  # x, y, radius
    texts: tuple[tuple[float, float, str], ...]


def write_board(path: str | os.PathLike[str], board: Board) -> None:
    """Write a board in true size, `.svg` or `.pdf`; the file appears whole or not at all.

    Print it at 100 % on flat, matt material and measure the bar: if it is not 100 mm long, scale `square` by what it
    is.
    """
    check_output(path, {".svg", ".pdf"})
    drawing = _draw(board)
    data = _svg(drawing) if Path(path).suffix.lower() == ".svg" else _pdf(drawing)
    with atomic_write(path) as temporary:
        Path(temporary).write_bytes(data)


def _draw(board: Board) -> _Drawing:
    margin, side = board.square, board.square
    points = board.points[:, :2]
    low, high = points.min(0) - side, points.max(0) + side
    shift = margin - low
    width, height = high - low + 2 * margin
    rectangles: list[tuple[float, float, float, float]] = []
    circles: list[tuple[float, float, float]] = []
    if board.pattern == "circles":
        circles = [(float(x), float(y), float(board.marker or 0) / 2) for x, y in points + shift]
    else:
        # The square up-left of corner 0 is dark.
        for row in range(board.rows + 1):
            for column in range(row % 2, board.columns + 1, 2):
                x, y = np.array([column - 1, row - 1]) * side + shift
                rectangles.append((float(x), float(y), side, side))
    if board.pattern == "charuco":
        rectangles += _markers(board, shift - side)
    bar = height + 4.0
    text = f"{board}, {board.square:g} mm; this bar is 100 mm long"
    rectangles.append((float(margin), float(bar), 100.0, 1.5))
    page = max(float(width), 100 + 2 * margin)
    return _Drawing(page, bar + 12, tuple(rectangles), tuple(circles), ((float(margin), bar + 7, text),))


def _markers(board: Board, origin: np.ndarray) -> list[tuple[float, float, float, float]]:
    """Black modules of all markers, as rectangles."""
    import cv2

    target = board.charuco()
    dictionary = target.getDictionary()
    side = dictionary.markerSize + 2
    found = []
    for number, corners in zip(target.getIds().ravel(), target.getObjPoints(), strict=True):
        left, top = np.asarray(corners)[:, :2].min(0) + origin
        module = float(board.marker or 0) / side
        picture = cv2.aruco.generateImageMarker(dictionary, int(number), side, borderBits=1)
        for row, column in zip(*np.nonzero(picture < 128), strict=True):
            found.append((float(left + column * module), float(top + row * module), module, module))
    return found


def _svg(drawing: _Drawing) -> bytes:
    size = f"{drawing.width:.4f} {drawing.height:.4f}"
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{drawing.width:.4f}mm" height="{drawing.height:.4f}mm" '
        f'viewBox="0 0 {size}" shape-rendering="geometricPrecision">',
        '<rect width="100%" height="100%" fill="white"/>',
        *(f'<rect x="{x:.4f}" y="{y:.4f}" width="{w:.4f}" height="{h:.4f}"/>' for x, y, w, h in drawing.rectangles),
        *(f'<circle cx="{x:.4f}" cy="{y:.4f}" r="{r:.4f}"/>' for x, y, r in drawing.circles),
        *(
            f'<text x="{x:.3f}" y="{y:.3f}" font-size="4" font-family="sans-serif">{t}</text>'
            for x, y, t in drawing.texts
        ),
        "</svg>\n",
    ]
    return "\n".join(lines).encode()


def _pdf(drawing: _Drawing) -> bytes:
    """A page of PDF 1.4 with filled paths and one line of text."""

    def down(y: float) -> float:
        return drawing.height - y

    marks = [f"{_POINT:.6f} 0 0 {_POINT:.6f} 0 0 cm 0 g"]
    marks += [f"{x:.4f} {down(y + h):.4f} {w:.4f} {h:.4f} re f" for x, y, w, h in drawing.rectangles]
    for x, y, r in drawing.circles:
        k, y = r * _KAPPA, down(y)
        marks.append(
            f"{x + r:.4f} {y:.4f} m {x + r:.4f} {y + k:.4f} {x + k:.4f} {y + r:.4f} {x:.4f} {y + r:.4f} c "
            f"{x - k:.4f} {y + r:.4f} {x - r:.4f} {y + k:.4f} {x - r:.4f} {y:.4f} c "
            f"{x - r:.4f} {y - k:.4f} {x - k:.4f} {y - r:.4f} {x:.4f} {y - r:.4f} c "
            f"{x + k:.4f} {y - r:.4f} {x + r:.4f} {y - k:.4f} {x + r:.4f} {y:.4f} c f"
        )
    marks += [f"BT /F1 4 Tf {x:.3f} {down(y):.3f} Td ({t}) Tj ET" for x, y, t in drawing.texts]
    stream = "\n".join(marks).encode()
    box = f"[0 0 {drawing.width * _POINT:.4f} {drawing.height * _POINT:.4f}]"
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        b"<< /Type /Page /Parent 2 0 R /MediaBox %s /Contents 4 0 R /Resources << /Font << /F1 5 0 R >> >> >>"
        % box.encode(),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(stream), stream),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    data, offsets = b"%PDF-1.4\n", []
    for number, content in enumerate(objects, 1):
        offsets.append(len(data))
        data += b"%d 0 obj\n%s\nendobj\n" % (number, content)
    table = b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    end = b"trailer << /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (len(objects) + 1, len(data))
    return data + b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1) + table + end
