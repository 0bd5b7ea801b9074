"""Objects of the wrong kind are named with what makes the right one; results compare by value."""

from __future__ import annotations

import copy
import functools
import inspect
import pickle
from dataclasses import replace

import numpy as np
import pytest

import lfcal
import lfrender
from lfrender.data.dense_depth import dense_depth, write_dense
from lfrender.data.depth_map import default_scale
from lfrender.data.plots import napari_layers
from lfrender.output.picture import write_stack
from lfrender.output.point_cloud import point_cloud, write_points
from lfrender.output.poses import view_rig
from lfrender.output.views import stereo_pair, write_animation, write_grid, write_quilt
from lfrender.rendering.refocus import stack_depths
from lfrender.rendering.viewpoints import views_with_depth
from lfrender.sequence.film import render_film
from lfrender.web.report import write_report
from lfrender.web.viewer import viewer_page


@functools.cache
def right():
    """Flat, camera, depth and picture, by the names that arguments have."""
    flat, camera, depth = lfrender.data.example()
    picture = lfrender.render(flat, camera, depth, scale=3)
    return {"flat": flat, "calibration": camera, "depth": depth, "left": picture, "right": picture}


# Functions, what else they are given, and the arguments that are wrong in turn.
CASES = [
    (lfrender.analyze, {}, "flat calibration previous"),
    (lfrender.analyze_large, {}, "source"),
    (lfrender.render, {}, "flat calibration depth previous"),
    (lfrender.render_large, {"path": "a.tif"}, "source"),
    (lfrender.traditional, {}, "flat calibration"),
    (lfrender.refocus, {"patch_size": 5.0}, "flat calibration"),
    (lfrender.focal_stack, {"patch_sizes": [5.0]}, "flat calibration patch_sizes"),
    (lfrender.views, {"offsets": [(0, 0)]}, "flat calibration depth offsets"),
    (views_with_depth, {"offsets": [(0, 0)], "still": 5.0}, "flat calibration depth offsets"),
    (lfrender.write_picture, {"path": "p.png"}, "picture"),
    (lfrender.open_frames, {}, "inputs"),
    (lfrender.render_frames, {"folder": "o"}, "frames"),
    (render_film, {"path": "o.mp4"}, "frames"),
    (dense_depth, {}, "depth"),
    (write_dense, {"path": "d.tif"}, "dense"),
    (default_scale, {}, "depth"),
    (stack_depths, {"count": 2}, "depth"),
    (napari_layers, {}, "calibration depth rendering"),
    (write_stack, {"path": "s.tif"}, "pictures"),
    (write_grid, {"folder": "g", "columns": 1}, "pictures"),
    (write_quilt, {"path": "q.png", "columns": 1, "rows": 1}, "pictures"),
    (write_animation, {"path": "s.gif"}, "pictures"),
    (stereo_pair, {}, "left right"),
    (point_cloud, {}, "flat calibration depth"),
    (write_points, {"path": "p.ply"}, "points"),
    (
        view_rig,
        {"offsets": [(0, 0)], "affine": np.eye(2, 3), "size": (3, 2), "still": 5.0},
        "calibration depth",
    ),
    (write_report, {"path": "r.html"}, "flat calibration depth"),
    (viewer_page, {}, "flat calibration depth"),
]


ITERABLES = ("patch_sizes", "offsets", "inputs", "frames", "pictures")


@pytest.mark.parametrize(
    ("function", "more", "name"),
    [
        pytest.param(function, more, name, id=f"{function.__name__} {name}")
        for function, more, names in CASES
        for name in names.split()
    ],
)
def test_an_object_of_another_kind_is_named(function, more, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    known = {
        key: value
        for key, value in right().items()
        if key in inspect.signature(function).parameters
    }
    optional = inspect.signature(function).parameters[name].default is None
    for wrong in ["words", 7 if name in ITERABLES else [1, "x"], *([] if optional else [None])]:
        with pytest.raises((TypeError, lfcal.LightFieldError)) as found:
            list(function(**{**known, **more, name: wrong}))  # some draw on demand
        # Errors of files name these.
        assert name in str(found.value) or isinstance(found.value, lfcal.LightFieldError)
    assert list(tmp_path.iterdir()) in ([], [tmp_path / "g"])


def test_results_compare_by_value():
    flat, camera, depth = lfrender.data.example()
    picture = lfrender.render(flat, camera, depth, scale=3)
    rig = view_rig(camera, depth, [(-4.0, 0.0), (4.0, 0.0)], picture.affine, (30, 20), still=-7.0)
    for one in (depth, depth.surface, picture, dense_depth(depth, 3), rig.cameras[0]):
        assert one == copy.deepcopy(one) == pickle.loads(pickle.dumps(one)) and one != 1
        with pytest.raises(TypeError, match="unhashable"):
            hash(one)
    assert np.isnan(depth.patch_size).any(), "NaN equals NaN"
    assert rig == view_rig(
        camera, depth, [(-4.0, 0.0), (4.0, 0.0)], picture.affine, (30, 20), still=-7.0
    )
    assert depth != replace(depth, pitch=9.0) and depth.surface != replace(
        depth.surface, spacing=9.0
    )
    assert picture != lfrender.traditional(flat, camera)
