"""What the commands of `handcal design` write."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired, TypedDict

from handcal.results.kinds import Count, Kind, Number, Texts, Vector, Version
from handcal.results.parts import _Expected


class DesignedMotion(TypedDict):
    """Which turn to make next."""

    schema: Kind[Literal["handcal/design-motion/1"]]
    version: NotRequired[Version]
    after: Annotated[str | None, "The recording; null where nothing is recorded."]
    observations: Annotated[Texts, "Kinds."]
    before: list[_Before]
    motions: Annotated[list[_Motion], "The best first."]
    warnings: Annotated[Texts, "In sentences."]


class _Before(TypedDict):
    effect: str
    name: str
    sigma: float
    prior_sigma: float
    unit: str


class _Motion(TypedDict):
    motion: Annotated[str, "What to do."]
    seconds: float
    times_smaller: Annotated[float, "The uncertainty becomes."]
    sigma: list[_Sigma]


class _Sigma(TypedDict):
    effect: str
    name: str
    sigma: Annotated[float, "Afterwards."]
    unit: str


class DesignedPoses(TypedDict):
    """A set of poses, and how good it is."""

    schema: Kind[Literal["handcal/design-poses/1"]]
    version: NotRequired[Version]
    effects: Annotated[Texts, "Ids."]
    known: Annotated[Literal["norm", "pose", "rate", "spin"], "What is known of a pose."]
    criterion: Literal["D", "A", "condition"]
    way: Annotated[str, "All at once, or sequential."]
    rate: Annotated[Number, "Of the table, rad/s."]
    poses: list[_Pose]
    d_efficiency: Annotated[float, "1 is the best."]
    a_efficiency: Annotated[float, "1 is the best."]
    condition: Annotated[float, "Condition number."]
    best_condition: Annotated[float, "The least possible."]
    d_efficiency_held_within_5_deg: Annotated[float, "In 19 of 20 tries."]
    reading_noise: _ReadingNoise
    parameters: list[_Expected]
    seed: Count


class _Pose(TypedDict):
    up: Annotated[Vector, "In body axes."]
    elevation_deg: Annotated[Vector, "Of x y z above the horizon."]
    instruction: Annotated[str, "How to lay it."]


class _ReadingNoise(TypedDict):
    gyro: Annotated[float, "rad/s"]
    accel: Annotated[float, "m/s^2"]
