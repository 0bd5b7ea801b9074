"""Threads do not stay awake for long between kernels, unless the environment says so."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [("NOTHING", "", "20000"), ("GOMP_SPINCOUNT", "7", "7"), ("OMP_WAIT_POLICY", "active", "None")],
)
def test_the_environment_says_how_long_threads_wait(name, value, expected):
    environment = {k: v for k, v in os.environ.items() if k not in ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY")}
    code = "import os, lfcal; print(os.environ.get('GOMP_SPINCOUNT'))"
    run = subprocess.run(
        [sys.executable, "-c", code], env={**environment, name: value}, capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == expected
