"""Measure the figures of docs/results.md and print its tables: `python -m benchmarks.results SHARED
[GROUP ...]`.

All figures, or those of some groups, are measured and kept with their date and machine in
`benchmarks/results.json`. The page holds figures of one day: those of earlier days are dropped when
one is measured on another. Without SHARED the page is written from the file.
"""

from __future__ import annotations

import json
import platform
import sys
import tempfile
from collections.abc import Callable
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

import lfcal

from . import (
    large_flats,
    metric_boards,
    random_scenes,
    real_captures,
    reliability,
    truth_flats,
    volumes,
)
from .lattices.__main__ import SEEDS, judge
from .lattices.judgement import RIGHT

__all__ = ["GROUPS", "PAGE", "page_with", "tables"]

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
#: Random flats: their set, the number of them, and what the page calls them.
_LATTICES = {
    "cameras": (24, "cameras of all kinds, from one scene each"),
    "rays": (12, "ray-traced cameras, from one scene each"),
    "no-flats": (24, "pictures that are no flats"),
}
# Random scenes, rays per pixel of them, and ranges of the confidence that are told.
_SCENES = 20
_RAYS = 64
_RANGES = ((0.99, 1.0), (0.9, 0.99), (0.5, 0.9))
# The large flat: its size and pitch [px].
_LARGE = (10_000, 10_000)
_LARGE_PITCH = 75.0


def _measure_captures(shared: Path) -> dict[str, Any]:
    found = {}
    for name in _CAPTURES:
        path = shared / "captures" / name
        found[name] = real_captures.measure(path, "balanced")
        found[name]["fast"] = real_captures.measure(path, "fast")["cpu"][1]
        with tempfile.TemporaryDirectory() as folder:
            words = ("lfrender", "render", str(path), "-o", str(Path(folder, "picture.tif")))
            command = large_flats.measure_command(name, *words)
        found[name]["command"] = {"cpu": command["cpu"], "gib": command["gib"]}
    return found


def _measure_flats(shared: Path) -> dict[str, Any]:
    return {name: truth_flats.measure(shared / "truth" / name, "balanced") for name in _FLATS}


def _measure_scenes(_shared: Path) -> dict[str, Any]:
    wanted = within = 0.0
    judged = []
    for seed in range(_SCENES):
        _, capture = random_scenes.draw(seed, _RAYS)
        found = random_scenes.judge(capture)
        wanted += found.wanted
        within += found.within / _SCENES
        truth = capture.truth
        centres = truth.calibration.lattice.centres()
        compared = (capture.flat, centres, truth.patch_size, truth.mixed)
        judged.append(reliability.compare(*compared))
    confidence, right = (np.concatenate(part) for part in zip(*judged, strict=True))
    ranges = []
    for low, high in _RANGES:
        among = (confidence >= low) & (confidence <= high)
        ranges.append([low, high, float(confidence[among].mean()), float(right[among].mean())])
    return {"scenes": _SCENES, "wanted": int(wanted), "within": within, "ranges": ranges}


def _measure_lattices(_shared: Path) -> dict[str, Any]:
    return {name: judge(SEEDS[name](0, count)) for name, (count, _) in _LATTICES.items()}


def _measure_whites(shared: Path) -> dict[str, Any]:
    """RMS distances of the centres of white images from the true ones [px]."""
    errors = []
    files = sorted((shared / "whites").glob("w*.png"))
    for path in files:
        true = np.load(path.with_suffix(".npz"))["centre_px"]
        lattice = lfcal.calibrate(lfcal.read_flat(path), kind="white").lattice
        away, _ = cKDTree(true).query(lattice.centres())
        errors.append(float(np.sqrt((away**2).mean())))
        if errors[-1] > RIGHT * lattice.pitch:
            print(f"WRONG {path.name}: {errors[-1]:.3f} px")
    return {"errors": errors}


def _measure_metres(shared: Path) -> dict[str, Any]:
    return metric_boards.ray_traced(shared / "boards")


def _measure_volumes(shared: Path) -> dict[str, Any]:
    return volumes.measure(shared / "captures", "GUV")


def _measure_large(_shared: Path) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        steps = ["fixed", "calibrate", "analyze", "sharp"]
        found = large_flats.run(Path(folder), _LARGE, _LARGE_PITCH, steps)
    return {step: {"cpu": one["cpu"], "gib": one["gib"]} for step, one in found.items()}


#: What is measured: functions of the folder SHARED.
GROUPS: dict[str, Callable[[Path], dict[str, Any]]] = {
    "captures": _measure_captures,
    "flats": _measure_flats,
    "scenes": _measure_scenes,
    "lattices": _measure_lattices,
    "whites": _measure_whites,
    "metres": _measure_metres,
    "volumes": _measure_volumes,
    "large": _measure_large,
}


def _table(*lines: str) -> str:
    head, *rows = lines
    return "\n".join([head, "|---" * (head.count("|") - 1) + "|", *rows])


def _show_captures(found: dict[str, Any]) -> dict[str, str]:
    modes = ["| capture | lenses with texture: right mode / unresolved / wrong |"]
    times = [
        "| capture | `calibrate` | `analyze`, `balanced` | `fast` | `render` "
        "| command `lfrender render` |"
    ]
    for name, told in _CAPTURES.items():
        one = found[name]
        shares = (one["right"], 1 - one["right"] - one["wrong"], one["wrong"])
        percent = " / ".join(f"{100 * share:.2f}" for share in shares)
        modes.append(f"| {told} | {percent} % |")
        calibrate, analyze, render = one["cpu"]
        seconds = " | ".join(f"{s:.2g} s" for s in (calibrate, analyze, one["fast"], render))
        command = f"{one['command']['cpu']:.2g} s, {one['command']['gib']:.1f} GiB"
        times.append(f"| {told.partition(',')[0]} | {seconds} | {command} |")
    return {"modes": _table(*modes), "times": _table(*times)}


