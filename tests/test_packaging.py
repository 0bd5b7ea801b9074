"""What a package index and a user of the installed programs expect."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.mark.parametrize(
    "package, program",
    [("lfcal", "lfcal"), ("lfrender", "lfrender"), ("data_synth.cli", "lfsynth")],
)
def test_packages_run_as_modules_and_tell_their_version(package, program):
    done = subprocess.run(
        [sys.executable, "-m", package, "--version"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"{program}, version ")


def test_recipe_for_conda_needs_what_the_project_needs():
    recipe = (ROOT / ".ci" / "conda" / "meta.yaml").read_text(encoding="utf-8")
    run = recipe.partition("  run:\n")[2].partition("\n\n")[0]
    for need in PROJECT["dependencies"]:
        name, bound = need.split(">=")
        name = {"opencv-contrib-python-headless": "opencv", "matplotlib": "matplotlib-base"}.get(
            name, name
        )
        assert f"    - {name} >={bound}" in run, need


def test_citation_names_the_license_and_the_title():
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert (
        citation.startswith("cff-version: 1.2.0") and f"license: {PROJECT['license']}" in citation
    )


def test_extras_are_named_by_the_errors_that_ask_for_them():
    """An extra that an error message names can be installed."""
    import re

    named = set()
    for package in ("lfcal", "lfrender"):
        for source in (ROOT / package).rglob("*.py"):
            named |= set(re.findall(r"lfrender\[(\w+)\]", source.read_text(encoding="utf-8")))
    assert named <= set(PROJECT["optional-dependencies"])


def test_the_lowest_versions_are_those_of_the_project():
    done = subprocess.run(
        [sys.executable, ROOT / ".ci" / "lowest.py"], capture_output=True, text=True, check=True
    )
    named = done.stdout.split()
    assert [line.partition(",")[0] for line in named] == PROJECT["dependencies"]
    assert "scipy>=1.12,<1.12.1" in named
    assert "lowest_versions" in (ROOT / ".ci" / "run").read_text(encoding="utf-8")
