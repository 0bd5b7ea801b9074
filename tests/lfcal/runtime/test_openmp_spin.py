"""OpenMP threads spin briefly between kernels, unless the environment sets it."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [("NOTHING", "", "20000"), ("GOMP_SPINCOUNT", "7", "7"), ("OMP_WAIT_POLICY", "active", "None")],
)
def test_the_environment_overrides_the_spin_count(name, value, expected):
    environment = {k: v for k, v in os.environ.items() if k not in ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY")}
    code = "import os, lfcal; print(os.environ.get('GOMP_SPINCOUNT'))"
    run = subprocess.run(
        [sys.executable, "-c", code], env={**environment, name: value}, capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == expected
