"""Blending lens by lens gives the picture of blending pixel by pixel."""

import functools

import numba
import numpy as np
import pytest

import lfrender
from data_synth import SCENES, Camera, simulate
from lfrender.rendering.blend.blend_rows import blend_rows
from lfrender.rendering.plan import RenderPlan
from lfrender.rendering.render import make_plan


@functools.cache
def capture():
    camera = Camera.design(size=(300, 220), pitch=17.3, rotation=2.1)
    shot = simulate(SCENES["house"](camera), camera, samples=24, seed=2)
    return shot.flat, shot.truth.calibration, lfrender.analyze(shot.flat, shot.truth.calibration, "fast")


def shorts(flat):
    """The same in 16 bits, with lower bits set."""
    return flat * np.uint16(257) - np.random.default_rng(3).integers(0, 200, flat.shape, np.uint16) % (
        flat + np.uint16(1)
    )


def blend_pixel_by_pixel(monkeypatch):
    monkeypatch.setattr(RenderPlan, "_suits_rows", lambda *_: False)


# At the larger scale a lens shows more pixels of a row than are worked on together.
@pytest.mark.parametrize(("made", "equal"), [(np.asarray, 0.999), (shorts, 0.99)])
@pytest.mark.parametrize(("channels", "scale"), [(1, None), (3, None), (3, 30.0)])
def test_both_kernels_give_the_same_picture_within_one_level(channels, scale, made, equal, monkeypatch):
    flat, camera, depth = capture()
    flat = made(flat.reshape(*flat.shape[:2], -1)[:, :, :1].repeat(channels, 2))
    rows = lfrender.render(flat, camera, depth, scale=scale)
    blend_pixel_by_pixel(monkeypatch)
    pixels = lfrender.render(flat, camera, depth, scale=scale)
    apart = np.abs(rows.image.astype(int) - pixels.image)
    assert (rows.valid == pixels.valid).all()
    # Sums in another order round differently, and so do distances to the rim of the reach.
    assert (apart == 0).mean() > equal
    assert (apart > 1).mean() < 1e-4


@pytest.mark.parametrize("made", [np.asarray, shorts])
def test_the_usual_picture_is_blended_lens_by_lens(made, monkeypatch):
    import lfrender.rendering.plan as plan

    flat, camera, depth = capture()
    drawn_by_pixel = []
    blend_pixels = plan.blend_pixels
    monkeypatch.setattr(
        plan, "blend_pixels", lambda *args: drawn_by_pixel.append(args[6].wanted.mean()) or blend_pixels(*args)
    )
    lfrender.render(made(flat), camera, depth)
    # Only output pixels larger than one of the flat are blended pixel by pixel.
    assert sum(drawn_by_pixel) < 0.1


def test_flats_of_bytes_and_shorts_are_drawn_by_the_same_compiled_kernel():
    flat, camera, depth = capture()
    lfrender.render(flat, camera, depth)
    before = len(blend_rows.kernel.signatures)
    lfrender.render(shorts(flat), camera, depth)
    assert len(blend_rows.kernel.signatures) == before


@pytest.mark.parametrize("made", [np.asarray, shorts])
def test_blended_rows_have_the_same_bits_on_one_thread_and_two_and_in_a_part(made):
    flat, camera, depth = capture()
    flat = made(flat)
    threads = numba.get_num_threads()
    whole = lfrender.render(flat, camera, depth)
    try:
        numba.set_num_threads(1)
        alone = lfrender.render(flat, camera, depth)
    finally:
        numba.set_num_threads(threads)
    np.testing.assert_array_equal(alone.image, whole.image)
    part = lfrender.render(flat, camera, depth, roi=(61.0, 50.0, 191.0, 140.0))
    left, top = np.rint((part.affine[:, 2] - whole.affine[:, 2]) / whole.affine[0, 0]).astype(int)
    rows, columns = part.valid.shape
    np.testing.assert_array_equal(part.image, whole.image[top : top + rows, left : left + columns])


@pytest.mark.parametrize("made", [np.asarray, shorts])
def test_redrawn_pixels_have_the_bits_of_the_whole_picture(made):
    flat, camera, depth = capture()
    flat = made(flat)
    whole = lfrender.render(flat, camera, depth, detail="off")
    look = lambda part: flat[part[1] : part[3], part[0] : part[2]]  # noqa: E731
    drawing = make_plan(look, camera, depth, None, None, None, "off")
    wanted = np.random.default_rng(4).random(whole.valid.shape) < 0.3
    # Whole rows and long runs are not drawn at all.
    wanted[10:20] = wanted[:, 40:90] = False
    image, valid = drawing.render_changed(flat, wanted, np.zeros_like(whole.image), np.zeros_like(whole.valid))
    np.testing.assert_array_equal(image, whole.image * wanted[:, :, None])
    np.testing.assert_array_equal(valid, whole.valid & wanted)
