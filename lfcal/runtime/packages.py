"""Optional packages: whether one is installed, and the command that installs it."""

from __future__ import annotations

import re
from contextlib import suppress
from importlib import import_module
from importlib.metadata import PackageNotFoundError, requires
from importlib.util import find_spec
from typing import Any

from .errors import LightFieldError

__all__ = ["check_package", "import_package", "missing_package"]


def missing_package(package: str, need: str) -> str:
    """The sentence about a package that is not installed.

    It names the package itself, with the version that the metadata of this project ask for, and no
    extra of the project: that command works wherever the project was installed from.

    Examples
    --------
    >>> missing_package("trimesh", "scene.glb: .glb files need")
    "scene.glb: .glb files need the package 'trimesh': pip install 'trimesh>=4.5'"
    """
    wanted = package
    with suppress(PackageNotFoundError):
        for line in requires("lfrender") or ():
            if re.match(rf"{package}\b", line):
                wanted = line.partition(";")[0]
    return f"{need} the package '{package}': pip install '{wanted}'"


def check_package(package: str, need: str, kind: type[LightFieldError]) -> None:
    """Raise an error of this kind if a package is not installed; it is not imported.

    `need` begins the sentence of `missing_package`.
    """
    if find_spec(package) is None:
        raise kind(missing_package(package, need))


def import_package(name: str, need: str, kind: type[LightFieldError]) -> Any:
    """A package, or a module of it; an error of this kind if it is not installed.

    `need` begins the sentence of `missing_package`.
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise kind(missing_package(name.partition(".")[0], need)) from error
