"""A table of columns, from text or of arrays, as a recording: which column is what, in which unit,
on which clock. All that is wrong with it is said at once, with the options that put it right."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from handcal.recordings.inputs import _proposal as proposal
from handcal.recordings.inputs._cells import Table
from handcal.recordings.inputs._names import ASIDE, Found, Understood, understood, unknown_columns
from handcal.recordings.inputs._options import (
    ALONE,
    HALVES,
    Options,
    parse_unit,
    permuted,
    quantities,
    si,
    unit_factor,
)
from handcal.recordings.inputs._repair import Columns, assemble, assemble_alone, columns
from handcal.recordings.inputs._stamps import Clock, counted, is_counter, stamped
from handcal.recordings.streams import STREAMS
from handcal.types import Array, BoolArray, InputError, IntArray, Recording


def of_arrays(path: Path, named: Mapping[str, Array | IntArray], options: Options) -> Recording:
    """A recording of arrays (n,) by what a header would call them. Errors: InputError."""
    arrays = list(named.values())
    return recording(Table(path, tuple(named), len(arrays), *_of_columns(arrays)), options)


def of_matrix(path: Path, matrix: Array, options: Options) -> Recording:
    """A recording of a matrix whose columns (or, where it lies, rows) have no names. Errors:
    InputError."""
    columns = list(matrix.T if matrix.shape[0] >= matrix.shape[1] else matrix)
    return recording(Table(path, (), len(columns), *_of_columns(columns)), options)


def _of_columns(
    arrays: Sequence[Array | IntArray],
) -> tuple[Callable[[Sequence[int]], Array], Callable[[int], Clock]]:
    def numbers(places: Sequence[int]) -> Array:
        return np.column_stack([np.asarray(arrays[k], dtype=np.float64) for k in places])

    return numbers, lambda place: arrays[place]


def recording(table: Table, options: Options) -> Recording:
    """The recording of a table. Errors: InputError."""
    table = _named(table, options)
    rate = options.rate_hz or table.rate_hz
    clock = [] if rate else ["time"]
    known = understood(table.names, table.units, [*clock, *options.needs])
    if not set(HALVES) & set(known.found):
        known = understood(table.names, table.units, [*clock, *HALVES])
    units, said, wrong = _units(table, known, options)
    wrong += _doubts(table, known, options)
    if wrong:
        raise proposal.refusal(table, known, options, wrong)
    ns = _clock(table, known, units, options, said)
    kept = _of_first_sensor(table, known, len(ns), said)
    held = {q: _value(table, known, q, units) for q in units if q in ("gyro", "accel", *STREAMS)}
    if known.unused:
        listed = ", ".join(repr(name[:40]) for name in known.unused[:12])
        said.append(f"Columns not used: {listed}.")
    sensors = {q: columns(ns, value).rows(kept) for q, value in held.items()}
    streams = {q: _measured(q, some, said) for q, some in sensors.items() if q in STREAMS}
    if lone := _lone(known):
        return assemble_alone(table.path, lone, sensors[lone], streams, tuple(said))
    return assemble(table.path, sensors["gyro"], sensors["accel"], streams, tuple(said))


def _lone(known: Understood) -> str:
    """The one sensor that a table holds; empty where it holds both or none."""
    held = [sensor for sensor in HALVES if sensor in known.found]
    return held[0] if len(held) == 1 else ""


def _named(table: Table, options: Options) -> Table:
    """The table with the names that the user gives; a unit in its own header stays. Errors:
    InputError."""
    given = options.columns
    if not given:
        return table
    wrong = unknown_columns(given)
    if len(given) > table.width:
        wrong.append(f"--columns names {len(given)} columns, and there are {table.width}")
    if wrong:
        raise InputError(f"{table.path}: {'; '.join(wrong)}.")
    own = understood(table.names, table.units, ())
    stated = {at: f.unit for f in own.found.values() for _, some in f.terms for at in some}
    names = given + (ASIDE,) * (table.width - len(given))
    return replace(table, names=names, units=tuple(stated.get(k, "") for k in range(table.width)))


def _units(
    table: Table, known: Understood, options: Options
) -> tuple[dict[str, str], list[str], list[str]]:
    """Unit by quantity, SI where none is stated; what is said, and what is wrong. A slower stream
    in an unknown unit is left out."""
    units: dict[str, str] = {}
    said, wrong = [], []
    for quantity, found in known.found.items():
        unit = options.units.get(quantity) or found.unit
        if not si(quantity) or not unit:
            units[quantity] = si(quantity)
        elif parsed := parse_unit(quantity, unit):
            units[quantity] = parsed
        elif quantity == "time" and not isinstance(table.clock(_place(found)), np.ndarray):
            units[quantity] = ""
        else:
            names = ", ".join(repr(table.names[at][:40]) for _, some in found.terms for at in some)
            doubt = f"the unit of column {names} ({unit[:40]}) is none of {quantity}'s"
            if quantity in STREAMS:
                said.append(f"{quantity}: {doubt}; it was left out (--units {quantity}=...).")
            else:
                wrong.append(f"{doubt}, which are {', '.join(quantities()[quantity])}")
    if known.producer is not None and known.producer.axes:
        axes = "; ".join(f"{s} {','.join(some)}" for s, some in known.producer.axes.items())
        said.append(f"This is taken for {known.producer.name}: its axes were turned ({axes}).")
    return units, said, wrong


def _doubts(table: Table, known: Understood, options: Options) -> list[str]:
    """What the table lacks, and what its numbers cannot be without a word of the user's."""
    if not table.names:
        return ["it has no line with the names of its columns"]
    wrong = []
    if known.missing:
        listed = ", ".join(repr(name[:40]) for name in known.unused[:12])
        lost = f" (not understood: {listed})" if listed else ""
        wrong.append(f"it lacks columns for {', '.join(known.missing)}{lost}")
    if _lone(known) and not set(options.needs) <= set(known.found):
        wrong.append(ALONE.rstrip("."))
    time, accel = known.found.get("time"), known.found.get("accel")
    if time and not (time.unit or options.units.get("time") or options.rate_hz):
        clock = table.clock(_place(time))
        if isinstance(clock, np.ndarray) and is_counter(clock) and "nanos" not in known.found:
            wrong.append("time counts samples")
    if accel and not (accel.unit or options.units.get("accel")):
        doubt = proposal.implausible(_as_written(table, accel))
        wrong += [doubt] if doubt else []
    return wrong


