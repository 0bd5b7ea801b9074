"""Lens types as a mosaic: indexing, validation and files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import lfcal
from lfcal.cli.figures import summarise

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


def test_types_may_be_missing_in_a_camera_file_but_not_wrong(tmp_path):
    camera = lfcal.Calibration(
        lfcal.Lattice((10, 7), [[20, 0], [0, 20]], (200, 100), 9.5), lens_types=None
    )
    data = {name: value for name, value in camera.to_dict().items() if name != "lens_types"}
    assert lfcal.Calibration.from_dict(data).lens_types is None
    with pytest.raises(lfcal.CameraFileError, match="lens_types"):
        lfcal.Calibration.from_dict(data | {"lens_types": {"count": 3, "cell": [[0, 7]]}})


def test_impossible_blur_is_refused():
    with pytest.raises(ValueError, match="discs"):
        lfcal.LensBlur(5.0, 0.5, [0.1], [0.02], [-0.3], np.ones((2, 3)), np.ones((2, 3)))
    with pytest.raises(ValueError, match="positive"):
        lfcal.LensBlur(0.0, 0.5, [0.1], [0.02], [-0.3], [[1.0]], [[1.0]])


def test_blur_is_printed_in_a_plain_sentence():
    camera = lfcal.Calibration(lfcal.Lattice([10, 10], [[20, 0], [0, 20]], (200, 100), 9))
    blur = lfcal.LensBlur(5.0, 0.5, [0.1], [0.02], [-0.3, -0.1], [[2.0, 1.0]], np.full((1, 2), 0.1))
    sentence = "Microlenses are in focus at s = 0.10 D; their blur is 2.0 px at -0.30 D."
    assert sentence in summarise(replace(camera, lens_blur=blur))
    rims = lfcal.LensBlur(6.0, 20.0, [0.1], [0.1], [0.0], [[0.6]], [[0.2]])
    assert any(
        text.startswith("Rims of microimages are blurred over 0.6 px")
        for text in summarise(replace(camera, lens_blur=rims))
    )


def test_discs_at_other_depths_follow_from_the_aperture():
    blur = lfcal.LensBlur(10.0, 1.0, [0.1], [0.02], [0.0, -0.4], [[1.0, 5.2]], [[0.1, 0.2]])
    discs, errors = blur.at([0.0, -0.1, 0.1, 0.3, -0.4])
    np.testing.assert_allclose(discs, [[1.0, 2.0, 0.0, 2.0, 5.2]], atol=1e-9)
    np.testing.assert_allclose(
        errors, [[0.1, np.hypot(0.1, 0.1), np.hypot(0.1, 0.1), np.hypot(0.1, 0.3), 0.2]]
    )
