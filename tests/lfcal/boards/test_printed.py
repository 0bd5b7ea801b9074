"""Boards to print are found again by the detectors, in true size."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest

from lfcal import Board, OutputError
from lfcal.boards.printed import _draw, write_board

BOARDS = [Board(9, 6, 12.0), Board(6, 4, 15.0, "charuco", 11.0, "4X4_50"), Board(4, 11, 10.0, "circles")]


def _raster(board, scale=6.0):
    drawing = _draw(board)
    page = np.full((round(drawing.height * scale), round(drawing.width * scale)), 255, np.uint8)
    for x, y, w, h in drawing.rectangles:
        corners = np.rint(np.array([x, y, x + w, y + h]) * scale).astype(int)
        page[corners[1] : corners[3], corners[0] : corners[2]] = 0
    for x, y, r in drawing.circles:
        cv2.circle(page, (round(x * scale), round(y * scale)), round(r * scale), 0, -1)
    return page


@pytest.mark.parametrize("board", BOARDS, ids=lambda board: board.pattern)
def test_a_printed_board_is_found_with_its_points_in_order(board):
    from lfcal.boards.detection import detect
    from lfcal.boards.focus_sweep import FocusedPicture

    page = np.maximum(_raster(board), 30).astype(np.float32)
    found = detect(FocusedPicture(page, np.full(page.shape, -0.3, np.float32), 1.0), board)
    assert found is not None
    points = board.points[found.corner, :2]
    offset = found.scene / 6 - points
    np.testing.assert_allclose(offset - offset.mean(0), 0, atol=0.15)  # mm


def test_a_page_has_its_size_in_millimetres_and_a_bar_of_100(tmp_path):
    board = BOARDS[0]
    write_board(tmp_path / "board.svg", board)
    text = (tmp_path / "board.svg").read_text()
    assert re.search(r'width="144.0000mm" height="\d+\.\d+mm"', text)
    assert 'width="100.0000"' in text
    write_board(tmp_path / "board.pdf", board)
    data = (tmp_path / "board.pdf").read_bytes()
    width = float(re.search(rb"MediaBox \[0 0 ([\d.]+)", data).group(1))
    assert width == pytest.approx(144 * 72 / 25.4, abs=1e-3)
    start = int(re.search(rb"startxref\n(\d+)", data).group(1))
    assert data[start : start + 4] == b"xref"
    with pytest.raises(OutputError, match="svg"):
        write_board(tmp_path / "board.png", board)
