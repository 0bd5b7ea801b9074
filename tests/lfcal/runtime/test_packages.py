"""Optional packages are named with a command that installs them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from lfcal import FlatError
from lfcal.runtime import packages
from lfcal.runtime.packages import check_package, import_package, missing_package

ROOT = Path(packages.__file__).parents[2]


def test_the_command_names_the_package_with_the_version_of_the_metadata(monkeypatch):
    wanted = "the mesh needs the package 'trimesh': pip install 'trimesh>=4.5'"
    assert missing_package("trimesh", "the mesh needs") == wanted
    monkeypatch.setattr(packages, "requires", lambda name: None)
    assert missing_package("trimesh", "the mesh needs").endswith("pip install 'trimesh'")


def test_a_missing_package_is_an_error_of_the_wanted_kind():
    check_package("numpy", "this needs", FlatError)
    assert import_package("os.path", "this needs", FlatError)
    for check in (check_package, import_package):
        with pytest.raises(FlatError, match="this needs the package 'no_such_package'"):
            check("no_such_package", "this needs", FlatError)


def test_no_message_names_an_extra_of_the_project():
    """A registry does not have the project, so that `pip install 'lfrender[mesh]'` would fail."""
    sources = [path for name in ("lfcal", "lfrender") for path in (ROOT / name).rglob("*.py")]
    named = [path for path in sources if re.search(r"install '?lfrender", path.read_text("utf-8"))]
    assert named == []
