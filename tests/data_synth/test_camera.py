"""The camera's closed forms against independent tracing, and its lattices."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_synth import SCENES, Camera, simulate
from data_synth.transfer import from_srgb

TRUTH = Path(__file__).resolve().parents[2].parent / "shared" / "truth"


def trace_to_sensor(camera: Camera, point: np.ndarray, microlens: np.ndarray) -> np.ndarray:
    """Where the image of an object point through the middle of a microlens falls on the sensor
    [mm].

    By Newton's construction, not by slopes: the main lens images the point, the line from that
    image through the microlens centre continues to the sensor.
    """
    image_distance = camera.focal_length * point[2] / (point[2] - camera.focal_length)
    image = point[:2] / point[2] * image_distance
    # Object space is turned by 180 degrees, so the image keeps the sign of x and y; axial distance
    # from the main lens.
    step = camera.sensor_distance / (camera.mla_distance - image_distance)
    return microlens + (microlens - image) * step


@pytest.mark.parametrize("ratio", [0.55, 0.3, 0.2, -0.12, -0.3, -0.6])
def test_patch_size_is_the_shift_of_a_traced_feature_from_lens_to_lens(ratio: float) -> None:
    camera = Camera.design((300, 300), 23.2, "hex", 7.0)
    depth = camera.depth_at(ratio)
    point = np.array([1.0, -2.0, float(depth)])
    centres = np.array([camera.origin, np.add(camera.origin, camera.basis[0])])
    lenses = (centres - camera.principal_point) * camera.pixel / camera.spread
    seen = [
        trace_to_sensor(camera, point, lens) / camera.pixel + camera.principal_point
        for lens in lenses
    ]
    shift = (seen[1] - centres[1]) - (seen[0] - centres[0])
    expected = camera.patch_size(depth) * (centres[1] - centres[0]) / camera.pitch
    assert shift == pytest.approx(expected, abs=1e-9)
    assert camera.patch_size(depth) == pytest.approx(ratio * camera.pitch, abs=1e-9)


@given(st.one_of(st.floats(0.17, 0.7), st.floats(-0.7, -0.1)), st.floats(8, 70))
def test_depth_and_patch_size_are_inverse(ratio: float, pitch: float) -> None:
    camera = Camera.design((100, 100), pitch)
    assert float(camera.patch_size(camera.depth_at(ratio))) == pytest.approx(
        ratio * pitch, rel=1e-8
    )


def test_depths_with_no_object_are_refused() -> None:
    with pytest.raises(ValueError, match="no object"):
        Camera.design().depth_at(0.02)


@given(
    st.sampled_from(["hex", "hex-vertical", "square", "rectangular", "sheared"]),
    st.floats(-180, 180),
)
def test_every_lattice_has_the_wanted_pitch_at_any_rotation(lattice: str, rotation: float) -> None:
    camera = Camera.design((200, 150), 21.0, lattice, rotation)
    assert camera.pitch == pytest.approx(21.0, rel=1e-9)
    a, b = np.array(camera.basis)
    assert 0.5 + 1e-6 > a @ b / np.hypot(*a) / np.hypot(*b) > -1e-6


def test_rotation_is_clockwise_on_the_screen() -> None:
    camera = Camera.design((200, 150), 20.0, "square", 3.0)
    steps = np.array(camera.basis)
    along_x = steps[np.argmax(np.abs(steps[:, 0]))]
    assert np.rad2deg(np.arctan2(along_x[1], along_x[0])) % 90 == pytest.approx(3.0)


def test_three_lens_types_differ_between_all_neighbours() -> None:
    lattice = Camera.design(
        (300, 300), 23.2, "hex-vertical", 11.0, focus=(-0.4, -0.3, -0.2)
    ).lattice
    assert len(lattice.steps) == 6
    assert ((lattice.steps[:, 0] - lattice.steps[:, 1]) % 3 != 0).all()


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"fill": 1.2}, "fill"),
        ({"pixel": 0.0}, "pixel"),
        ({"aperture": 60.0}, "overlap"),
        ({"microlens_focal_lengths": ()}, "1 to 3"),
        ({"type_apertures": (1.0, 0.9)}, "type_apertures"),
        ({"filters": (1.0, 0.0, 1.0)}, "filters"),
        ({"stray": 1.5}, "stray"),
        ({"mosaic": "RGBG"}, "mosaic"),
        ({"basis": ((1.0, 0.0), (2.0, 0.0))}, "independent"),
        ({"stop": (-1.0, 3.0)}, "stop"),
        ({"width": 0}, "width"),
    ],
)
def test_impossible_cameras_are_refused(change: dict[str, object], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        Camera.design().replace(**change)


def truth_camera(name: str) -> tuple[dict[str, Any], Camera]:
    """Camera of a reference capture that another ray tracer made."""
    about = json.loads((TRUTH / name / "truth.json").read_text())["camera"]
    camera = Camera(
        width=about["W"],
        height=about["H"],
        pixel=about["pix"],
        focal_length=about["F"],
        mla_distance=about["dL"],
        sensor_distance=about["b"],
        microlens_focal_lengths=tuple(about["f_mu"]),
        aperture=about["A"],
        fill=about["fill"],
        basis=about["basis_px"],
        origin=about["origin_px"],
        principal_point=(about["cu"], about["cv"]),
        natural_vignetting=about["cos4"],
    )
    return about, camera


@pytest.mark.skipif(not TRUTH.is_dir(), reason="no ray-traced truth beside the repository")
@pytest.mark.parametrize("name", ["s3_r5", "s5b_tspc"])
def test_white_image_is_that_of_an_independent_ray_tracer(name: str) -> None:
    _, camera = truth_camera(name)
    corner = camera.replace(width=300, height=300)
    mine = from_srgb(simulate(SCENES["blank"](corner), corner, samples=64).white / 255)
    theirs = from_srgb(
        cv2.imread(str(TRUTH / name / "white.png"), cv2.IMREAD_GRAYSCALE)[:300, :300] / 255
    )
    y, x = np.mgrid[0:300, 0:300]
    radius = np.min([np.hypot(x - u, y - v) for u, v in corner.lattice.centres()], axis=0)
    rings = np.rint((radius - camera.microimage_radius) * 4).astype(int)
    # Single rim pixels differ by sampling noise; over all pixels at one distance from the centres
    # nothing is left.
    for ring in range(-8, 9):
        at = (rings == ring)[20:-20, 20:-20]
        difference = (mine - theirs)[20:-20, 20:-20][at]
        allowed = 4 * difference.std() / np.sqrt(difference.size) + 1e-3
        assert difference.size > 100
        assert abs(difference.mean()) < allowed < 0.02, f"light at {ring / 4} px beyond the rim"


@pytest.mark.skipif(not TRUTH.is_dir(), reason="no ray-traced truth beside the repository")
@pytest.mark.parametrize("name", ["s2_sq", "s3_r5", "s4b_tspc", "s5b_tspc"])
def test_closed_forms_agree_with_an_independent_ray_tracer(name: str) -> None:
    about, camera = truth_camera(name)
    lenses = np.load(TRUTH / name / "microlenses.npz")
    assert camera.pitch == pytest.approx(about["D"], rel=1e-9)
    assert camera.microlens_pitch == pytest.approx(about["p_mm"], rel=1e-9)
    assert 2 * camera.microimage_radius == pytest.approx(about["microimage_aperture_px"], rel=1e-9)
    assert camera.patch_size(lenses["Z_mm"]) == pytest.approx(lenses["disparity_px"], abs=1e-9)
    places = camera.place(lenses["centre_px"], lenses["Z_mm"])
    assert places[:, 2] == pytest.approx(lenses["Z_mm"])
    mine = camera.lattice.centres()
    theirs = lenses["centre_px"]
    gaps = np.linalg.norm(mine[None, ::40] - theirs[:, None], axis=-1).min(0)
    assert (gaps < 1e-9).mean() > 0.95, "centres (border lenses aside) must coincide"
