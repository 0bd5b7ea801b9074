"""Constraints for pip: the lowest versions that pyproject.toml allows, `python .ci/lowest.py >
constraints.txt`.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))[
    "project"
]


def lowest(requirement: str) -> str:
    """`numpy>=1.26` as `numpy>=1.26,<1.26.1`: the first release with that number, however many
    parts it has.
    """
    name, bound = re.fullmatch(r"([\w-]+)>=([\d.]+)", requirement).groups()
    return f"{name}>={bound},<{bound}.1"


if __name__ == "__main__":
    print("\n".join(map(lowest, PROJECT["dependencies"])))
