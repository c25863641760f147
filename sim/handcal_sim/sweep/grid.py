"""What a sweep runs: cells, each one world and one filter; the paper's grid, or one from a file.

A cell without an `r_h_rad` has it chosen by evidence. Units are those of the names.
"""

from __future__ import annotations

import hashlib
import json
import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from itertools import product
from pathlib import Path
from typing import Any

from handcal_sim.effects import check
from handcal_sim.errors import SimulationError, UnknownWord
from handcal_sim.motion import SCENARIOS
from handcal_sim.sweep.printed import FIGURES, PRINTED, Printed

Triple = tuple[float, float, float]
Effects = tuple[tuple[str, tuple[float, ...]], ...]
# Paper 002 has no heading where sigma(heading) in the filter is 100 "radii".
NO_HEADING_RAD = 100.0
AUTO, MATCHED, NONE, UNKNOWN = "auto", "matched", "none", "unknown"
SCALES = ("gyro_scale", "accel_scale")
FILTER = ("start_heading_deg", "start_tilt_deg", "draw_start", "settle", "position_m",
          "velocity_m_s", "gyro_prior_deg_s", "accel_prior")  # fmt: skip


@dataclass(frozen=True)
class World:
    """What is true, by default in paper 002, tables 2 to 9 (as far as it can be inferred).

    arw: gyro noise, deg/s/sqrt(Hz); vrw: accelerometer noise, ug/sqrt(Hz). heading_rate_hz
    0: with every IMU sample. effects: by id, the values as `handcal simulate` takes them.
    sway 0: a hand that holds perfectly still.
    """

    scenario: str = "z-turn"
    duration_s: float = 30.0
    rate_hz: float = 100.0
    heading_sigma_deg: float = 5.0
    heading_rate_hz: float = 0.0
    arw: float = 0.005
    vrw: float = 250.0
    gyro_bias_deg_h: Triple = (1000.0, 1200.0, 1500.0)
    accel_bias_mg: Triple = (40.0, 50.0, 60.0)
    effects: Effects = (("accel_scale", (0.0, 0.0, -7750e-6)),)
    sway: float = 0.0


@dataclass(frozen=True)
class Cell:
    """One world and one filter.

    r_h_rad: the heading noise that the filter is told, None: chosen by evidence. estimate:
    effects whose parameters are states besides the fifteen. start_*_deg: sigma of the
    prior of the start's attitude (heading inf: unknown); the start itself is true, or drawn
    from that prior (draw_start). settle: besides the online filter, handcal's own relinearised
    calibration gives the end. position_m, velocity_m_s: of the pseudo-observations.
    gyro_prior_deg_s, accel_prior: sigma of the biases' priors, deg/s and m/s^2.
    """

    world: World = World()
    r_h_rad: float | None = 0.1
    estimate: tuple[str, ...] = ()
    start_heading_deg: float = 0.0
    start_tilt_deg: float = 1.0
    draw_start: bool = False
    settle: bool = False
    position_m: float = 0.02
    velocity_m_s: float = 0.02
    gyro_prior_deg_s: float = 1.0
    accel_prior: float = 0.6
    group: str = ""
    printed: Printed | None = None
    figures: tuple[int, int] | None = None

    @property
    def without_heading(self) -> bool:
        """Heading counts for nothing."""
        return self.r_h_rad is not None and self.r_h_rad >= NO_HEADING_RAD

    @property
    def r_h(self) -> str:
        """R_h in words."""
        return "evidence" if self.r_h_rad is None else f"{self.r_h_rad:.4g} rad"

    @property
    def key(self) -> str:
        """The same for the same numbers, whatever the grid: names what was computed."""
        told = asdict(replace(self, group="", printed=None, figures=None))
        return _digest(told)


