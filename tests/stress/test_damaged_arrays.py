"""Damaged and hostile Zarr arrays: refused in words, in bounded time and memory, and nothing in
them is run.
"""

from __future__ import annotations

import resource
from types import SimpleNamespace

import numpy as np
import pytest

import lfcal
from lfcal.images.containers import check_zarr

zarr = pytest.importorskip("zarr", minversion="3.0")

from benchmarks.stress.zarr_faults import PICTURE, described_otherwise, fuzz_arrays, whole_arrays  # noqa: E402


def test_damaged_arrays_end_in_an_error_that_names_them_and_missing_chunks_are_not_black(tmp_path):
    tried, faults = fuzz_arrays(tmp_path, range(5))
    assert tried >= 280
    assert not faults


def readers(path):
    yield lambda: lfcal.read_flat(path)

    def last_pixel():
        with lfcal.open_flat(path) as source:
            height, width = source.shape[:2]
            source.read(width - 1, height - 1, width, height)

    yield last_pixel


@pytest.mark.parametrize("name", ["v2", "v3 shards"])
@pytest.mark.parametrize(
    "entries, message",
    [
        ({"shape": [2_000_000_000, 2_000_000_000, 3]}, "px at most"),
        ({"shape": [30_000, 30_000, 3]}, "is missing"),
        ({"shape": [60, 70, 1_000_000]}, "grey or RGB picture"),
        ({"shape": [-60, 70, 3]}, "damaged"),
        ({"shape": [60, 70]}, None),
        ({"shape": [60, 70, 3, 1]}, None),
        ({"shape": "many"}, "damaged"),
    ],
)
def test_descriptions_that_lie_about_the_shape_are_refused_in_little_memory(
    tmp_path, name, entries, message
):
    path = whole_arrays(tmp_path)[name]
    described_otherwise(path, **entries)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for read in readers(path):
        with pytest.raises(lfcal.FlatError, match=message) as told:
            read()
        assert str(path) in str(told.value)
    # [kB]
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000


@pytest.mark.parametrize("dtype", ["complex64", "datetime64[s]"])
def test_arrays_of_other_types_than_pixels_have_are_refused(tmp_path, dtype):
    array = zarr.create_array(tmp_path / "flat.zarr", shape=(20, 30), dtype=dtype)
    array[...] = np.ones((20, 30)).astype(dtype)
    for read in readers(tmp_path / "flat.zarr"):
        with pytest.raises(lfcal.FlatError, match=r"flat\.zarr: .*type"):
            read()


def test_array_in_one_chunk_of_more_pixels_than_a_flat_has_is_refused(tmp_path):
    path = whole_arrays(tmp_path)["v2"]
    described_otherwise(path, chunks=[1_000_000, 1_000_000, 3])
    for read in readers(path):
        with pytest.raises(lfcal.FlatError, match="chunks of shape"):
            read()


class _Marker:
    """Makes a file where it is unpickled."""

    def __init__(self, path):
        self.path = str(path)

    def __reduce__(self):
        return open, (self.path, "w")


@pytest.mark.parametrize("dtype", ["|u1", "|O"])
@pytest.mark.parametrize("filters", [["pickle"], ["shuffle", "pickle"], ["pickle", "shuffle"]])
def test_nothing_in_a_chunk_is_run(tmp_path, dtype, filters):
    """Zarr of version 2 knows a filter that does."""
    numcodecs = pytest.importorskip("numcodecs")
    path = whole_arrays(tmp_path)["v2 plain"]
    described_otherwise(path, dtype=dtype, filters=[{"id": name} for name in filters], fill_value=0)
    evil = bytes(numcodecs.Pickle().encode(np.array([_Marker(tmp_path / "run")], dtype=object)))
    for chunk in path.glob("[0-9]*"):
        chunk.write_bytes(evil)
    for read in readers(path):
        with pytest.raises(lfcal.FlatError, match=r"v2 plain\.zarr"):
            read()
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("place", ["filters", "compressor"])
def test_codecs_that_make_objects_are_refused_where_zarr_lets_them_pass(tmp_path, place):
    numcodecs = pytest.importorskip("numcodecs")
    array = zarr.open(str(whole_arrays(tmp_path)["v2"]), mode="r")
    codec = numcodecs.Pickle()
    lied = {
        "chunk_grid": array.metadata.chunk_grid,
        place: (codec,) if place == "filters" else codec,
    }
    stub = SimpleNamespace(
        shape=array.shape, dtype=array.dtype, metadata=SimpleNamespace(**lied), store=array.store
    )
    with pytest.raises(lfcal.FlatError, match="codec 'pickle'"):
        check_zarr(stub)


@pytest.mark.parametrize("dtype", ["int32", "uint64"])
def test_integers_of_more_than_16_bits_are_read_where_their_values_fit(tmp_path, dtype):
    array = zarr.create_array(tmp_path / "flat.zarr", shape=(20, 30), dtype=dtype)
    values = np.arange(600).reshape(20, 30)
    array[...] = values.astype(dtype)
    np.testing.assert_array_equal(lfcal.read_flat(tmp_path / "flat.zarr"), values)
    array[...] = (values + 65530).astype(dtype)
    for read in readers(tmp_path / "flat.zarr"):
        with pytest.raises(lfcal.FlatError, match=r"flat\.zarr: has values above 65535"):
            read()


def test_black_chunks_of_our_own_pictures_are_there(tmp_path):
    """Zarr leaves them out unless it is told not to."""
    from lfrender.output.formats import EmbeddedMetadata
    from lfrender.output.tiled_picture import TileWriter

    picture = np.zeros((40, 50, 3), np.uint8)
    picture[:20] = PICTURE[:20, :50]
    (tmp_path / "work").mkdir()
    writer = TileWriter(
        tmp_path / "p.zarr",
        tmp_path / "work",
        picture.shape,
        "uint8",
        (25, 20),
        "{}",
        EmbeddedMetadata(),
    )
    writer.open(fresh=True)
    for top in (0, 20):
        # As after a run that was killed.
        writer.open(fresh=False)
        for left in (0, 25):
            writer.write(
                (left, top, left + 25, top + 20), picture[top : top + 20, left : left + 25]
            )
    writer.finish(tmp_path / "p.zarr")
    np.testing.assert_array_equal(lfcal.read_flat(tmp_path / "p.zarr"), picture)
