"""The scene as a textured mesh: what its triangles join, where its texture lies, and its files in
other programs.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest

import lfcal
import lfrender
from lfrender.data.dense_depth import dense_depth
from lfrender.data.surface import edge_step
from lfrender.output.point_cloud import mesh, point_cloud, write_mesh

trimesh = pytest.importorskip("trimesh", reason="meshes need lfrender[mesh]")


@functools.cache
def surface():
    return mesh(*lfrender.data.example(), points_per_pitch=5)


def test_vertices_are_points_of_the_cloud_and_no_triangle_crosses_a_depth_edge():
    depth = lfrender.data.example()[2]
    points = point_cloud(*lfrender.data.example(), points_per_pitch=5)
    cloud = {tuple(point) for point in np.column_stack([points[axis] for axis in "xyz"]).tolist()}
    found = {tuple(vertex) for vertex in surface().vertices.astype(np.float32).tolist()}
    assert found <= cloud and len(found) > 0.9 * len(cloud)
    sizes = depth.pitch / surface().vertices[surface().faces][..., 2]
    assert np.ptp(sizes, axis=1).max() < edge_step(depth.pitch), "[px]"
    dense = dense_depth(depth, 5)
    seen = dense.patch_size[dense.resolved]
    assert np.abs(np.diff(np.sort(seen))).max() > edge_step(depth.pitch), (
        "there is an edge to cross"
    )
    assert (surface().face_normals[:, 2] < 0).all(), "all front sides are toward the camera"


def test_the_texture_shows_at_each_vertex_what_the_picture_shows_there():
    picture = lfrender.render(*lfrender.data.example())
    depth = lfrender.data.example()[2]
    texture = np.asarray(surface().visual.material.baseColorTexture)
    np.testing.assert_array_equal(texture, picture.image)
    height, width = picture.valid.shape
    u, v = (surface().visual.uv * (width, -height) + (0, height) - 0.5).T
    places = np.column_stack([u, v, np.ones(len(u))]) @ picture.affine.T
    np.testing.assert_allclose(places, surface().vertices[:, :2] * depth.pitch, atol=1e-3)


@pytest.mark.parametrize(
    "optics", [None, lfcal.Optics(50, 58, 0.7, 0.0055)], ids=["pitches", "metres"]
)
def test_files_are_read_with_their_axes(tmp_path, optics):
    whole = mesh(*lfrender.data.example(), optics, points_per_pitch=3)
    told = "metres" if optics else "virtual depth"
    write_mesh(tmp_path / "a.glb", whole)
    model = trimesh.load(tmp_path / "a.glb", force="mesh", process=False)
    np.testing.assert_allclose(model.vertices, whole.vertices * (1, -1, -1), rtol=1e-5)
    assert told in model.metadata["axes"] and model.visual.material.baseColorTexture is not None
    write_mesh(tmp_path / "a.ply", whole)
    model = trimesh.load(tmp_path / "a.ply", process=False)
    np.testing.assert_allclose(model.vertices, whole.vertices, rtol=1e-5)
    assert (
        told.encode() in (tmp_path / "a.ply").read_bytes()[:200]
        and np.ptp(model.visual.vertex_colors) > 50
    )
    np.testing.assert_array_equal(model.faces, whole.faces)
