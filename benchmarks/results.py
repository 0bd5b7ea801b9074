"""Measure the figures of docs/results.md and print its tables: `python -m benchmarks.results SHARED`.

The figures of captures and ray-traced flats are measured anew in one run and kept, with their date
and machine, in `benchmarks/results.json`. Without SHARED the tables are printed from this file.
"""

from __future__ import annotations

import json
import platform
import sys
from datetime import date
from pathlib import Path
from typing import Any

from . import real_captures, truth_flats

PAGE = Path(__file__).parents[1] / "docs" / "results.md"
_FIGURES = Path(__file__).with_suffix(".json")
#: Captures and flats by the name of their file, and what the page calls them.
_CAPTURES = {
    "Fujita2.png": "Fujita2, Raytrix R5, 4 megapixels",
    "TempleBoatGiantR32.webp": "TempleBoatGiantR32, Raytrix R32, 31 megapixels",
    "Boys2.webp": "Boys2, one focus, 12 megapixels",
    "MiniGarden2.webp": "MiniGarden2, one focus, 12 megapixels",
}
_FLATS = {
    "s3_r5": "s3_r5, house behind branches, both modes",
    "s2_sq": "s2_sq, one plane, square lattice",
    "s4b_tspc": "s4b_tspc, slanted plane",
    "s5b_tspc": "s5b_tspc, clutter",
}

# Heads of the tables.
_MODES = (
    "| capture | lenses with texture: right mode / unresolved / wrong |",
    "|---|---|",
)
_TRUTH = (
    "| flat | centres, RMS | modes right, lenses of one depth / all | `s`, median / 95 % error "
    "| PSNR at 0.15 D / 0.3 D / default scale |",
    "|---|---|---|---|---|",
)
_TIMES = (
    "| capture | `calibrate` | `analyze` | `render` |",
    "|---|---|---|---|",
)


def measure(shared: Path) -> dict[str, Any]:
    """All figures, with date and machine."""
    captures = {}
    for name in _CAPTURES:
        captures[name] = real_captures.measure(shared / "captures" / name, "balanced")
    flats = {}
    for name in _FLATS:
        flats[name] = truth_flats.measure(shared / "truth" / name, "balanced")
    machine = f"{platform.machine()}, Python {platform.python_version()}"
    return {
        "date": date.today().isoformat(),
        "machine": machine,
        "captures": captures,
        "flats": flats,
    }


def tables(figures: dict[str, Any]) -> dict[str, str]:
    """The tables of the page by their names."""
    modes = []
    times = []
    for name, told in _CAPTURES.items():
        found = figures["captures"][name]
        open_share = 1 - found["right"] - found["wrong"]
        shares = " / ".join(
            f"{100 * share:.1f}" for share in (found["right"], open_share, found["wrong"])
        )
        modes.append(f"| {told} | {shares} % |")
        seconds = " | ".join(f"{value:.2g} s" for value in found["cpu"])
        times.append(f"| {told.partition(',')[0]} | {seconds} |")
    truth = []
    for name, told in _FLATS.items():
        found = figures["flats"][name]
        psnr = " / ".join(f"{value:.1f}" for value in found["psnr"])
        truth.append(
            f"| {told} | {found['centres']:.3f} px | {100 * found['modes']:.1f} / "
            f"{100 * found['all_modes']:.1f} % | {found['median']:.3f} / {found['most']:.3f} px "
            f"| {psnr} dB |"
        )
    return {
        "modes": "\n".join([*_MODES, *modes]),
        "truth": "\n".join([*_TRUTH, *truth]),
        "times": "\n".join([*_TIMES, *times]),
        "date": f"Measured in one run on {figures['date']} ({figures['machine']}).",
    }


def page_with(figures: dict[str, Any], page: str) -> str:
    """The page with the tables of these figures in place of those between its marks."""
    for name, table in tables(figures).items():
        before, mark, rest = page.partition(f"<!-- {name} -->\n\n")
        _, end, after = rest.partition("<!-- end -->")
        page = f"{before}{mark}{table}\n\n{end}{after}"
    return page


if __name__ == "__main__":
    if sys.argv[1:]:
        measured = measure(Path(sys.argv[1]))
        _FIGURES.write_text(json.dumps(measured, indent=1) + "\n", encoding="utf-8")
    kept = json.loads(_FIGURES.read_text(encoding="utf-8"))
    PAGE.write_text(page_with(kept, PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    print(*tables(kept).values(), sep="\n\n")
