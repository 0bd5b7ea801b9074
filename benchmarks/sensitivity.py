"""How much depends on each tuned number of the depth analysis: `python -m benchmarks.sensitivity [NAME] [SCENES]`.

Each number of the settings of `lfrender.depth` (or only of those whose name contains NAME) is multiplied by 0.7 and by
1.3, and so many random houses and scenes of clutter (`benchmarks.random_scenes`, from seed 3000 on) are analysed again.
Printed is how far the means over the scenes move: modes right, median and 95 % error of `s`, depth edges in place. The
last lines list the numbers that move nothing. Numbers that kernels have compiled in (constants of modules) are not
among them.
"""

from __future__ import annotations

import gc
import importlib
import pkgutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from itertools import count, islice

import numpy as np

import lfrender.depth
from lfcal import LightFieldError

from .random_scenes import draw, judge

__all__ = ["main", "moved", "tuned_numbers"]

_FIRST, _SCENES, _SAMPLES = 3000, 6, 32
_FACTORS = (0.7, 1.3)
# Scenes of one plane take a shortcut past most numbers.
_OCCLUDED = ("house", "clutter")
_FIGURES = ("right", "median", "most", "edges")
# Changes of the figures that are nothing: of a share of lenses, of errors [px], of a share of edges.
_NOTHING = np.array([2e-4, 2e-4, 2e-3, 1e-3])


def tuned_numbers() -> list[tuple[type, str]]:
    """Classes of settings of `lfrender.depth`, and the names of their numbers."""
    found = []
    for module in pkgutil.walk_packages(lfrender.depth.__path__, "lfrender.depth."):
        loaded = importlib.import_module(module.name)
        for kind in vars(loaded).values():
            if is_dataclass(kind) and isinstance(kind, type) and kind.__module__ == module.name:
                named = [f.name for f in fields(kind) if isinstance(f.default, (int, float)) and f.default is not True]
                found += [(kind, name) for name in named if kind.__name__.endswith("Settings")]
    return [entry for entry in found if getattr(*entry) is not False]


@contextmanager
def moved(kind: type, name: str, factor: float) -> Iterator[None]:
    """One number of all settings of a class times `factor`; whole numbers move by one at least."""
    instances = [entry for entry in gc.get_objects() if type(entry) is kind]
    before = [getattr(entry, name) for entry in instances]
    try:
        for entry, value in zip(instances, before, strict=True):
            new = value * factor
            if isinstance(value, int):
                new = max(round(new), value + 1) if factor > 1 else min(round(new), value - 1)
            object.__setattr__(entry, name, new)
        yield
    finally:
        for entry, value in zip(instances, before, strict=True):
            object.__setattr__(entry, name, value)


def main(arguments: list[str]) -> None:
    part = next((word for word in arguments if not word.isdecimal()), "")
    scenes = next((int(word) for word in arguments if word.isdecimal()), _SCENES)
    drawn = (draw(seed, _SAMPLES) for seed in count(_FIRST))
    captures = list(islice((capture for name, capture in drawn if name.startswith(_OCCLUDED)), scenes))

    def figures() -> np.ndarray:
        every = [judge(capture) for capture in captures]
        return np.array([np.mean([getattr(one, name) for one in every]) for name in _FIGURES])

    normal = figures()
    stated = (f"{name} {value:.4f}" for name, value in zip(_FIGURES, normal, strict=True))
    print("as it is: " + "  ".join(stated), flush=True)
    idle = []
    for kind, name in tuned_numbers():
        room = kind.__module__.removeprefix("lfrender.depth.").removesuffix("settings")
        label = f"{room}{kind.__name__.removesuffix('Settings')}.{name}"
        if part not in label:
            continue
        changes = []
        for factor in _FACTORS:
            with moved(kind, name, factor):
                try:
                    changes.append(figures() - normal)
                except (ValueError, ArithmeticError, LightFieldError) as error:
                    print(f"{label} times {factor}: {error}", flush=True)
                    changes.append(np.full(len(_FIGURES), np.nan))
        if all((np.abs(change) < _NOTHING).all() for change in changes):
            idle.append(label)
        rows = [" ".join(f"{value:+.4f}" for value in change) for change in changes]
        print(f"{label:48s} {'   '.join(rows)}", flush=True)
    print(f"{len(idle)} numbers move nothing: {', '.join(idle)}")


if __name__ == "__main__":
    main(sys.argv[1:])
