"""The page of results holds the figures that its command has measured."""

from __future__ import annotations

import json
import re

from benchmarks.results import _FIGURES, PAGE, page_with, tables


def test_the_page_holds_the_measured_tables_and_nothing_else_between_its_marks():
    page = PAGE.read_text(encoding="utf-8")
    figures = json.loads(_FIGURES.read_text(encoding="utf-8"))
    assert page_with(figures, page) == page
    assert re.findall(r"<!-- (\w+) -->", page).count("end") == len(tables(figures))
    figures["captures"]["Fujita2.png"]["right"] = 0.5
    assert "| Fujita2, Raytrix R5, 4 megapixels | 50.00 / 49.99 / 0.01 % |" in page_with(
        figures, page
    )


def test_the_figures_of_the_readme_are_those_of_the_page():
    captures = json.loads(_FIGURES.read_text(encoding="utf-8"))["captures"]
    assert len(captures) == 4
    assert min(one["right"] for one in captures.values()) >= 0.995
    assert max(one["wrong"] for one in captures.values()) <= 2e-4
    _, analyze, render = captures["Fujita2.png"]["cpu"]
    assert 0.5 < analyze + render < 1.5
    readme = (PAGE.parents[1] / "README.md").read_text(encoding="utf-8")
    for claim in ("at least 99.5 %", "at most two of\nten thousand", "about a second"):
        assert claim in readme


def test_the_page_has_at_most_1500_words():
    assert len(PAGE.read_text(encoding="utf-8").split()) <= 1500
