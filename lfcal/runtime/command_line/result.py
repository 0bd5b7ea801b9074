"""The JSON objects of commands: their keys, and their JSON Schema for the documentation.

The keys of each object stand in the file `results.toml` of the command line of a package.
"""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass, field, fields, make_dataclass
from importlib.resources import files
from typing import Any, ClassVar

import msgspec

from ..types import Entries

__all__ = ["VERSION", "Failure", "Result", "json_schema", "results_of"]

#: Of the objects. It rises if a key goes or gets another meaning; new keys may come without that.
VERSION = 1


@dataclass(frozen=True, kw_only=True)
class Result:
    """What a command prints with `--json` on stdout; keys without a value are null."""

    #: What each key means.
    meanings: ClassVar[dict[str, str]] = {
        "version": "Of these objects, 1. It rises if a key goes or gets another meaning.",
        "warnings": "Messages to read before the result is used.",
        "seconds": "Seconds of each stage.",
    }

    version: int = VERSION
    warnings: list[str]
    seconds: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Failure:
    """Why a command ended with exit code 2.

    kind
        Kind of the error: `usage`, `flat`, `calibration`, `camera_file`, `board`, `output`,
        `picture`, `depth_file`, `source` or `server` (live page), `memory`, `system`, or
        `light_field` for all others.
    message
        The line on stderr, without the name of the program.
    """

    kind: str
    message: str

    @classmethod
    def of(cls, error: BaseException, message: str) -> Failure:
        """The failure of an exception."""
        name = type(error).__name__.removesuffix("Error").removesuffix("Exception")
        if type(error).__module__.startswith("click"):
            name = "Usage"
        elif isinstance(error, OSError) and type(error).__module__ == "builtins":
            name = "System"
        return cls(kind=re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower(), message=message)


def results_of(package: str) -> dict[str, type[Result]]:
    """The objects of the commands of a package, by the names of their tables in its `results.toml`.

    A table has the text `about`, the name of a table before it whose keys it has too (`like`), and
    for each key its type and its meaning. Keys that may be null need not be given.
    """
    text = (files(package) / "results.toml").read_text(encoding="utf-8")
    found: dict[str, type[Result]] = {}
    for name, keys in tomllib.loads(text).items():
        about = keys.pop("about")
        base = found.get(keys.pop("like", ""), Result)
        given: list[Any] = []
        for key, (kind, _) in keys.items():
            default = (field(default=None),) if kind.endswith("| None") else ()
            given.append((key, kind, *default))
        meanings = base.meanings | {key: meaning for key, (_, meaning) in keys.items()}
        inside = {"__doc__": about, "__module__": __name__, "meanings": meanings}
        found[name] = make_dataclass(
            f"{name.title()}Result",
            given,
            bases=(base,),
            namespace=inside,
            frozen=True,
            kw_only=True,
        )
    return found


def json_schema(result: type[Result]) -> Entries:
    """The JSON Schema of an object, with the meaning of each key."""
    schema = msgspec.json.schema(result)
    about = schema["$defs"][result.__name__]
    about["description"] = result.__doc__
    for key in fields(result):
        about["properties"][key.name]["description"] = result.meanings[key.name]
    return schema
