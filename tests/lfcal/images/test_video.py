"""Single frames of compressed videos as flats."""

from __future__ import annotations

import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import lfcal
import lfrender

av = pytest.importorskip("av", reason="videos are decoded by PyAV (lfrender[video])")


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """A film of three frames, each with its number of bright rows."""
    from lfrender.sequence.film_file import FilmFile

    path = tmp_path_factory.mktemp("film") / "film.mkv"
    with FilmFile(path, Fraction(25)) as film:
        for rows in (8, 16, 24):
            film.add(
                np.repeat(np.where(np.arange(48) < rows, 200, 40), 64 * 3)
                .astype(np.uint8)
                .reshape(48, 64, 3)
            )
    return path


def test_frame_of_a_video_is_that_of_the_sequence(film):
    for number, frame in enumerate(lfrender.open_frames([film])):
        np.testing.assert_array_equal(lfcal.read_flat(film, number), frame.read())


@pytest.mark.parametrize(
    "page, message", [(None, "several frames"), (3, "no frame 3"), (-1, "no frame -1")]
)
def test_wrong_number_is_refused(film, page, message):
    with pytest.raises(lfcal.FlatError, match=message):
        lfcal.read_flat(film, page)


def test_damaged_video_is_refused(film, tmp_path):
    path = tmp_path / "damaged.mp4"
    path.write_bytes(film.read_bytes()[:200])
    with pytest.raises(lfcal.FlatError, match=r"damaged\.mp4: "):
        lfcal.read_flat(path, 0)


def test_package_that_is_missing_is_named(film, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(lfcal.FlatError, match="pip install 'av>="):
        lfcal.read_flat(film, 0)


def test_stream_without_header_is_read():
    stream = Path(__file__).parents[4] / "shared/captures/Fujita2.vvc"
    if not stream.exists():
        pytest.skip("the shared captures are not here")
    assert lfcal.read_flat(stream, 0).shape == (2048, 2048, 3)
