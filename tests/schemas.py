"""Results against their schemas. ``conftest.py`` holds every result to them that a test writes; one
that is never written, a test gives to ``check``."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path
from typing import Any

import handcal
import handcal.results
import handcal_sim.results

ROOT = Path(__file__).resolve().parents[1]
Document = dict[str, Any]


@cache
def schemas() -> dict[str, Document]:
    """By name, which is that of the command."""
    return handcal.results.schemas() | handcal_sim.results.schemas()


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
