"""What `handcal lab paper` and `lab thermal` write."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired, TypedDict

from handcal.results.kinds import Count, Floats, Kind, Six, Texts, Version
from handcal.results.parts import Level


class Paper(TypedDict):
    """A paper computed again."""

    schema: Kind[Literal["handcal/lab-paper/1"]]
    version: NotRequired[Version]
    number: str
    source: str
    claims: list[_Claim]
    beyond: list[_Beyond]
    tables: list[_Table]


class _Claim(TypedDict):
    claim: str
    printed: str
    computed: str
    verdict: Literal["holds", "holds, corrected", "does not hold", "not reproducible"]


class _Beyond(TypedDict):
    what: str
    paper: str
    handcal: str


class _Table(TypedDict):
    heading: str
    columns: Texts
    rows: list[Texts]


class Thermal(TypedDict):
    """Biases and scale factors against temperature."""

    schema: Kind[Literal["handcal/lab-thermal/1"]]
    version: NotRequired[Version]
    recordings: Annotated[Texts, "Paths."]
    from_degC: float
    to_degC: float
    pieces: Annotated[Count, "Stretches that were used."]
    curves: list[_ThermalCurve]
    noise: Annotated[list[Level], "Beyond the readings' own."]
    residual_rms: _ThermalResidualRms
    warnings: Annotated[Texts, "In sentences."]


class _ThermalCurve(TypedDict):
    effect: str
    name: str
    unit: str
    kind: Literal["polynomial", "spline"]
    degree: Count
    absolute: Annotated[bool, "False: only the change is known."]
    degC: Annotated[Floats, "Knots."]
    value: Annotated[Floats, "There."]
    sigma: Annotated[Floats, "Of those."]
    log_evidence_gain: Annotated[float, "Over a constant, nats."]
    runner_up: _RunnerUp
    zero_degC: NotRequired[Annotated[float, "", "of a polynomial"]]
    powers: NotRequired[
        Annotated[Floats, "Of (T - zero), from the constant on.", "of a polynomial"]
    ]


class _RunnerUp(TypedDict):
    curve: str
    log_evidence_less: float


class _ThermalResidualRms(TypedDict):
    before: Annotated[Six[float], "With one value for all temperatures."]
    after: Annotated[Six[float], "With the curves."]
    unit: str
