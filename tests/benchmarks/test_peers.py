"""Other tools are found by what is installed, judged like ours, and cannot hold up a run."""

import sys

import numpy as np
import pytest

from benchmarks.pareto import peers
from benchmarks.pareto.peers import measure_peers, peers_of
from benchmarks.white_images import WhiteImage

_TOOL = """
import shutil, sys, time
if len(sys.argv) == 1:
    print('{"good": "1.0", "wrong": "2.0", "slow": "3.0", "broken": "4.0"}')
    sys.exit()
name, white, pitch, out = sys.argv[1:]
if name == "slow":
    time.sleep(60)
if name == "broken":
    raise ValueError("no grid found")
shutil.copy(FOLDER + f"/{name}.npy", out)
print("tells what it does\\n1.5")
"""


@pytest.fixture
def tools(tmp_path, monkeypatch):
    """Four tools: one that is off by half a pixel, one whose centres are all gaps, one that hangs,
    one that fails.
    """
    case = WhiteImage(pitch=14.3, degrees=0.3, size=(300, 240))
    monkeypatch.setattr(peers, "white_cases", lambda: {"flat discs": case})
    i, j = np.meshgrid(np.arange(-60, 60), np.arange(-60, 60))
    points = case.centres(np.column_stack([i.ravel(), j.ravel()]).astype(float))
    inside = ((points > 0) & (points < np.array(case.size) - 1)).all(1)
    np.save(tmp_path / "good.npy", points[inside] + [0.3, 0.4])
    np.save(tmp_path / "wrong.npy", points[inside] + 0.45 * case.pitch)
    script = tmp_path / "tools.py"
    script.write_text(_TOOL.replace("FOLDER", repr(str(tmp_path))))
    monkeypatch.setattr(peers, "_SCRIPT", script)


def test_installed_tools_are_measured_beside_ours_and_end_in_time(tools):
    rows = {row.method: row for row in measure_peers(limit=1.5)}
    assert set(rows) == {"lfcal", "good 1.0", "wrong 2.0", "slow 3.0", "broken 4.0"}
    assert rows["good 1.0"].errors["centre RMS px"] == pytest.approx(0.5, abs=1e-6)
    assert rows["good 1.0"].errors["centres found"] == 1
    assert rows["good 1.0"].seconds_per_megapixel == pytest.approx(1.5 / 0.072)
    assert rows["lfcal"].errors["centre RMS px"] < 0.02
    assert rows["lfcal"].errors["centres found"] == 1
    assert rows["wrong 2.0"].errors["centres found"] < 0.05
    assert not rows["slow 3.0"].errors and "within 1.5 s" in rows["slow 3.0"].note
    assert not rows["broken 4.0"].errors and "no grid found" in rows["broken 4.0"].note


def test_without_any_tool_nothing_is_measured(tmp_path):
    assert peers_of(str(tmp_path / "python")) == {}
    if not peers_of(sys.executable):
        assert list(measure_peers()) == []
