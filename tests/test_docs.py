"""The documentation names all public names, pages, files and messages."""

from __future__ import annotations

import ast
import inspect
import pkgutil
import re
import tomllib
from functools import cached_property
from importlib import import_module
from itertools import pairwise
from pathlib import Path

import click
import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"


@pytest.mark.parametrize("package", ["lfcal", "lfrender", "data_synth"])
def test_the_reference_lists_every_public_name_and_no_other(package):
    text = (DOCS / "api.rst").read_text(encoding="utf-8")
    part = text.partition(f".. currentmodule:: {package}\n")[2].partition(".. currentmodule::")[0]
    listed = re.findall(r"^   (\w+)$", part, re.MULTILINE)
    # These are documented as `lfcal.Optics`, and by sub-package.
    elsewhere = {"Optics", "data", "dense_depth"} if package == "lfrender" else set()
    assert sorted(listed) == sorted(set(import_module(package).__all__) - elsewhere)


def _documented():
    """Each name of the reference, and the object that it stands for."""
    text = (DOCS / "api.rst").read_text(encoding="utf-8")
    for package, part in re.findall(
        r"currentmodule:: (\w+)\n(.*?)(?=\.\. currentmodule|\Z)", text, re.DOTALL
    ):
        for name in re.findall(r"^   (\w+(?:\.\w+)*)$", part, re.MULTILINE):
            yield f"{package}.{name}", pkgutil.resolve_name(f"{package}.{name}")


DOCUMENTED = [pytest.param(thing, id=name) for name, thing in _documented()]


@pytest.mark.parametrize("thing", [p for p in DOCUMENTED if p.id != "data_synth.SCENES"])
def test_every_name_in_the_reference_has_an_example(thing):
    assert ">>> " in thing.__doc__


@pytest.mark.parametrize("thing", [p for p in DOCUMENTED if inspect.isclass(p.values[0])])
def test_every_public_method_of_a_class_in_the_reference_is_described(thing):
    bare = [
        name
        for name, member in inspect.getmembers(thing, callable)
        if name[0] != "_" and not inspect.getdoc(member)
    ]
    bare += [
        name
        for name, member in vars(thing).items()
        if name[0] != "_"
        and isinstance(member, property | cached_property)
        and not inspect.getdoc(member)
    ]
    assert bare == []


def test_every_page_is_in_a_table_of_contents():
    pages = {
        str(path.relative_to(DOCS).with_suffix(""))
        for path in DOCS.rglob("*.md")
        if "built" not in str(path)
    }
    blocks = re.findall(
        r"```{toctree}\n(.*?)```", (DOCS / "index.md").read_text(encoding="utf-8"), re.DOTALL
    )
    listed = {
        line for block in blocks for line in block.splitlines() if line and not line.startswith(":")
    }
    assert pages - {"index"} == listed - {
        "api",
        "built_gallery/index",
        "built_commands/overview",
        "built_messages/index",
    }


@pytest.mark.parametrize(
    "page", [*sorted(DOCS.glob("*.md")), *ROOT.glob("*.md")], ids=lambda page: page.name
)
def test_files_that_a_page_names_exist(page):
    text = page.read_text(encoding="utf-8")
    named = [
        ROOT / path
        for path in re.findall(
            r"`((?:lfcal|lfrender|data_synth|benchmarks|tests)/[\w/]+(?:\.\w+)?)`", text
        )
    ]
    named += [
        page.parent / path
        for path in re.findall(r"\]\((?!\w+:)([^)#]+)", text)
        if "built_" not in path
    ]
    assert [path for path in named if not path.exists() and "_cupy" not in str(path)] == []


# What the lab book may name, and the site may not.
_DIARY = {
    "revision": r"\b(?=[a-f]*\d)(?=\d*[a-f])[\da-f]{7,40}\b",
    "seed": r"\bseeds?\b(?!=)",
    "load": r"\bunder load\b|\bload (?:average|of \d)|\bbusy machine|\bother work\b",
    "path": r"\.\./shared|(?<![\w.])/(?:work|home|root|tmp)/",
}
_PAGES = [
    *(path for path in DOCS.rglob("*.md") if "built" not in str(path)),
    *DOCS.glob("*.rst"),
    *DOCS.glob("*.toml"),
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
]


@pytest.mark.parametrize("kind", _DIARY)
def test_no_page_of_the_site_names_a_revision_a_seed_a_load_or_an_outside_path(kind):
    found = [
        f"{page.name}: {match[0]}"
        for page in _PAGES
        for match in re.finditer(_DIARY[kind], page.read_text(encoding="utf-8"))
    ]
    assert found == []


def test_figures_of_quality_and_time_stand_on_the_page_of_results_alone():
    pages = [page for page in _PAGES if page.parent != ROOT and page.name != "results.md"]
    found = [
        f"{page.name}: {match[0]}"
        for page in [*pages, ROOT / "README.md"]
        for match in re.finditer(
            r"\d dB\b|\d processor seconds|[\d.]+ s a frame", page.read_text(encoding="utf-8")
        )
    ]
    assert found == []


def test_the_pages_written_by_hand_have_at_most_26000_words():
    pages = [page for page in _PAGES if page.parent != ROOT and page.suffix != ".toml"]
    words = sum(len(page.read_text(encoding="utf-8").split()) for page in pages)
    assert words <= 26_000


def _texts():
    """The strings of the packages and of click, with "…" in place of inserted values."""
    sources = [
        path for name in ("lfcal", "lfrender", "data_synth") for path in (ROOT / name).rglob("*.py")
    ]
    for path in [*sources, Path(click.exceptions.__file__), Path(click.core.__file__)]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.JoinedStr):
                yield "".join(part.value if _is_text(part) else "…" for part in node.values)
            elif _is_text(node):
                yield node.value
    for page in (ROOT / "lfrender/web/assets").iterdir():
        yield page.read_text(encoding="utf-8")


def _is_text(node):
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def test_messages_of_the_registry_are_those_of_the_code():
    groups = tomllib.loads((DOCS / "messages.toml").read_text(encoding="utf-8"))
    messages = [message for group in groups.values() for message in group]
    assert len(messages) > 300
    texts = " ".join(" ".join(_texts()).split())
    for message in messages:
        parts = re.split(r"…|\d\S*", message)
        pairs = [" ".join(pair) for part in parts for pair in pairwise(part.split())]
        assert [pair for pair in pairs if pair not in texts] == [], message
