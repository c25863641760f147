"""What `handcal bench --json` writes."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired, TypedDict

from handcal.results.kinds import Count, Floats, Kind, Later, Number, Version


class Bench(TypedDict):
    """How fast, beside what."""

    schema: Kind[Literal["handcal/bench/1"]]
    version: NotRequired[Version]
    machine: _Machine
    rounds: Count
    complete: Later[
        Annotated[
            bool,
            "Whether all that was asked for was measured or left out for a reason. The file is "
            "written anew with every figure; until the last, and where the run was cut off, this "
            "is false, and `skipped` names the groups that are not measured to their end.",
        ]
    ]
    figures: list[_Figure]
    profiles: Later[
        Annotated[
            list[_Profile],
            "Where the time of a command goes, by a look every 5 ms at its first thread.",
        ]
    ]
    skipped: list[_Skipped]


class _Machine(TypedDict):
    processor: str
    cores: int | None
    system: str
    python: str
    load_before: Annotated[Number, "Share of the processors that were busy."]
    versions: dict[str, str]


class _Figure(TypedDict):
    group: str
    title: str
    unit: str
    clock: Literal["cpu", "wall", None]
    median: float
    rounds: Floats
    target: _Target | None
    met: bool | None


class _Target(TypedDict):
    at_most: NotRequired[Annotated[float, "", "where less is better"]]
    at_least: NotRequired[Annotated[float, "", "where more is better"]]


class _Profile(TypedDict):
    group: str
    title: str
    doing: Annotated[dict[str, float], "By module at work, s."]
    asked_by: Annotated[dict[str, float], "By module of the step that asked for it, s."]


class _Skipped(TypedDict):
    group: str
    title: str
    reason: str
