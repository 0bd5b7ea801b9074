"""The table of picture formats: what each use accepts, and what the errors name."""

from __future__ import annotations

import pytest

from lfcal import OutputError
from lfcal.runtime import packages
from lfrender.output.formats import FORMATS, PictureError, check_format


@pytest.mark.parametrize("use", ["picture", "animation", "film"])
def test_each_use_accepts_exactly_its_suffixes_and_names_them(tmp_path, use):
    accepted = {suffix for suffix, kind in FORMATS.items() if getattr(kind, use)}
    assert accepted
    for suffix in FORMATS:
        if suffix in accepted:
            check_format(tmp_path / f"file{suffix}", use)
        else:
            with pytest.raises(OutputError, match="unknown output format") as error:
                check_format(tmp_path / f"file{suffix}", use)
            assert all(one in str(error.value) for one in accepted)


def test_a_missing_package_is_named_with_the_command_that_installs_it(tmp_path, monkeypatch):
    monkeypatch.setattr(packages, "find_spec", lambda name: None)
    with pytest.raises(PictureError, match=r"the package 'OpenEXR': pip install 'OpenEXR>="):
        check_format(tmp_path / "file.exr", "picture")