def _show_flats(found: dict[str, Any]) -> dict[str, str]:
    lines = [
        "| flat | centres, RMS | modes right, lenses of one depth / all | `s`, median / 95 % error "
        "| PSNR at 0.15 D / 0.3 D / default scale | one patch size for all, nearest lens |"
    ]
    for name, told in _FLATS.items():
        one = found[name]
        psnr = " / ".join(f"{value:.1f}" for value in one["psnr"])
        lines.append(
            f"| {told} | {one['centres']:.3f} px | {100 * one['modes']:.1f} / "
            f"{100 * one['all_modes']:.1f} % | {one['median']:.3f} / {one['most']:.3f} px "
            f"| {psnr} dB | {one['one_patch_size']:.1f} dB |"
        )
    return {"truth": _table(*lines)}


def _show_scenes(found: dict[str, Any]) -> dict[str, str]:
    ranges = "; ".join(
        f"between {low:g} and {high:g}, {100 * right:.1f} % (stated {100 * stated:.1f} %)"
        for low, high, stated, right in found["ranges"]
    )
    return {
        "scenes": f"Of {found['scenes']} scenes, {found['wanted']} reach all four. "
        f"{100 * found['within']:.0f} % of the errors lie within their standard error. Right within "
        f"0.04 D are, of the lenses with a confidence {ranges}."
    }


def _show_lattices(found: dict[str, Any]) -> dict[str, str]:
    lines = ["| set | right | refused | wrong | of these, stated as sure |"]
    for name, (count, told) in _LATTICES.items():
        one = found[name]
        right = one["right"] if name != "no-flats" else ""
        wrong = f"{one['wrong']} | {one['sure']}"
        lines.append(f"| {count} {told} | {right} | {one['refused']} | {wrong} |")
    return {"lattices": _table(*lines)}


def _show_whites(found: dict[str, Any]) -> dict[str, str]:
    errors = sorted(found["errors"])
    middle = float(np.median(errors))
    return {
        "whites": f"On {len(errors)} white images by a program of others, with 18 to 40 dB of signal over "
        f"noise, centres are known to {errors[0]:.1g} to {errors[-1]:.1g} px, {middle:.1g} px in the "
        "median."
    }


def _show_metres(found: dict[str, Any]) -> dict[str, str]:
    return {
        "metres": f"Twelve ray-traced flats of a board give depth to {found['depth']:.2g} % of the "
        f"distance, and positions to {found['sideways']:.2g} mm, at most."
    }


def _show_volumes(found: dict[str, Any]) -> dict[str, str]:
    return {
        "volumes": f"The volume of a vesicle ([GUV](volumes.md#captures)) takes {found['cpu']:.2g} "
        "processor seconds."
    }


def _show_large(found: dict[str, Any]) -> dict[str, str]:
    steps = ("calibrate", "analyze", "sharp", "fixed")
    cells = (f"{found[step]['cpu']:.2g} s, {found[step]['gib']:.1f} GiB" for step in steps)
    head = "| `calibrate` | `analyze -c` | `render -c --depth` | one patch size |"
    return {"large": _table(head, f"| {' | '.join(cells)} |")}


_SHOWN: dict[str, Callable[[dict[str, Any]], dict[str, str]]] = {
    "captures": _show_captures,
    "flats": _show_flats,
    "scenes": _show_scenes,
    "lattices": _show_lattices,
    "whites": _show_whites,
    "metres": _show_metres,
    "volumes": _show_volumes,
    "large": _show_large,
}


def tables(figures: dict[str, Any]) -> dict[str, str]:
    """The tables and sentences of the page by their names."""
    told = f"All figures were measured on {figures['date']} ({figures['machine']})."
    shown = {"date": told}
    for name, show in _SHOWN.items():
        shown |= show(figures[name])
    return shown


def page_with(figures: dict[str, Any], page: str) -> str:
    """The page with the tables of these figures in place of those between its marks."""
    for name, table in tables(figures).items():
        before, mark, rest = page.partition(f"<!-- {name} -->\n\n")
        _, end, after = rest.partition("<!-- end -->")
        page = f"{before}{mark}{table}\n\n{end}{after}"
    return page


def _measure(shared: Path, groups: list[str]) -> None:
    """Measure groups, and keep each as soon as it is measured."""
    today = date.today().isoformat()
    for group in groups:
        found = GROUPS[group](shared)
        figures: dict[str, Any] = {}
        if _FIGURES.exists():
            figures = json.loads(_FIGURES.read_text(encoding="utf-8"))
        if figures.get("date") != today:
            figures = {"date": today}
        figures["machine"] = f"{platform.machine()}, Python {platform.python_version()}"
        figures[group] = found
        _FIGURES.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1:]:
        _measure(Path(sys.argv[1]), sys.argv[2:] or list(GROUPS))
    kept = json.loads(_FIGURES.read_text(encoding="utf-8"))
    if missing := set(GROUPS) - set(kept):
        sys.exit(f"not measured on {kept['date']}: {', '.join(sorted(missing))}")
    PAGE.write_text(page_with(kept, PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    print(*tables(kept).values(), sep="\n\n")
