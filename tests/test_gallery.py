"""The pages of the gallery run, and each draws a figure."""

from pathlib import Path

import pytest

GALLERY = sorted((Path(__file__).parents[1] / "docs/gallery").glob("plot_*.py"))


@pytest.mark.parametrize("script", GALLERY, ids=lambda script: script.stem)
def test_example_runs_and_draws(script):
    plt = pytest.importorskip("matplotlib.pyplot", reason="Matplotlib is not installed")
    plt.switch_backend("agg")
    plt.close("all")
    exec(compile(script.read_text(encoding="utf-8"), script.name, "exec"), {"__name__": "__main__"})
    pictures = [image for n in plt.get_fignums() for ax in plt.figure(n).axes for image in (*ax.images, *ax.lines)]
    assert len(pictures) >= 2
    plt.close("all")
