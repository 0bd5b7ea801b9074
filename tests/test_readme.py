"""README is short, and what it shows is true."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
# Words of each section at most, of its code and tables too; the first is the head.
WORDS = {
    "lfrender": 60,
    "Quick start": 100,
    "What it does": 145,
    "Python": 40,
    "Accuracy and speed": 165,
    "Limits": 80,
    "Documentation": 100,
}
SECTIONS = dict(part.split("\n", 1) for part in re.split(r"^##? (?=\w[^\n]*\n\n)", README, flags=re.MULTILINE)[1:])


def test_readme_has_700_words_at_most():
    assert len(README.split()) <= 700


def test_readme_has_these_sections_and_no_other():
    assert list(SECTIONS) == list(WORDS)


@pytest.mark.parametrize("section", WORDS)
def test_words_of_a_section(section):
    assert len(SECTIONS[section].split()) <= WORDS[section]


def test_the_table_has_five_rows_and_fifteen_figures():
    rows = [line for line in SECTIONS["Accuracy and speed"].splitlines() if line.startswith("|")][2:]
    assert len(rows) == 5
    assert sum(len(row.strip("|").split("|")) - 1 for row in rows) == 15


def test_quick_start_and_python_have_eight_lines_at_most():
    for section in ("Quick start", "Python"):
        (block,) = re.findall(r"```\w+\n(.*?)```", SECTIONS[section], re.DOTALL)
        assert len(block.splitlines()) <= 8


def test_limits_and_bullets():
    assert SECTIONS["Limits"].count("\n- ") == 4
    assert SECTIONS["What it does"].count("\n- ") == 6


def test_files_that_readme_links_to_exist():
    links = re.findall(r"\]\((?!https?:)([^)#]+)", README)
    assert len(links) > 10
    assert [link for link in links if not (ROOT / link).exists()] == []
