"""`docs/troubleshooting.md` has a row for every message that the code can give."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
# Messages for developers, and those that repeat the text of another error.
_NOT_FOR_USERS = {"AttributeError", "KeyError", "TypeError", "NotImplementedError", "AssertionError", "StopIteration"}
# Names and functions that hold the text of a warning or the reason in an error.
_HOLDERS = re.compile(
    r"warnings?$|doubt|problem|degeneracies|_describe_(?:shift|linear|other)|_TOO_LITTLE|NO_|conflict"
)


def text_of(node):
    """The text of an expression with `…` in the place of what is put into it; None where it is no text."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(_part(part) for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        sides = [text_of(node.left), text_of(node.right)]
        return None if sides == [None, None] else "".join(side or "…" for side in sides)
    return None


def _part(node):
    if isinstance(node, ast.Constant):
        return str(node.value)
    return "'…'" if node.conversion == ord("r") else "…"


def texts_in(node):
    """All texts of an expression: both ends of a condition, members of tuples and lists."""
    own = text_of(node)
    if own is not None:
        return [own]
    if isinstance(node, ast.IfExp):
        return texts_in(node.body) + texts_in(node.orelse)
    if isinstance(node, ast.BoolOp):
        return [text for value in node.values for text in texts_in(value)]
    if isinstance(node, ast.Tuple | ast.List):
        return [text for value in node.elts for text in texts_in(value)]
    return []


def _of_node(node):
    if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and node.exc.args:
        return [] if ast.unparse(node.exc.func) in _NOT_FOR_USERS else texts_in(node.exc.args[0])
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.args:
        name, owner = node.func.attr, ast.unparse(node.func.value)
        if name in ("warn", "fail") or (name == "append" and re.search(r"warnings$|notes$", owner)):
            return texts_in(node.args[0])
    if isinstance(node, ast.Assign | ast.AugAssign):
        target = node.targets[0] if isinstance(node, ast.Assign) else node.target
        return texts_in(node.value) if _HOLDERS.search(ast.unparse(target)) else []
    if isinstance(node, ast.FunctionDef) and _HOLDERS.search(node.name):
        returned = [part.value for part in ast.walk(node) if isinstance(part, ast.Return) and part.value is not None]
        return [text for value in returned for text in texts_in(value)]
    return []


@cache
def nodes():
    """Place and node of all syntax of the three packages."""
    return [
        (f"{file.relative_to(ROOT)}:{getattr(node, 'lineno', 0)}", node)
        for package in ("lfcal", "lfrender", "data_synth")
        for file in sorted((ROOT / package).rglob("*.py"))
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
    ]


def messages():
    for place, node in nodes():
        for text in _of_node(node):
            # Messages of at least three words; others are parts of a message that is found as a whole.
            if not text.startswith("<section") and len(re.findall(r"[a-z]{2,}", text)) >= 3:
                yield place, text


def rows():
    page = (ROOT / "docs/troubleshooting.md").read_text(encoding="utf-8")
    return [row.replace(r"\|", "|") for row in re.findall(r"^\| `(.+?)` \|", page, re.MULTILINE)]


def is_of(row, text):
    """Whether a row is that of a text; `…` in the row stands for anything."""
    first, *others = (part.strip() for part in row.split("…"))
    if not others or not text.startswith(first):
        return row == text
    *middle, last = others
    at = len(first)
    for part in middle:
        at = text.find(part, at)
        if at < 0:
            return False
        at += len(part)
    return text.endswith(last) and at <= len(text) - len(last)


def test_every_message_has_a_row():
    shown = rows()
    missing = [f"{place}  {text}" for place, text in messages() if not any(is_of(row, text) for row in shown)]
    assert missing == [], "add rows to docs/troubleshooting.md:\n" + "\n".join(missing)


def test_there_are_messages_of_each_kind():
    found = [text for _, text in messages()]
    assert len(found) > 300
    for words in ("no microimages found", "the lattice is uncertain", "exclude each other", "truncated PNG"):
        assert any(words in text for text in found), words


def test_every_row_is_of_a_message():
    texts = {text for _, node in nodes() if isinstance(node, ast.Constant | ast.JoinedStr) and (text := text_of(node))}
    page = (ROOT / "lfrender/web/assets/report.html").read_text(encoding="utf-8")
    texts |= {re.sub(r"{{.*?}}", "…", item) for item in re.findall(r"<li>(.*?)</li>", page)}
    assert [row for row in rows() if not any(is_of(row, text) for text in texts)] == []
