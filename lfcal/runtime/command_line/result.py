"""The JSON objects of commands: their keys, and their JSON Schema for the documentation."""

from __future__ import annotations

import inspect
import re
from dataclasses import dataclass, field, fields

import msgspec

from ..types import Entries

__all__ = ["VERSION", "Failure", "Result", "describe_keys", "json_schema"]

#: Of the objects. It rises if a key goes or gets another meaning; new keys may come without that.
VERSION = 1


@dataclass(frozen=True, kw_only=True)
class Result:
    """What a command prints with `--json` on stdout; keys without a value are null.

    version
        Of these objects, 1. It rises if a key goes or gets another meaning.
    warnings
        Messages to read before the result is used.
    seconds
        Seconds of each stage.
    """

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


def describe_keys(result: type) -> dict[str, str]:
    """The meaning of each key of an object, as the docstrings of its class and bases tell."""
    told: dict[str, str] = {}
    for kind in reversed(result.__mro__[:-1]):
        text = f"{inspect.getdoc(kind)}\n"
        for name, meaning in re.findall(r"^(\w+)\n((?: {4}.+\n)+)", text, re.MULTILINE):
            told[name] = " ".join(meaning.split())
    return {key.name: told[key.name] for key in fields(result)}


def json_schema(result: type) -> Entries:
    """The JSON Schema of an object, with the meaning of each key."""
    schema = msgspec.json.schema(result)
    about = schema["$defs"][result.__name__]
    about["description"] = str(inspect.getdoc(result)).splitlines()[0]
    for name, meaning in describe_keys(result).items():
        about["properties"][name]["description"] = meaning
    return schema
