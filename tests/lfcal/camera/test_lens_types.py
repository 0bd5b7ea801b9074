"""Lens types as a mosaic: indexing, validation and files."""

from __future__ import annotations

import json

import numpy as np
import pytest

import lfcal

_MOSAIC = np.array([[0, 1, 2], [2, 0, 1], [1, 2, 0]])


def test_lenses_far_outside_the_flat_have_a_type_too():
    types = lfcal.LensTypes(_MOSAIC)
    np.testing.assert_array_equal(types.of([(-3, 0), (-1, 0), (0, -1), (301, 2)]), [0, 1, 2, 1])
    assert types.of(np.zeros((0, 2), int)).shape == (0,)
    with pytest.raises(ValueError, match="whole numbers"):
        types.of([(0.5, 1.0)])


@pytest.mark.parametrize(
    ("cell", "rest", "word"),
    [
        ([[0, 2], [2, 0]], {}, "gaps"),
        ([[0, 1, 2]], {}, r"\(m, m\)"),
        ([[0.0, 1.0], [1.0, 0.0]], {}, "numbered"),
        ([[0, 1], [1, 0]], {"focus": [0.1]}, "focus"),
        ([[0, 1], [1, 0]], {"confidence": 2.0}, "confidence"),
    ],
)
def test_impossible_types_are_refused(cell, rest, word):
    with pytest.raises(ValueError, match=word):
        lfcal.LensTypes(cell, **rest)


def test_types_are_kept_in_a_camera_file_and_missing_in_older_ones(tmp_path):
    lattice = lfcal.Lattice((10.25, 7.5), [[20.0, 0.5], [9.5, 17.0]], (200, 100), 9.5)
    types = lfcal.LensTypes(_MOSAIC, True, [-0.4, float("nan"), -0.2], 0.97)
    camera = lfcal.Calibration(lattice, lens_types=types)
    path = tmp_path / "camera.json"
    camera.save(path)
    back = lfcal.load(path)
    assert back.to_dict() == camera.to_dict()
    np.testing.assert_array_equal(back.lens_types.focus, types.focus)
    data = json.loads(path.read_text())
    assert data["lens_types"]["focus"] == [-0.4, None, -0.2]
    path.write_text(json.dumps(data | {"lens_types": {"count": 3, "cell": [[0, 7]]}}))
    with pytest.raises(lfcal.CameraFileError, match=r"camera\.json"):
        lfcal.load(path)
    del data["lens_types"]
    path.write_text(json.dumps(data))
    assert lfcal.load(path).lens_types is None
