"""Writes docs/results.md, what stands in the JSON of each command, from the types of the
results; `make docs` runs it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import handcal.results
import handcal_sim.results

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "docs/results.md"
INTRODUCTION = """# Results as JSON

*Reference.* The results that `--json FILE` writes, command by command (`-` is standard output). Every result says in `schema` what it is; the number at its end changes when something is taken away or changes its meaning, and not when something is added. Numbers are SI unless their names or texts say otherwise; `null` stands for a number that there is not, and lists are never null. What stands here as a [part](#parts) is described once, below.

The schemas themselves (JSON Schema, draft 2020-12) are made from the types in `handcal.results` and `handcal_sim.results`: `handcal.results.schemas()` gives them by name, and the wheel has them as files, `handcal/schemas/calibrate.json` and so on. Each needs no other, and allows nothing but what it names, so a result of a newer handcal may be refused by the schema of an older one. Results written before something was added lack it and are valid all the same.

This page is written by `make docs` from those types.
"""  # noqa: E501
TYPES = {"string": "text", "integer": "whole number", "boolean": "true or false",
         "array": "list", "null": "null"}  # fmt: skip
MANY = {"number": "numbers", "text": "texts", "whole number": "whole numbers", "object": "objects"}
FIRST = ("calibrate", "explain")
Schema = dict[str, Any]


def schemas() -> dict[str, Schema]:
    """By name, the most used first."""
    found = handcal.results.schemas() | handcal_sim.results.schemas()
    return {name: found[name] for name in sorted(found, key=lambda n: n not in FIRST)}


def home(name: str) -> str:
    """The file of the type, as linked from the page."""
    kind = handcal.results.RESULTS.get(name) or handcal_sim.results.RESULTS[name][1]
    return f"../{Path(str(sys.modules[kind.__module__].__file__)).relative_to(ROOT).as_posix()}"


def kind(node: Schema) -> str:
    """What a value is, in words."""
    if "$ref" in node:
        name = node["$ref"].rsplit("/", 1)[1]
        return f"[{name}](#part-{name.replace('_', '-')})"
    if "const" in node:
        return f"`{node['const']}`"
    if "enum" in node:
        return ", ".join("null" if v is None else f"`{v}`" for v in node["enum"])
    if "anyOf" in node:
        ways = [w for w in node["anyOf"] if "maxProperties" not in w]
        return " or ".join(kind(w) for w in ways)
    types = node.get("type", "anything")
    if isinstance(types, list):
        return " or ".join(TYPES.get(t, t) for t in types)
    if types == "array":
        many = f"{node['minItems']} " if node.get("minItems") == node.get("maxItems", 0) else ""
        what = kind(node["items"])
        return f"list of {many}{MANY.get(what, what)}"
    if types == "object" and isinstance(node.get("additionalProperties"), dict):
        return f"by name: {kind(node['additionalProperties'])}"
    return TYPES.get(types, types)


def rows(node: Schema, path: str = "") -> Iterator[str]:
    """The lines of a table: every key, those of objects within it after it."""
    for key, value in node.get("properties", {}).items():
        here = f"{path}{key}"
        text = value.get("description", "")
        if when := value.get("x-when"):
            text = f"{text} (Only {when}.)".strip()
        shown = kind(value).replace("|", "\\|")
        yield f"| `{here}` | {shown} | {text} |"
        yield from within(value, here)


def within(value: Schema, here: str) -> Iterator[str]:
    """The lines of what stands inside a value that is no part."""
    yield from rows(value, f"{here}.")
    for way in value.get("anyOf", ()):
        if "properties" in way or "items" in way:
            yield from within(way, here)
    if "items" in value:
        yield from within(value["items"], f"{here}[]")
    if isinstance(value.get("additionalProperties"), dict):
        yield from within(value["additionalProperties"], f"{here}.*")


def table(node: Schema) -> str:
    """The keys of an object."""
    return "\n".join(["| key | is | |", "|---|---|---|", *rows(node)])


def page() -> str:
    """The whole page."""
    found = schemas()
    out = [INTRODUCTION]
    for name, schema in found.items():
        text = f"{schema['description']} [`{name}.json`]({home(name)})"
        out += [f"## {schema['title']}", "", text, "", table(schema), ""]
    parts = {k: v for schema in found.values() for k, v in schema.get("$defs", {}).items()}
    out += ["## Parts", ""]
    for name, part in sorted(parts.items()):
        heading = f"### Part: {name.replace('_', '-')}"
        out += [heading, "", part.get("description", ""), "", table(part), ""]
    return "\n".join(out)


if __name__ == "__main__":
    FILE.write_text(page(), encoding="utf-8")
