"""What `handcal simulate` keeps of a recording."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NotRequired, TypedDict

from handcal.results.kinds import Floats, Kind, Number, Texts, Two, Vector


class Truth(TypedDict):
    """What a simulated recording was made of: the one JSON message of its topic
    `/truth/parameters`."""

    schema: Kind[Literal["handcal-sim/truth/1"]]
    scenario: str
    duration_s: float
    rests: Annotated[list[Two[float]], "From, to, s."]
    asked: Annotated[dict[str, Floats], "As `--effect` has them."]
    effects: Annotated[dict[str, list[_TruthEffect]], "All that is injected: by id, SI."]
    mean_walk: Annotated[_MeanWalk, "Of the biases beyond their start."]
    start: _Start
    hand: Annotated[_TruthHand, "Root mean squares for each axis."]
    earth: _Earth
    phone: Annotated[
        dict[str, Any], "The device as the simulator has it; for looking up, not fixed."
    ]
    concealed: NotRequired[
        Annotated[
            Texts, "`--effect` of others than the simulator's own.", "with effects of your own"
        ]
    ]


class _TruthEffect(TypedDict):
    name: str
    value: Number
    unit: str


class _MeanWalk(TypedDict):
    gyro: Annotated[Vector, "rad/s"]
    accel: Annotated[Vector, "m/s^2"]


class _Start(TypedDict):
    heading: Annotated[float, "rad"]
    pitch: Annotated[float, "rad"]
    roll: Annotated[float, "rad"]
    direction: int


class _TruthHand(TypedDict):
    sway_m: float
    sway_per_rate_m: float
    wobble_rad: float
    wobble_per_rate_rad: float
    tremor_m: float
    tremor_rad_s: float
    creep_m: float


class _Earth(TypedDict):
    gravity: Annotated[float, "m/s^2"]
    rate: Annotated[Vector, "rad/s"]
    gravity_error: float
    rate_error: Two[float]