def told(cell: Cell) -> dict[str, Any]:
    """What the filter is told besides R_h and its states, ready for JSON."""
    out = {k: v for k, v in asdict(cell).items() if k in FILTER}
    heading = cell.start_heading_deg
    return out | {"start_heading_deg": heading if math.isfinite(heading) else UNKNOWN}


def inherited(cells: Sequence[Mapping[str, Any]]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Of a sweep's cells (as in its document): what is the same in all of them, as in paper 002 and
    otherwise."""
    usual = asdict(World()) | told(Cell())
    each = [{**cell["world"], **cell.get("filter", {})} for cell in cells]
    same = {k: v for k, v in each[0].items() if all(e.get(k) == v for e in each)} if each else {}
    as_paper = {k: v for k, v in same.items() if _plain(v) == _plain(usual[k])}
    return as_paper, {k: v for k, v in same.items() if k not in as_paper}


def _plain(value: Any) -> Any:
    """With lists where there were tuples, as JSON has it."""
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value


def noise_key(world: World) -> int:
    """What noise is drawn from besides the seed: filters of one world get the same readings."""
    return int(_digest(asdict(world))[:12], 16)


def _digest(thing: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(thing, sort_keys=True).encode()).hexdigest()[:16]


def paper() -> list[Cell]:
    """Section 3.3 of paper 002: no heading, then four heading sigmas with three R_h each."""
    cells = []
    for (sigma, r_h), printed in PRINTED.items():
        if sigma is None:
            world, group = World(), "no heading"
        else:
            world, group = World(heading_sigma_deg=sigma), f"heading {sigma:g}°"
        figures = FIGURES.get((sigma, r_h))
        cells.append(
            Cell(world, r_h, group=group, printed=printed or None, figures=figures)
        )  # fmt: skip
    return cells


def turns() -> list[Cell]:
    """The paper's grid as a z turn and with one turn about each axis, 21 states in both."""
    cells = []
    for scenario in ("z-turn", "three-turns"):
        for cell in paper():
            world = replace(cell.world, scenario=scenario)
            cells.append(
                replace(cell, world=world, estimate=SCALES, group=f"{scenario}, {cell.group}",
                        printed=None, figures=None)
            )  # fmt: skip
    return cells


def with_evidence(cells: Sequence[Cell]) -> list[Cell]:
    """The cells, and after those that differ in R_h alone one that chooses R_h itself."""
    out: list[Cell] = []
    for i, cell in enumerate(cells):
        out.append(cell)
        itself = replace(cell, r_h_rad=None, printed=None, figures=None)
        later = {_without_r_h(other) for other in cells[i + 1 :]}
        if not cell.without_heading and _without_r_h(cell) not in later and itself not in out:
            out.append(itself)
    return out


def _without_r_h(cell: Cell) -> Cell:
    return replace(cell, r_h_rad=None, printed=None, figures=None)


# ---- grids from files -------------------------------------------------------------------------

_WORLD = {f.name: f.default for f in fields(World)}
_FILTER = {
    f.name: f.default for f in fields(Cell)
    if f.name not in ("world", "group", "printed", "figures")
}  # fmt: skip
_KEYS = (*_WORLD, *_FILTER)
_POSITIVE = ("duration_s", "rate_hz", "position_m", "velocity_m_s", "gyro_prior_deg_s",
             "accel_prior", "r_h_rad")  # fmt: skip


def read_grid(path: Path) -> list[Cell]:
    """Cells of a TOML file; SimulationError says in a sentence what is wrong with it.

    `[common]` holds values for all, `[grid]` (or several `[[grid]]`) a list of values for
    each key that varies; the cells are all combinations. Keys are the fields of World and
    Cell; everything has the paper's value as its default.
    """
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as problem:  # (a number of 5,000 digits, too)
        raise SimulationError(f"{path} is not TOML: {problem}") from None
    if odd := sorted(set(document) - {"common", "grid"}):
        raise SimulationError(f"{path}: there is no table {odd[0]!r}, only [common] and [grid]")
    common, grids = document.get("common", {}), document.get("grid", {})
    grids = grids if isinstance(grids, list) else [grids]
    if not isinstance(common, dict) or not all(isinstance(grid, dict) for grid in grids):
        raise SimulationError(f"{path}: [common] and [grid] must be tables")
    cells: list[Cell] = []
    for grid in grids:
        try:
            cells += [cell for cell in _cells(common, grid) if cell not in cells]
        except SimulationError as problem:
            raise SimulationError(f"{path}: {problem}") from None
    return cells


def _cells(common: Mapping[str, Any], grid: Mapping[str, Any]) -> Iterator[Cell]:
    for key in (*common, *grid):
        if key not in _KEYS:
            raise SimulationError(f"there is no key {key!r}; there are {', '.join(_KEYS)}")
    for key, values in grid.items():
        if not isinstance(values, list) or not values:
            raise SimulationError(f"{key} in [grid] must be a list of values to run through")
    for values in product(*grid.values()):
        chosen = dict(zip(grid, values, strict=True))
        group = ", ".join(
            f"{k} {_word(v)}" for k, v in chosen.items() if k != "r_h_rad" and len(grid[k]) > 1
        )
        yield _cell({**common, **chosen}, group or "all")


def _word(value: Any) -> str:
    if isinstance(value, dict):
        return "+".join(value) or NONE
    return "+".join(map(str, value)) or NONE if isinstance(value, list) else str(value)


def _cell(given: Mapping[str, Any], group: str) -> Cell:
    values = {key: _value(key, value) for key, value in given.items()}
    world = World(**{k: v for k, v in values.items() if k in _WORLD})
    told = {k: v for k, v in values.items() if k in _FILTER}
    if told.get("r_h_rad") == MATCHED:
        if world.heading_sigma_deg == 0.0:
            raise SimulationError("r_h_rad cannot match a heading_sigma_deg of 0")
        told["r_h_rad"] = math.radians(world.heading_sigma_deg)
    if world.scenario not in SCENARIOS:
        raise UnknownWord("scenario", world.scenario, SCENARIOS)
    return Cell(world, group=group, **told)


def _value(key: str, value: Any) -> Any:
    default = {**_WORLD, **_FILTER}[key]
    if key == "r_h_rad" and value in (AUTO, MATCHED, NONE):
        return {AUTO: None, MATCHED: MATCHED, NONE: NO_HEADING_RAD}[value]
    if key == "start_heading_deg" and value == UNKNOWN:
        return math.inf
    if key == "effects":
        return _effects(value)
    if key == "estimate":
        if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
            raise SimulationError(f"estimate is a list of effects, not {value!r}")
        return tuple(value)
    if isinstance(default, bool | str):
        if not isinstance(value, type(default)):
            raise SimulationError(f"{key} is not {value!r}")
        return value
    if isinstance(default, tuple):
        if not isinstance(value, list) or len(value) != 3:
            raise SimulationError(f"{key} takes three numbers, not {value!r}")
        return tuple(_number(key, v) for v in value)
    number = _number(key, value)
    if number < 0.0 or (number == 0.0 and key in _POSITIVE):
        raise SimulationError(f"{key} {number:g} is too small")
    if key == "rate_hz" and not 10.0 <= number <= 2000.0:
        raise SimulationError(f"rate_hz {number:g} is not between 10 and 2000")
    return number


def _number(key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise SimulationError(f"{key} takes a number, not {value!r}")
    return float(value)


def _effects(value: Any) -> Effects:
    if not isinstance(value, dict):
        raise SimulationError(f"effects are {{id = [values], ...}}, not {value!r}")
    out = []
    for name, values in value.items():
        if not isinstance(values, list):
            raise SimulationError(f"effects: {name} takes a list of values, not {values!r}")
        numbers = tuple(_number(name, v) for v in values)
        check(name, numbers)
        out.append((name, numbers))
    return tuple(sorted(out))
