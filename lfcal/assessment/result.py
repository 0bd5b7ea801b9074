"""Results of an assessment: findings with errors, verdicts and advice."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..camera.calibration import Calibration
from ..runtime.page import html_table

__all__ = ["SURE", "Assessment", "Finding"]

# [standard errors] A smaller value counts as zero.
SURE = 2.0


@dataclass(frozen=True)
class Finding:
    """One thing that was measured.

    Parameters
    ----------
    value, error : float
        In `unit`, and its standard error; NaN where it was not measured. Counts have no error: 0.
    unit : str
    verdict : str
        What that means, in words.
    advice : str
        What to turn or to change; empty where nothing is to be done, or nothing is sure enough.
    details : dict
        Further figures.

    Examples
    --------
    >>> from lfcal import Finding
    >>> print(Finding(0.68, 0.001, "degrees", "rows are turned clockwise", "turn them back"))
    0.6800 +- 0.0010 degrees: rows are turned clockwise; turn them back
    """

    value: float
    error: float
    unit: str
    verdict: str
    advice: str = ""
    details: Mapping[str, Any] = field(default_factory=dict)

    @property
    def measured(self) -> str:
        """Value, error and unit as text, the error with two digits; empty where not measured."""
        if not np.isfinite(self.value):
            return ""
        if not 0 < self.error < np.inf:
            return f"{self.value:.4g} {self.unit}"
        digits = int(np.clip(1 - np.floor(np.log10(self.error)), 0, 4))
        return f"{self.value:z.{digits}f} +- {self.error:.{digits}f} {self.unit}"

    @property
    def is_seen(self) -> bool:
        """Whether the value is surely not zero."""
        return abs(self.value) > SURE * self.error

    def __str__(self) -> str:
        advice = ""
        if self.advice:
            advice = f"; {self.advice}"
        return (f"{self.measured}: " if self.measured else "") + self.verdict + advice


@dataclass(frozen=True, eq=False)
class Assessment:
    """How an array is mounted and lit, as `assess` finds it; `print` shows a line per finding.

    Parameters
    ----------
    rotation : Finding
        [degrees] of the rows of lenses from those of pixels, positive clockwise on the flat.
    tilt : Finding
        [degrees] of the sensor against the array; without an f-number, per f-number of the main
        lens.
    distance : Finding
        [px] diameter of the discs that the rims of microimages are blurred over: 0 with the sensor
        in the focal plane.
    apertures : Finding
        [px] gap between neighbouring microimages, negative for an overlap.
    vignetting : Finding
        [px] that the main lens cuts off the microimages in the corners.
    exposure : Finding
        [%] of the largest value that pixels can have, which the verdict names, that bright pixels
        have.
    evenness : Finding
        [%] by which one side is brighter than the other.
    dirt : Finding
        Specks and dead lenses.
    scene : dict of str to Finding
        What a scene shows; empty without one.
    calibration : Calibration
        That was measured on the white image.

    Examples
    --------
    >>> import lfcal, lfrender
    >>> sample = lfrender.data.house(size=(400, 300), samples=2)
    >>> found = lfcal.assess(sample.white)
    >>> abs(found.rotation.value) < 0.1, found.rotation.advice
    (True, '')
    """

    rotation: Finding
    tilt: Finding
    distance: Finding
    apertures: Finding
    vignetting: Finding
    exposure: Finding
    evenness: Finding
    dirt: Finding
    calibration: Calibration
    scene: Mapping[str, Finding] = field(default_factory=dict)
    #: `MicroimageField`, None where they cannot be measured.
    microimages: Any = field(default=None, repr=False)
    #: (256,) pixels of the white image over 256 levels up to the largest value.
    histogram: NDArray[np.int64] = field(
        default_factory=lambda: np.zeros(256, np.int64), repr=False
    )

    @property
    def findings(self) -> dict[str, Finding]:
        """All findings by their names."""
        own = {one.name: getattr(self, one.name) for one in fields(self)[:8]}
        return own | {f"scene, {name}": finding for name, finding in self.scene.items()}

    def grouped(self) -> list[tuple[str, Finding]]:
        """All findings by their names.

        Findings that were not measured for one and the same reason form one entry with all their
        names.
        """
        groups: dict[str, tuple[list[str], Finding]] = {}
        for name, finding in self.findings.items():
            key = finding.verdict
            if finding.measured:
                key = name
            groups.setdefault(key, ([], finding))[0].append(name)
        return [(", ".join(names), finding) for names, finding in groups.values()]

    def __str__(self) -> str:
        lines = self.grouped()
        width = max(len(name) for name, finding in lines if finding.measured or "," not in name) + 2
        return "\n".join(f"{name:{width - 2}}  {finding}" for name, finding in lines)

    def _repr_html_(self) -> str:
        return html_table("Assessment", {name: str(finding) for name, finding in self.grouped()})

    def to_dict(self) -> dict[str, Any]:
        """All findings as plain numbers and strings, NaN where not measured."""
        return {name: vars(finding) for name, finding in self.findings.items()}

    def write_page(self, path: str | os.PathLike[str], title: str = "Microlens array") -> None:
        """Write verdicts and a drawing of each finding as one HTML page that needs no network."""
        from .page import write_assessment

        write_assessment(path, self, title)
