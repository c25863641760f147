"""Results against their schemas. ``conftest.py`` holds every result to them that a test writes; one
that is never written, a test gives to ``check``."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path
from typing import Any

import handcal

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = (ROOT / "src/handcal/schemas", ROOT / "sim/handcal_sim/schemas")
Document = dict[str, Any]


@cache
def schemas() -> dict[str, Document]:
    """By name of the file, which is that of the command."""
    return {f.stem: json.loads(f.read_text("utf-8")) for d in FOLDERS for f in sorted(d.iterdir())}


def same(schema: Any) -> Any:
    """A schema in the one form of those that accept the same documents."""
    if isinstance(schema, list):
        return [same(s) for s in schema]
    if not isinstance(schema, dict):
        return schema
    out = {key: same(value) for key, value in schema.items()}
    if "oneOf" in out:  # (null or an object: they exclude each other)
        out["anyOf"] = out.pop("oneOf")
    if isinstance(out.get("type"), list) and "object" in out["type"]:
        kept = {key: out.pop(key) for key in ("description", "x-when") if key in out}
        out = kept | {"anyOf": [out | {"type": "object"}, {"type": "null"}]}
    if "anyOf" in out:
        out["anyOf"] = sorted(out["anyOf"], key=lambda way: json.dumps(way, sort_keys=True))
    for way in (out, *out.get("anyOf", ())):
        if isinstance(way.get("required"), list):
            way["required"] = sorted(way["required"])
            way["required"] or way.pop("required")
    if out.get("additionalProperties") is True:
        del out["additionalProperties"]
    return out


def name_of(document: Document) -> str | None:
    """Which schema a result follows, None if it is none of ours."""
    method = document.get("method", "")
    for name, schema in schemas().items():
        own = schema["properties"]
        way = own.get("method", {"const": ""})
        told = method == way["const"] if "const" in way else re.match(way["pattern"], method)
        if told and document["schema"] == own["schema"]["const"]:
            return name
    return None


def todays(schema: Any) -> Any:
    """The schema with all that a new result has required, what older ones may lack too."""
    if isinstance(schema, list):
        return [todays(s) for s in schema]
    if not isinstance(schema, dict):
        return schema
    out = {key: todays(value) for key, value in schema.items()}
    if schema.get("type") == "object" and "properties" in schema:
        out["required"] = [k for k, v in schema["properties"].items() if "x-when" not in v]
    return out


@cache
def _validator(name: str) -> Any:
    from jsonschema import Draft202012Validator

    return Draft202012Validator(todays(schemas()[name]))


def check(document: Document) -> None:
    """Errors: AssertionError where a new result does not follow its schema, or has none."""
    name = name_of(document)
    assert name is not None, f"{document['schema']} has no schema"
    if "version" in schemas()[name]["properties"]:
        document = {"version": handcal.__version__} | document
    errors = sorted(_validator(name).iter_errors(json.loads(json.dumps(document))), key=str)
    assert not errors, "\n".join(f"{name}: {e.json_path}: {e.message[:300]}" for e in errors[:5])