def _place(found: Found) -> int:
    return found.terms[0][1][0]


def _clock(
    table: Table, known: Understood, units: Mapping[str, str], options: Options, said: list[str]
) -> IntArray:
    """Stamps (n,) in ns. Errors: InputError."""
    found = known.found.get("time")
    clock = table.clock(_place(found)) if found else None
    rate = options.rate_hz or (None if found else table.rate_hz)
    if rate is not None:
        size = len(table.numbers([_place(next(iter(known.found.values())))]))
        said.append(f"Times are counted, {rate:g} samples a second.")
        return counted(clock, size, rate)
    assert found is not None
    assert clock is not None
    date = known.found.get("date")
    if date is not None and _place(date) != _place(found) and not isinstance(clock, np.ndarray):
        days = table.clock(_place(date))
        clock = [f"{day} {time}" for day, time in zip(days, clock, strict=True)]
    nanos = known.found.get("nanos")
    if nanos is not None and isinstance(clock, np.ndarray) and clock.dtype.kind == "i":
        further = np.rint(table.numbers([_place(nanos)])[:, 0])
        return clock.astype(np.int64) * 10**9 + further.astype(np.int64)
    stated = "time" in options.units or found.unit
    return stamped(str(table.path), clock, units["time"] if stated else "", said)


def _of_first_sensor(table: Table, known: Understood, size: int, said: list[str]) -> BoolArray:
    """Which rows (n,) are of the first of several sensors."""
    if known.one_of is None:
        return np.ones(size, dtype=np.bool_)
    which = table.numbers([known.one_of])[:, 0]
    first: BoolArray = which == which[0]
    if not first.all():
        said.append(f"Of {len(np.unique(which))} sensors, number {which[0]:g} is read.")
    return first


def _as_written(table: Table, found: Found) -> Array:
    """Readings (n, k) in the file's unit."""
    value: Array = np.sum([sign * table.numbers(some) for sign, some in found.terms], axis=0)
    return value


def _value(table: Table, known: Understood, quantity: str, units: Mapping[str, str]) -> Array:
    """Readings (n, k) in SI, in forward, left, up where the producer's axes are known."""
    value = _as_written(table, known.found[quantity]) * unit_factor(quantity, units[quantity])
    if known.producer is not None and quantity in known.producer.axes:
        value = permuted(value, known.producer.axes[quantity])
    return value


def _measured(name: str, held: Columns, said: list[str]) -> Columns:
    """A slower stream in a table is blank, or repeats itself until its next reading."""
    blank = np.all(np.isnan(held.value), axis=1)
    if blank.any() or len(held.ns) < 2:
        return held.rows(~blank)
    fresh = np.concatenate([[True], np.any(np.diff(held.value, axis=0) != 0, axis=1)])
    # (what nothing observes is known between its readings, so repeating does no harm)
    if not STREAMS[name].observation or fresh.mean() > 0.5:
        return held
    said.append(f"{name}: only the {int(fresh.sum())} rows in which it changes are used.")
    return held.rows(fresh)
