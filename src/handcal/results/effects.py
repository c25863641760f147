"""What `handcal effects --json` writes."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired, TypedDict

from handcal.results.kinds import Kind, Later, Version


class Effects(TypedDict):
    """The catalogue."""

    schema: Kind[Literal["handcal/effects/1"]]
    version: NotRequired[Version]
    effects: list[_Effect]


class _Effect(TypedDict):
    id: str
    title: str
    story: Annotated[str, "What it does."]
    motion: Annotated[str, "What shows it."]
    source: Annotated[str, "Where it is from."]
    validated: Annotated[str, "What it was tried on."]
    common: Later[
        Annotated[
            str,
            "Where it is from that every device has it, and its usual size; empty for what few "
            "devices have.",
        ]
    ]
    parameters: list[_EffectParameter]


class _EffectParameter(TypedDict):
    name: str
    unit: str
    prior_sigma: Annotated[float, "Usual size."]
