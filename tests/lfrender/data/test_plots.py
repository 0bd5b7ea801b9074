import base64
import re
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

import lfcal
import lfrender
from lfrender.data.plots import napari_layers


@pytest.fixture(scope="module")
def drawn(house):
    camera = house.truth.calibration
    depth = lfrender.analyze(house.flat, camera)
    return camera, depth, lfrender.render(house.flat, camera, depth)


def test_a_notebook_shows_each_result_with_a_picture_and_figures(drawn):
    camera, depth, rendering = drawn
    assert f"{camera.lattice.pitch:.4f} px" in camera._repr_html_()
    assert "hexagonal" in camera._repr_html_()
    for result, words in (
        (camera, "px RMS" if np.isfinite(camera.residual_rms) else "usable radius"),
        (depth, "telescopic"),
        (rendering, "px per pitch"),
    ):
        html = result._repr_html_()
        assert words in html
        data = re.search(r"data:image/png;base64,([^']+)", html)[1]
        picture = Image.open(BytesIO(base64.b64decode(data)))
        assert 40 < picture.height <= 480
        assert np.asarray(picture).std() > 10


def test_a_notebook_shows_the_offsets_of_a_checked_camera(house):
    html = lfcal.check_fit(house.truth.calibration, house.white)._repr_html_()
    assert html.count(" px</td>") == 9 and "middle centre" in html
    assert "within" in html and "of this flat" in html


def test_unresolved_lenses_are_grey_and_colours_have_a_bar(drawn):
    plt = pytest.importorskip("matplotlib.pyplot", reason="Matplotlib is not installed")
    plt.switch_backend("agg")
    depth = drawn[1]
    size = depth.patch_size.copy()
    left = depth.centres[:, 0] < 0.25 * depth.image_size[0]
    size[left] = np.nan
    depth = lfrender.DepthMap(
        size,
        depth.standard_error,
        depth.confidence,
        depth.filled_patch_size,
        depth.surface,
        depth.pitch,
        depth.image_size,
        centres=depth.centres,
    )
    axes = depth.plot(plt.figure().gca())
    masked = np.ma.getmaskarray(axes.images[0].get_array())
    columns = masked.shape[1]
    assert masked[:, : int(0.2 * columns)].all()
    assert masked.mean() == pytest.approx(0.25, abs=0.1)
    labels = [label.get_text() for label in axes.images[0].colorbar.ax.get_yticklabels()]
    assert len(labels) == 5 and all(re.fullmatch(r"[\d.]+", label) for label in labels)
    plt.close("all")


def test_plots_lie_on_scene_coordinates(drawn):
    plt = pytest.importorskip("matplotlib.pyplot", reason="Matplotlib is not installed")
    camera, depth, rendering = drawn
    plt.switch_backend("agg")
    width, height = camera.image_size
    for result in (depth, rendering):
        left, right, low, top = result.plot(plt.figure().gca()).images[0].get_extent()
        np.testing.assert_allclose((left, right), (-0.5, width - 0.5), atol=camera.lattice.pitch)
        np.testing.assert_allclose((top, low), (-0.5, height - 0.5), atol=camera.lattice.pitch)
    assert len(camera.plot(plt.figure().gca()).collections[0].get_paths()) == len(camera.lattice)
    plt.close("all")


def test_residuals_of_a_white_image_are_plotted_as_arrows(house_files):
    plt = pytest.importorskip("matplotlib.pyplot", reason="Matplotlib is not installed")
    plt.switch_backend("agg")
    camera = lfcal.calibrate(lfcal.read_flat(house_files / "white.png"))
    axes = camera.plot(plt.figure().gca())
    assert 20 < axes.collections[0].N <= 108
    assert "Mean residuals" in axes.get_title()
    plt.close("all")


def test_napari_layers_lie_on_each_other(house, drawn):
    camera, depth, rendering = drawn
    layers = napari_layers(house.flat, camera, depth, rendering)
    assert [kind for _, _, kind in layers] == ["image", "image", "image", "points"]
    for data, look, _ in layers[1:3]:
        end = look["translate"] + look["scale"] * (np.array(data.shape[:2]) - 1)
        np.testing.assert_allclose(look["translate"], 0, atol=camera.lattice.pitch)
        np.testing.assert_allclose(
            end, np.array(house.flat.shape[:2]) - 1, atol=camera.lattice.pitch
        )
    y, x = layers[3][0][0]
    np.testing.assert_allclose((x, y), camera.lattice.centres()[0])
