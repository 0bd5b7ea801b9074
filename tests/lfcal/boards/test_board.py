"""Boards to print are found again by the detectors, in true size."""

from __future__ import annotations

import re

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from lfcal import Board, OutputError
from lfcal.boards.board import draw_board, write_board

BOARDS = [
    Board(9, 6, 12.0),
    Board(6, 4, 15.0, "charuco", 11.0, "4X4_50"),
    Board(4, 11, 10.0, "circles"),
]


def _raster(board, scale=6.0):
    """The page in pixels of 1 / scale mm."""
    figure = draw_board(board)
    figure.set_dpi(scale * 25.4)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., 0]


@pytest.mark.parametrize("board", BOARDS, ids=lambda board: board.pattern)
def test_a_printed_board_is_found_with_its_points_in_order(board):
    from lfcal.boards.detection import FocusedPicture, detect

    page = np.maximum(_raster(board), 30).astype(np.float32)
    found = detect(FocusedPicture(page, np.full(page.shape, -0.3, np.float32), 1.0), board)
    assert found is not None
    points = board.points[found.corner, :2]
    offset = found.scene / 6 - points
    np.testing.assert_allclose(offset - offset.mean(0), 0, atol=0.15)  # mm


def test_a_page_has_its_size_in_millimetres_and_a_bar_of_100(tmp_path):
    board = BOARDS[0]
    write_board(tmp_path / "board.svg", board)
    # The bar, on a page of 144 mm.
    dark = (_raster(board, 10) < 128).sum(1)
    assert 1000 in dark and _raster(board, 10).shape[1] == 1440
    text = (tmp_path / "board.svg").read_text()
    assert float(re.search(r'width="([\d.]+)pt"', text).group(1)) == pytest.approx(
        144 * 72 / 25.4, abs=0.01
    )
    write_board(tmp_path / "board.pdf", board)
    data = (tmp_path / "board.pdf").read_bytes()
    width = float(re.search(rb"MediaBox \[ ?0 0 ([\d.]+)", data).group(1))
    assert width == pytest.approx(144 * 72 / 25.4, abs=0.01)
    with pytest.raises(OutputError, match="svg"):
        write_board(tmp_path / "board.png", board)
