"""The part of the demo's page that compares with the truth; the rest of it is the report of the capture."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from importlib.resources import files
from string import Template
from typing import Any

__all__ = ["truth_section"]

_PICTURES = {
    "all_in_focus": "all in focus",
    "telescopic": "one patch size, telescopic",
    "binocular": "one patch size, binocular",
}


def truth_section(figures: Mapping[str, Any], flat_crop: str, reference: str) -> str:
    """HTML of the comparison with the truth.

    Parameters
    ----------
    figures : mapping
        What `run_demo` measured.
    flat_crop, reference : str
        Data URLs of pictures.
    """
    template = Template((files(__package__) / "assets" / "demo.html").read_text(encoding="utf-8"))
    return template.substitute(
        flat_crop=flat_crop,
        reference=reference,
        cards=_cards(figures),
        pictures=_rows(
            (_PICTURES[name], _decibel(m["psnr"]), f"{m['ssim']:.3f}") for name, m in figures["merit"].items()
        ),
        calibrations=_rows(
            (
                f"the {kind} image" if kind == "white" else "the capture itself",
                f"{c['centre_error']:.4f} px",
                f"{c['confidence']:.2f}",
            )
            for kind, c in figures["calibration"].items()
        ),
        judged=f"{figures['lenses_judged']:,}",
        depths=_rows(
            (label, *(f"{figures[name][key]:{form}}" for key in ("all", "one_depth")))
            for name, label, form in (
                ("mode_right", "mode is right", ".1%"),
                ("mode_wrong", "mode is the opposite one", ".1%"),
                ("magnification_error", "M, median relative error (unresolved: 1)", ".2%"),
            )
        ),
    )


def _cards(figures: Mapping[str, Any]) -> str:
    best, fixed = figures["merit"]["all_in_focus"], [figures["merit"][name] for name in figures["fixed_patch_size"]]
    cards = {
        "all in focus": _decibel(best["psnr"]),
        "better than the best single patch size": _decibel(best["psnr"] - max(m["psnr"] for m in fixed)),
        "modes right, lenses that see one depth": f"{figures['mode_right']['one_depth']:.1%}",
        "error of M, median, all lenses": f"{figures['magnification_error']['all']:.1%}",
        "centres off, from the capture alone": f"{figures['calibration']['scene']['centre_error']:.3f} px",
    }
    return "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in cards.items())


def _rows(rows: Any) -> str:
    return "".join("<tr>" + "".join(f"<td>{escape(str(cell))}</td>" for cell in row) + "</tr>" for row in rows)


def _decibel(value: float) -> str:
    return f"{value:.1f} dB"
