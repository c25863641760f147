"""What `handcal sweep` writes: the comparison, and one line a cell."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NotRequired, TypedDict

from handcal.results.kinds import Count, Floats, Kind, Number, Texts, Two, Vector


class Sweep(TypedDict):
    """Monte Carlo over heading noise and R_h."""

    schema: Kind[Literal["handcal-sim/sweep/1"]]
    grid: str
    seeds: Count
    seed: Count
    thresholds: Annotated[dict[str, float], "Of the convergence rule, by unit."]
    printed: Annotated[
        dict[str, _Printed], "By quantity: how many of the paper's values lie in the central 95 %."
    ]
    evidence: list[Evidence]
    side_by_side: list[SideBySide]
    cells: list[Cell]


class _Printed(TypedDict):
    inside: Count
    n: Count


class Evidence(TypedDict):
    """R_h chosen by evidence beside the best set by hand; of the vertical gyro bias."""

    group: str
    heading_sigma_deg: float
    r_h_rad: Spread
    final_rms: float
    best_r_h_rad: float
    best_final_rms: float
    over_best: Annotated[float, "Ratio of the two."]
    bound: float
    nees: float
    best_nees: float


class Spread(TypedDict):
    """One quantity over the seeds."""

    n: Annotated[Count, "Seeds that have it."]
    median: Number
    low: Annotated[Number, "Of the central 95 %."]
    high: Annotated[Number, "Of the central 95 %."]
    least: Number
    most: Number


class SideBySide(TypedDict):
    """Cells that differ in the motion alone: the vertical gyro bias."""

    heading_sigma_deg: Annotated[Number, "Null without heading."]
    r_h: Annotated[str, "As in the cell."]
    scenarios: Annotated[dict[str, Final], "By scenario."]


class Final(TypedDict):
    """The error at the end, over the seeds."""

    mean: float
    rms: float
    bound: Annotated[float, "Cramér and Rao's."]
    over_bound: Annotated[float, "rms over bound."]
    claimed: Annotated[float, "Median of the filter's sigmas."]
    nees: Annotated[float, "Mean square of error over sigma; 1 is right."]


class Cell(TypedDict):
    """One world and one filter over all seeds."""

    schema: Kind[Literal["handcal-sim/sweep-cell/1"]]
    key: Annotated[_Key, "What the result depends on."]
    group: Annotated[str, "Heading under which it is shown."]
    r_h: Annotated[str, "The heading noise that the filter is told, in words."]
    r_h_rad: Annotated[Number, "Null: chosen by evidence."]
    chosen_r_h_rad: Annotated[Spread | None, "Null where it was set."]
    world: World
    estimate: Annotated[Texts, "Effects that are states."]
    filter: NotRequired[
        Annotated[
            _Filter, "What the filter is told besides R_h and its states.", "of a newer program"
        ]
    ]
    without_heading: Annotated[bool, "Heading counts for nothing."]
    figures: Annotated[Two[Count] | None, "Of paper 002."]
    parameters: list[Swept]
    t: Annotated[Floats, "s"]
    bands: Bands


class _Key(TypedDict):
    cell: Annotated[str, "Digest of world and filter."]
    seeds: Count
    seed: Count
    thresholds: dict[str, float]


class World(TypedDict):
    """What is true in a cell; the keys of a grid's TOML."""

    scenario: str
    duration_s: float
    rate_hz: float
    heading_sigma_deg: float
    heading_rate_hz: Annotated[float, "0: with every reading of the IMU."]
    arw: Annotated[float, "Gyro noise, deg/s/sqrt(Hz)."]
    vrw: Annotated[float, "Accelerometer noise, ug/sqrt(Hz)."]
    gyro_bias_deg_h: Vector
    accel_bias_mg: Vector
    effects: Annotated[list[list[Any]], "Pairs of id and values."]
    sway: Annotated[float, "0: a hand that holds still."]


class _Filter(TypedDict):
    start_heading_deg: Annotated[float | str, "`unknown` where it is."]
    start_tilt_deg: float
    draw_start: Annotated[bool, "Whether the start is drawn from that prior."]
    settle: Annotated[bool, "Whether the relinearised calibration gives the end."]
    position_m: Annotated[float, "Of the pseudo-observation."]
    velocity_m_s: Annotated[float, "Of the pseudo-observation."]
    gyro_prior_deg_s: Annotated[float, "Sigma of the bias."]
    accel_prior: Annotated[float, "Sigma of the bias, m/s^2."]


class Swept(TypedDict):
    """A parameter over the seeds; in `unit`."""

    effect: Annotated[str, "Id."]
    name: Annotated[str, "Of the parameter."]
    unit: Annotated[str, "deg/h, ug or ppm; else SI."]
    truth: float
    convergence_s: Annotated[Beside, "By the rule of paper 002."]
    rms_error: Annotated[Beside, "About the truth, from then on."]
    rms: Annotated[Beside, "From then on."]
    final_error: Annotated[Final, "Of the online filter."]
    settled_error: Annotated[Final | None, "Of handcal's own calibration; null without `--settle`."]


class Beside(Spread):
    """One quantity over the seeds, beside what the paper prints."""

    printed: Annotated[Number, "In paper 002."]
    inside: Annotated[bool | None, "Whether that lies in the central 95 %."]


class Bands(TypedDict):
    """Median and central 95 % of the estimates: a row for each parameter, a column for each `t`."""

    low: list[Floats]
    median: list[Floats]
    high: list[Floats]


class SweepCell(Cell):
    """One finished cell, one line of the file."""
