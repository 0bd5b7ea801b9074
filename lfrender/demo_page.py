"""The page of the demo: pictures and figures in one HTML file that needs nothing else."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from html import escape
from importlib.metadata import version
from pathlib import Path
from string import Template
from typing import Any

__all__ = ["write_page"]

_PICTURES = {
    "all_in_focus": "all in focus",
    "telescopic": "one patch size, telescopic",
    "binocular": "one patch size, binocular",
}


def write_page(path: Path, figures: Mapping[str, Any], pictures: Mapping[str, bytes]) -> None:
    """Write the demo's HTML page.

    Parameters
    ----------
    path : Path
        The file to write.
    figures : mapping
        What `run_demo` measured.
    pictures : mapping of str to bytes
        PNG files by the names the template uses; they go into the page itself.
    """
    template = Template(Path(__file__).with_name("demo.html").read_text(encoding="utf-8"))
    embedded = {name: "data:image/png;base64," + base64.b64encode(data).decode() for name, data in pictures.items()}
    width, height = figures["flat_size"]
    page = template.substitute(
        embedded,
        width=width,
        height=height,
        lenses=f"{figures['lenses']:,}",
        pitch=f"{figures['pitch']:.2f}",
        telescopic_size=f"{figures['fixed_patch_size']['telescopic']:+.2f}",
        binocular_size=f"{figures['fixed_patch_size']['binocular']:+.2f}",
        cards=_cards(figures),
        pictures=_rows(
            (_PICTURES[name], _decibel(m["psnr"]), f"{m['ssim']:.3f}") for name, m in figures["merit"].items()
        ),
        calibrations=_rows(
            (
                f"from the {kind} image" if kind == "white" else "from the capture itself",
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
        seconds=_rows((name, f"{seconds:.2f}") for name, seconds in figures["seconds"].items()),
        version=version("lfrender"),
    )
    path.write_text(page, encoding="utf-8")


def _cards(figures: Mapping[str, Any]) -> str:
    best, fixed = figures["merit"]["all_in_focus"], [figures["merit"][name] for name in ("telescopic", "binocular")]
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
