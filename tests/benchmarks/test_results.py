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
    assert "| Fujita2, Raytrix R5, 4 megapixels | 50.0 / 50.0 / 0.0 % |" in page_with(figures, page)


def test_the_page_has_at_most_1500_words():
    assert len(PAGE.read_text(encoding="utf-8").split()) <= 1500
