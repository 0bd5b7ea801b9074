"""No wrong value of a camera file passes, and each error names the field."""

from __future__ import annotations

import copy
from dataclasses import fields

import pytest

import lfcal
from lfcal.camera.calibration import Calibration
from lfcal.camera.evidence import Evidence
from lfcal.camera.lens_types import LensBlur
from lfcal.gain.gain_map import GainMap

_MANY_DIGITS = 10**400
_OPTICS = {
    "focal_length_mm": 50,
    "mla_distance_mm": 58,
    "sensor_distance_mm": 0.7,
    "pixel_mm": 0.005,
}
_BLUR = LensBlur(6.0, 1.2, [0.1], [0.1], [0.0], [[0.6]], [[0.2]]).to_dict()
_FIGURES = {figure.name: 0.5 for figure in fields(Evidence)}


@pytest.fixture(scope="module")
def data():
    lattice = lfcal.Lattice([10, 12], [[20, 0], [0, 20]], (2048, 1500), 9.5)
    types = lfcal.LensTypes([[0, 1], [1, 0]])
    gain = GainMap.round([1.0, 0.9, 0.4], 4.0, 9.5)
    return Calibration(lattice, gain_map=gain, lens_types=types).to_dict()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("image_size", [2048.5, 1500]),
        ("image_size", [2048, -1500]),
        ("image_size", [2048]),
        ("lattice.basis", [[1e9, 0], [0, 1e9]]),
        ("lattice.basis", [[3000, 0], [0, 3000]]),
        ("lattice.basis", [[20, 0], [40, 0]]),
        ("lattice.basis", [[20, 0], [20, 0.001]]),
        ("lattice.basis", [[20, 0]]),
        ("lattice.pitch", 35.0),
        ("gain_map.radius", 1e4),
        ("vignetting", {"step": 1e3, "profile": [1.0, 0.5]}),
        ("lattice.radius", 1e6),
        ("lattice.radius", 60.0),
        ("lattice.radius", 0),
        ("lattice.radius", 0.5),
        ("lattice.radius", "9.5"),
        ("lattice.origin", [float("nan"), 12.0]),
        ("lattice.origin", [None, 12.0]),
        ("lattice.distortion", {"centre": [0, 0], "k1": 5.0, "k2": 0.0, "reach": 1000.0}),
        ("lattice.distortion", {"centre": [0, 0], "k1": 0.01, "k2": 0.0, "reach": 1e-3}),
        ("fit.confidence", 1.5),
        ("fit.confidence", True),
        ("fit.confidence", float("nan")),
        ("fit.lenses_used", 3.5),
        ("fit.residual_rms", -1.0),
        ("mosaic", "RGBG"),
        ("source", 7),
        ("warnings", "none"),
        ("white_level", 0),
        ("gain_map.step", -1.0),
        ("gain_map.profile", "no block"),
        ("vignetting", {"step": 1.0, "profile": []}),
        ("vignetting", {"step": 1.0, "profile": [1.0, float("inf")]}),
        ("errors", {"names": ["origin"], "covariance": "none"}),
        ("optics", [1]),
        ("lens_blur", {"aperture": 5.0}),
        ("vignetting", {}),
        ("source", "\ud800"),
        ("warnings", ["\ud800"]),
        ("fit.lenses_used", _MANY_DIGITS),
        ("lattice.origin", [_MANY_DIGITS, 0]),
        ("lattice.distortion", {}),
        ("lattice.distortion", {"centre": [0, 0], "k1": _MANY_DIGITS, "k2": 0, "reach": 1000}),
        ("gain_map.step", _MANY_DIGITS),
        ("gain_map.level", [None]),
        ("lens_types.cell", [[_MANY_DIGITS]]),
        ("lens_types.focus", [_MANY_DIGITS, 0]),
        ("errors", {"names": ["origin"], "covariance": [[_MANY_DIGITS]]}),
        ("optics", {**_OPTICS, "pupil_mm": _MANY_DIGITS}),
        ("optics", {**_OPTICS, "covariance": [[_MANY_DIGITS] * 14] * 14}),
        ("optics", {**_OPTICS, "focal_length_mm": 1e300}),
        ("lens_blur", {**_BLUR, "aperture": _MANY_DIGITS}),
        ("lens_blur", {**_BLUR, "discs": [[1e300]]}),
        ("evidence", {}),
        ("evidence", {**_FIGURES, "halves": None}),
        ("evidence", {**_FIGURES, "shape": _MANY_DIGITS}),
        ("evidence", {**_FIGURES, "light": 1e300}),
    ],
)
def test_wrong_value_is_refused_and_its_field_named(data, field, value):
    wrong = copy.deepcopy(data)
    *parents, last = field.split(".")
    inside = wrong
    for name in parents:
        inside = inside[name]
    inside[last] = value
    with pytest.raises(
        lfcal.CameraFileError, match=field.split(".")[0] + r".*calibrate again"
    ) as caught:
        Calibration.from_dict(wrong)
    # A message that cannot be encoded cannot be printed.
    assert len(str(caught.value).encode().splitlines()) == 1
    assert last in str(caught.value) or field == "lattice.basis" or field == "gain_map.profile"


@pytest.mark.parametrize(
    "field", ["lattice", "fit", "source", "warnings", "image_size", "vignetting"]
)
def test_missing_field_is_named(data, field):
    with pytest.raises(lfcal.CameraFileError, match=field):
        Calibration.from_dict({name: value for name, value in data.items() if name != field})


def test_halves_to_which_no_lattice_fits_differ_by_infinity(data):
    evidence = {**_FIGURES, "halves": float("inf"), "fit_halves": None}
    assert Calibration.from_dict({**data, "evidence": evidence}).evidence.halves == float("inf")


def test_right_fields_pass(data):
    assert Calibration.from_dict(data).gain_map.radius == 9.5
