"""What Python users try first works: a path in, a file out, arrays, and cells of notebooks."""

from __future__ import annotations

import numpy as np
import pytest

import lfcal
import lfcal.runtime.page
import lfrender


@pytest.fixture(scope="module")
def example():
    return lfrender.data.example()


def test_a_path_alone_is_rendered_as_by_the_single_steps(house_files, tmp_path):
    picture = lfrender.render(house_files / "flat.png", scale=4)
    flat = lfcal.read_flat(house_files / "flat.png")
    np.testing.assert_array_equal(
        picture.image, lfrender.render(flat, lfcal.calibrate(flat), scale=4).image
    )
    picture.save(tmp_path / "picture.tif")
    np.testing.assert_array_equal(lfcal.read_flat(tmp_path / "picture.tif"), picture.image)


def test_pictures_and_dense_depth_are_indexed_as_arrays(example):
    picture = lfrender.render(*example, scale=4)
    assert picture.shape == picture.image.shape
    np.testing.assert_array_equal(picture[3:5, 2], picture.image[3:5, 2])
    dense = example[2].dense(scale=4)
    assert dense.shape == picture.shape[:2]
    assert dense[1, 2] == dense.patch_size[1, 2]


def test_assessments_are_tables_in_notebooks_and_texts_in_them_are_escaped(example):
    flat, camera, _ = example
    shown = lfcal.assess(flat, calibration=camera)
    html = shown._repr_html_()
    assert "<th>rotation</th>" in html and html.count("<tr>") == len(shown.grouped())
    assert "&amp;" in lfcal.runtime.page.html_table("a & b", {})
