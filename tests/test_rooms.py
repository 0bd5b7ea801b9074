"""The house keeps its order: small folders, each of which says what it computes."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = sorted(
    path.parent
    for package in ("lfcal", "lfrender", "data_synth")
    for path in (ROOT / package).rglob("__init__.py")
)
LARGEST_ROOM = 12  # modules
MOST_ARGUMENTS = 16
# Kernels that take more, each with the reason beside it in the source.
MANY_ARGUMENTS = {"_fit_pair"}


@pytest.mark.parametrize("room", ROOMS, ids=lambda room: str(room.relative_to(ROOT)))
def test_a_folder_holds_at_most_twelve_modules_and_says_what_it_computes(room):
    assert len([path for path in room.glob("*.py") if path.name != "__init__.py"]) <= LARGEST_ROOM
    assert ast.get_docstring(ast.parse((room / "__init__.py").read_text(encoding="utf-8")))


@pytest.mark.parametrize("room", ROOMS, ids=lambda room: str(room.relative_to(ROOT)))
def test_kernels_take_at_most_sixteen_arguments(room):
    for path in room.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef) and any(
                "njit" in ast.unparse(d) for d in node.decorator_list
            ):
                assert len(node.args.args) <= MOST_ARGUMENTS or node.name in MANY_ARGUMENTS, (
                    f"{path}: {node.name}"
                )
