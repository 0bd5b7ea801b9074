"""Figures that differ between two runs: `python -m benchmarks compare BEFORE.json AFTER.json`."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["differences", "main"]

# Times vary by so much from run to run on a busy machine; errors are the same whatever the machine
# does.
_SLOWER = 1.3
_WORSE = 1.02
# Differences below this do not matter: px, shares, dB.
_FLOOR = 2e-3
_MORE_IS_BETTER = ("PSNR dB", "SSIM")


def differences(before: dict[str, Any], after: dict[str, Any]) -> tuple[list[str], list[str]]:
    """Lines about worse figures in `after`, and about better ones."""
    old = {(row["stage"], row["method"], row["case"]): row for row in before["rows"]}
    worse = []
    better = []
    for row in after["rows"]:
        key = (row["stage"], row["method"], row["case"])
        earlier = old.pop(key, None)
        if earlier is None:
            continue
        name = ", ".join(key)
        for figure, value in [("remaps", row["remaps"]), *row["errors"].items()]:
            was = earlier["remaps"] if figure == "remaps" else earlier["errors"].get(figure, np.nan)
            ratio = _SLOWER if figure == "remaps" else _WORSE
            line = f"{name}: {figure} {was:.4g} -> {value:.4g}"
            low, high = (value, was) if figure in _MORE_IS_BETTER else (was, value)
            if high > low * ratio and high - low > _FLOOR:
                worse.append(line)
            elif low > high * ratio and low - high > _FLOOR:
                better.append(line)
        if earlier["errors"] and not row["errors"]:
            worse.append(f"{name}: no answer any more ({row['note']})")
    worse += [f"{', '.join(key)}: not measured any more" for key in old]
    return worse, better


def main(arguments: list[str]) -> None:
    """Print both lists; exit with 1 if a figure is worse."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks compare", description=__doc__)
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    options = parser.parse_args(arguments)
    before, after = (
        json.loads(path.read_text(encoding="utf-8")) for path in (options.before, options.after)
    )
    worse, better = differences(before, after)
    for title, lines in (("worse", worse), ("better", better)):
        print(f"{len(lines)} {title}")
        for line in lines:
            print(f"  {line}")
    sys.exit(bool(worse))
