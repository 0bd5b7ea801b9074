"""Assessing an array: simulated mounts are recovered within twice the stated errors, and nothing
unsure is advised.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

import lfcal
from data_synth import Camera, tracing
from lfcal.assessment.alignment import measure_alignment
from lfcal.assessment.findings import Seen, find_tilt
from lfcal.assessment.light_findings import find_exposure, find_range
from lfcal.cli.main import main


@pytest.fixture(scope="module")
def tilted():
    """A ray-traced camera turned by 0.7 degrees, with a gap of 12 %, whose sensor is farther away
    to the right.
    """
    camera = Camera.design(
        (380, 280), 15.3, rotation=0.7, focus=0.15, fill=0.8, microimage_fill=0.88, focal_length=20
    )
    camera = camera.replace(sensor_tilt=(np.radians(0.5), 0.0))
    light = tracing.sensor(
        np.zeros((0, 23)), np.zeros((1, 4), np.float32), (1.0,) * 3, camera, 8, 1
    )[..., 3]
    return camera, np.rint(50_000 * light / light.max()).astype(np.uint16)


@pytest.fixture(scope="module")
def assessed(tilted):
    camera, white = tilted
    return lfcal.assess(white, f_number=camera.mla_distance / camera.aperture)


def within(finding, truth):
    return abs(finding.value - truth) < 2 * finding.error


def test_rotation_tilt_gap_and_focus_are_recovered_within_twice_their_errors(tilted, assessed):
    camera, _ = tilted
    assert within(assessed.rotation, 0.7) and assessed.rotation.error < 0.01
    assert within(assessed.tilt, 0.5) and assessed.tilt.error < 0.07
    gap = 15.3 - 2 * camera.microimage_radius
    assert within(assessed.apertures, gap) and assessed.apertures.error < 0.1
    blur = camera.fill * 15.3 * 0.15
    assert within(assessed.distance, blur) and assessed.distance.error < 0.3


def test_advice_tells_which_way_to_turn(assessed):
    assert "degrees counter-clockwise as it looks on the flat" in assessed.rotation.advice
    assert "open the main lens to 0.8" in assessed.apertures.advice
    assert not any(
        one.advice
        for one in (assessed.vignetting, assessed.exposure, assessed.evenness, assessed.dirt)
    )


def test_a_tilt_is_advised_on_only_where_pitches_or_rims_confirm_it(assessed):
    camera = assessed.calibration
    alignment = measure_alignment(assessed.calibration)
    for error, advised in ((0.01, True), (1.0, False)):
        seen = Seen(
            None, camera, alignment._replace(gradient_error=error), assessed.microimages, f_number=4
        )
        found = find_tilt(seen)
        assert "farther from the array at the right of the flat" in found.verdict
        assert bool(found.advice) == advised


@pytest.fixture(scope="module")
def overlapping():
    """A white image whose microimages overlap by 6 %, and its calibration."""
    camera = Camera.design(size=(240, 200), pitch=16, microimage_fill=1.06, fill=0.4)
    light = tracing.sensor(
        np.zeros((0, 23)), np.zeros((1, 4), np.float32), (1.0,) * 3, camera, 8, 1
    )[..., 3]
    white = np.rint(20_000 * light / light.max()).astype(np.uint16)
    return white, replace(camera.calibration(), source="white", encoded=False)


def test_an_overlap_is_measured_in_the_light_of_both_lenses(overlapping):
    found = lfcal.assess(overlapping[0], calibration=overlapping[1])
    assert within(found.apertures, -0.06 * 16)
    assert "stop the main lens down to 1.06" in found.apertures.advice
    assert np.isnan(found.tilt.value)


def test_a_doubtful_calibration_gives_no_advice(overlapping):
    white, camera = overlapping
    found = lfcal.assess(white, calibration=replace(camera, confidence=0.7))
    assert not any(one.advice for one in found.findings.values())
    assert "doubtful (confidence 0.70)" in found.apertures.verdict


def test_of_a_scene_nothing_is_told_that_takes_a_white_image(house):
    camera = replace(house.truth.calibration, source="scene")
    found = lfcal.assess(house.flat, calibration=camera)
    assert np.isnan([found.tilt.value, found.apertures.value, found.dirt.value]).all()
    assert "white image" in found.apertures.verdict


def test_what_one_reason_keeps_from_being_measured_is_one_line(house):
    camera = replace(house.truth.calibration, source="scene")
    first, second = str(lfcal.assess(house.flat, calibration=camera)).splitlines()
    assert first.startswith("rotation  ")
    names = "tilt, distance, apertures, vignetting, exposure, evenness, dirt"
    assert second.startswith(f"{names}  not measured: this takes a white image")


def test_a_scene_tells_that_the_array_has_not_moved_and_leaves_depth_to_the_analysis(house):
    camera = replace(house.truth.calibration, source="scene")
    found = lfcal.assess(house.white, house.flat, calibration=camera).scene
    assert found["place"].advice == "" and np.isfinite(found["place"].value)
    assert "depth" not in found


def dim(brightest):
    """A flat of 16 bits with values up to the brightest."""
    ramp = np.linspace(0, brightest, 100)
    return np.tile(ramp, (100, 1)).astype(np.uint16)


def test_the_exposure_of_a_dim_scene_refers_to_a_range_that_is_known():
    scene = dim(2735)
    white = dim(38652)
    # Alone it could be three quarters of 12 bits or a twenty-fifth of 16.
    assert find_range([scene]) is None
    unknown = find_exposure(scene, find_range([scene]))
    assert (
        np.isnan(unknown.value)
        and "the brightest pixel is 2735; give --white-level" in unknown.verdict
    )
    # The white image of the sensor shows that it has all 16 bits.
    known = find_exposure(scene, find_range([white, scene]))
    assert (
        known.value == pytest.approx(100 * 2735 / 65535, rel=0.02) and "of 65535" in known.verdict
    )
    assert "expose up to 19 times longer" in known.advice
    stated = find_exposure(scene, find_range([scene], 4095))
    assert (
        stated.value == pytest.approx(66.8, rel=0.02)
        and stated.verdict == "of the largest value, 4095: well exposed"
    )
    clipped = np.minimum(dim(6000), 4095)
    assert "over-exposed" in find_exposure(clipped, find_range([clipped])).verdict


def test_the_evenness_is_that_of_the_light_that_the_page_draws(tilted, assessed):
    gain = assessed.calibration.gain_map
    lattice = assessed.calibration.lattice
    level = np.array([0.0, 0.2, 0.1])
    uneven = replace(assessed.calibration, gain_map=replace(gain, level=level))
    found = lfcal.assess(tilted[1], calibration=uneven)
    light = uneven.gain_map.light(lattice.field_place(lattice.centres()))
    assert found.evenness.value == pytest.approx(100 * (light.max() / light.min() - 1), rel=0.08)


def test_flats_of_two_sizes_are_refused(tilted, assessed):
    with pytest.raises(lfcal.FlatError, match="the scene is 380 x 200 px"):
        lfcal.assess(tilted[1], tilted[1][:200], calibration=assessed.calibration)


def test_the_command_writes_a_page_without_network_and_all_figures(overlapping, tmp_path):
    white, camera = overlapping
    tifffile.imwrite(tmp_path / "white.tif", white)
    camera.save(tmp_path / "camera.json")
    words = f"assess {tmp_path}/white.tif -c {tmp_path}/camera.json --json".split()
    words += ["-o", f"{tmp_path}/page.html"]
    result = CliRunner().invoke(main, words, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)["findings"]
    names = [
        "rotation",
        "tilt",
        "distance",
        "apertures",
        "vignetting",
        "exposure",
        "evenness",
        "dirt",
    ]
    assert list(found) == names and found["tilt"]["value"] is None
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    # Without dirt there is nothing to draw.
    drawn = [
        one for one in found.values() if one["value"] is not None and one["verdict"] != "clean"
    ]
    assert page.count("<svg") == len(drawn) and "src=" not in page and "@import" not in page


def test_the_page_draws_the_blur_of_each_lens_type(assessed, tmp_path):
    camera = replace(assessed.calibration, lens_blur=None)
    replace(assessed, calibration=camera).write_page(tmp_path / "plain.html")
    blur = lfcal.LensBlur(
        6.0,
        0.3,
        [0.1, 0.3],
        [0.01, 0.01],
        [-0.2, 0.0],
        [[1.8, 0.6], [3.0, 1.8]],
        0.1 * np.ones((2, 2)),
    )
    camera = replace(camera, lens_blur=blur)
    replace(assessed, calibration=camera).write_page(tmp_path / "blur.html")
    plain, drawn = (
        (tmp_path / name).read_text(encoding="utf-8") for name in ("plain.html", "blur.html")
    )
    assert drawn.count("<svg") == plain.count("<svg") + 1
    assert "type 2" in drawn and "blur [px]" in drawn
    # The heading tells the figure of one depth alone.
    rims = lfcal.LensBlur(6.0, 24.0, [0.1], [0.1], [0.0], [[0.6]], [[0.4]])
    camera = replace(camera, lens_blur=rims)
    replace(assessed, calibration=camera).write_page(tmp_path / "rims.html")
    text = (tmp_path / "rims.html").read_text(encoding="utf-8")
    assert text.count("<svg") == plain.count("<svg") and "Distance: rims blurred over" in text


def test_a_tilt_that_is_not_seen_has_no_arrow_and_bars_show_whole_values(assessed, monkeypatch):
    from matplotlib.figure import Figure

    from lfcal.assessment.page import _draw_tilt

    for value, arrows in ((0.001, 0), (1.0, 1)):
        figure = Figure()
        axes = figure.subplots()
        _draw_tilt(axes, replace(assessed, tilt=replace(assessed.tilt, value=value, error=0.01)))
        assert len(axes.texts) == arrows
        figure.draw_without_rendering()
        assert figure.axes[1].yaxis.get_offset_text().get_text() == ""


def test_a_value_that_rounds_to_zero_has_no_sign():
    assert lfcal.Finding(-1e-6, 0.0007, "degrees", "").measured == "0.0000 +- 0.0007 degrees"
