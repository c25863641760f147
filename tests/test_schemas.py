"""Every result has a schema, which is closed, holds the promises, and refuses what is not so."""

from __future__ import annotations

import json
import re
from typing import Annotated, Literal, NotRequired, TypedDict

import pytest
import schemas
import typer
from fake_explanation import fake_explanation
from fake_result import fake_result
from jsonschema import Draft202012Validator

from handcal.commands._app import app
from handcal.results.json_schema import json_schema
from handcal.results.kinds import Count, Kind, Later, Number, Two
from handcal.show.calibration.summary import calibration_json
from handcal.show.explanation.document import explanation_json

# What is promised to people who read results, whatever else they hold.
PROMISED = {
    "calibrate": {"schema", "recording", "parameters", "noise", "fit", "warnings", "recordings"},
    "explain": {"schema", "verdict", "mismatch", "missing", "unnamed", "fit", "held_out", "untried",
                "next_motion", "parameters", "noise", "warnings", "hand", "untellable", "model",
                "recording"},
}  # fmt: skip
ENTRIES = {
    "parameter": {"effect", "name", "value", "sigma", "unit", "observable", "converged_at_s"},
    "mismatch": {"channel", "from_s", "to_s", "share", "when"},
    "missing": {"effect", "probability", "log_evidence_gain", "indistinguishable_from",
                "parameters", "story", "size", "share", "held_out_gain"},
    "unnamed": {"formula", "value", "sigma", "unit", "log_evidence_gain", "channels", "drivers",
                "curve"},
    "curve": {"x", "y", "sigma", "x_unit", "y_unit"},
    "next_motion": {"motion", "separates", "expected_gain"},
    "untellable": {"effect", "name", "sigma"},
    "held_out": {"log_score_before", "log_score_after", "residual_rms_before",
                 "residual_rms_after"},
    "recording": {"path", "duration_s", "imu_rate_hz", "streams", "assume"},
}  # fmt: skip


def nodes(schema, name=""):
    """Every schema within a schema, with the key that it stands under."""
    if isinstance(schema, dict):
        yield name, schema
        for key, value in schema.items():
            yield from nodes(value, key)
    elif isinstance(schema, list):
        for value in schema:
            yield from nodes(value, name)


@pytest.mark.parametrize("name", schemas.schemas())
def test_a_schema_is_one_and_closed(name):
    schema = schemas.schemas()[name]
    Draft202012Validator.check_schema(schema)
    assert schema["$schema"].endswith("/2020-12/schema")
    for key, node in nodes(schema):
        if node.get("type") == "object":
            assert "additionalProperties" in node, (key, node)
            assert (node["additionalProperties"] is False) == ("properties" in node)
            assert set(node.get("required", ())) <= set(node.get("properties", ()))
    used = set(re.findall(r"#/\$defs/(\w+)", json.dumps(schema)))
    assert used == set(schema.get("$defs", ()))


class Thing(TypedDict):
    """A thing."""

    schema: Kind[Literal["handcal-tests/thing/1"]]
    size: Annotated[Number, "m"]
    since: Later[str]
    seen: NotRequired[Annotated[Two[Count], "Readings.", "with two"]]


@pytest.mark.parametrize(
    ("more", "valid"),
    [({}, True), ({"size": 1.5, "since": "now", "seen": [0, 1]}, True), ({"size": "1"}, False),
     ({"since": None}, False), ({"seen": [1]}, False), ({"seen": [1, -1]}, False),
     ({"schema": "handcal-tests/thing/2"}, False), ({"colour": "red"}, False)],
)  # fmt: skip
def test_a_schema_accepts_what_the_type_says(more, valid):
    schema = json_schema("thing", "A thing", Thing)
    assert schema["$id"] == "urn:handcal-tests:schema:thing:1"
    assert schema["description"] == "A thing."
    seen = schema["properties"]["seen"]
    assert (seen["description"], seen["x-when"]) == ("Readings.", "with two")
    check = Draft202012Validator(schema)
    assert not check.is_valid({"schema": "handcal-tests/thing/1"})
    document = {"schema": "handcal-tests/thing/1", "size": None}
    assert check.is_valid(document | more) == valid


def test_parts_of_one_name_are_the_same_in_all_schemas():
    first = {}
    for schema in schemas.schemas().values():
        for name, part in schema.get("$defs", {}).items():
            assert first.setdefault(name, part) == part, name


def test_the_promises_are_in_the_schemas():
    for name, keys in PROMISED.items():
        assert keys <= set(schemas.schemas()[name]["properties"])
    parts = schemas.schemas()["explain"]["$defs"]
    for name, keys in ENTRIES.items():
        assert keys <= set(parts[name]["properties"]), name
    verdicts = schemas.schemas()["explain"]["properties"]["verdict"]["enum"]
    assert set(verdicts) == {"nothing_missing", "explained", "unexplained", "cannot_tell"}


def commands(group, path=()):
    """Names of the commands that write JSON."""
    context = typer.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if hasattr(command, "list_commands"):
            yield from commands(command, (*path, name))
        elif any("--json" in p.opts for p in command.params):
            yield "-".join((*path, name))


def test_every_command_that_writes_json_has_a_schema_and_so_has_every_kind_of_document():
    found = set(commands(typer.main.get_command(app)))
    assert {"calibrate", "lab-size", "design-poses", "prove"} <= found <= set(schemas.schemas())
    known = {s["properties"]["schema"]["const"] for s in schemas.schemas().values()}
    code = [p.read_text("utf-8") for d in ("src/handcal", "sim/handcal_sim")
            for p in (schemas.ROOT / d).rglob("*.py")]  # fmt: skip
    written = set(re.findall(r'"(handcal(?:-sim)?/[a-z-]+/\d+)"', "\n".join(code)))
    others = {"handcal/device/1", "handcal/priors/1", "handcal/fleet-data/1"}  # (TOML, Parquet)
    assert written - others == known


def test_what_is_not_so_is_refused():
    good = calibration_json(fake_result())
    schemas.check(good)
    wrong = [good | {"more": 1}, {k: v for k, v in good.items() if k != "untellable"},
             good | {"warnings": None}, good | {"schema": "handcal/calibration/2"},
             good | {"parameters": [{**good["parameters"][0], "value": "1"}]},
             good | {"model": {"effect": []}}]  # fmt: skip
    for document in wrong:
        with pytest.raises(AssertionError):
            schemas.check(document)


def test_what_older_programs_wrote_is_still_valid():
    """Without what has been added since: an older result has no such keys."""
    for name, document in (
        ("calibrate", calibration_json(fake_result())),
        ("explain", explanation_json(fake_explanation("unexplained", recordings=1))),
    ):
        for key in ("untellable", "model", "hand", "hypotheses", "version"):
            document.pop(key, None)
        for m in document.get("missing", []):
            del m["size"], m["share"], m["held_out_gain"]
        for u in document.get("unnamed", []):
            del u["curve"], u["drivers"], u["channels"]
        document["recording"].pop("sha256")
        Draft202012Validator(schemas.schemas()[name]).validate(json.loads(json.dumps(document)))
