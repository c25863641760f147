"""JSON Schema (draft 2020-12) from the types of results."""

from __future__ import annotations

import re
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    NotRequired,
    Union,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

Schema = dict[str, Any]
PLAIN = {str: "string", int: "integer", float: "number", bool: "boolean", NoneType: "null"}


def json_schema(name: str, title: str, result: type) -> Schema:
    """Of a kind of result, complete in itself. A type is a part, which stands once, in
    ``$defs``; one whose name begins with an underscore stands where it is used. name: the
    command's, with hyphens."""
    parts: dict[str, Schema] = {}
    body = _object(result, parts)
    program, _, edition = body["properties"]["schema"]["const"].split("/")
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:{program}:schema:{name}:{edition}", "title": title,
    } | body  # fmt: skip
    return schema | {"$defs": parts} if parts else schema


def _object(described: type, parts: dict[str, Schema]) -> Schema:
    """Of a TypedDict, closed."""
    properties, required = {}, []
    for key, hint in get_type_hints(described, include_extras=True).items():
        always = get_origin(hint) is not NotRequired
        node = _node(hint if always else get_args(hint)[0], parts)
        if node.pop("required_key", always):
            required.append(key)
        properties[key] = node
    text = {"description": " ".join(described.__doc__.split())} if described.__doc__ else {}
    return {"type": "object", **text, "properties": properties, "required": required,
            "additionalProperties": False}  # fmt: skip


def _node(hint: Any, parts: dict[str, Schema]) -> Schema:
    """Of any type that a result has."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _annotated(_node(inner[0], parts), hint.__metadata__)
    if origin is Literal:
        return {"enum": list(inner)} if len(inner) > 1 else {"const": inner[0]}
    if origin in (Union, UnionType):
        ways = [_node(i, parts) for i in inner]
        plain = all(set(w) == {"type"} for w in ways)
        return {"type": [w["type"] for w in ways]} if plain else {"anyOf": ways}
    if origin is list:
        return {"type": "array", "items": _node(inner[0], parts)}
    if origin is dict:
        return {"type": "object", "additionalProperties": inner[1] is Any or _node(inner[1], parts)}
    if is_typeddict(hint):
        return (_object if hint.__name__.startswith("_") else _part)(hint, parts)
    return {} if hint is Any else {"type": PLAIN[hint]}


def _part(described: type, parts: dict[str, Schema]) -> Schema:
    """The reference to a part, which is described the first time."""
    name = re.sub(r"(?<!^)(?=[A-Z])", "_", described.__name__).lower()
    if name not in parts:
        parts[name] = {}  # (so that it keeps its place before the parts that it has)
        parts[name] |= _object(described, parts)
    return {"$ref": f"#/$defs/{name}"}


def _annotated(node: Schema, said: tuple[Any, ...]) -> Schema:
    """With what is said beside the type."""
    texts = [s for s in said if isinstance(s, str)]
    found = dict(pair for s in said if not isinstance(s, str) for pair in s)
    return (
        node | found | {k: t for k, t in zip(("description", "x-when"), texts, strict=False) if t}
    )
