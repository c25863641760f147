"""Results in the formats of other programs: one file a format, and the folder listing is the list.

A file defines ``FORMAT = Format(...)``; nothing else needs to know of it. What a format is given is
a ``Contents``: the correction as matrices, and beside it all that a header says. Formats come from
this folder and from packages that entry points of the group ``handcal.exports`` name.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import entry_points
from typing import Any

from handcal.did_you_mean import did_you_mean
from handcal.exports._correction import Correction
from handcal.types import Array, InputError, Recording

GROUP = "handcal.exports"


@dataclass(frozen=True)
class Noise:
    """Noise of the IMU: density and bias walk of gyro and accelerometer, SI; None: not known.

    sources: where each is from, in words.
    """

    gyro_noise: float | None = None
    accel_noise: float | None = None
    gyro_bias_walk: float | None = None
    accel_bias_walk: float | None = None
    sources: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Contents:
    """What a format writes.

    name: of the result's file. header: lines of text without any sign of a comment. correction:
    what the format can hold of what is known. bias (6,): known biases, gyro first, whether or not
    the format holds them, and bias_sigma (6,), nan where the result does not say it; hidden: axes
    of "gyro_bias" and "accel_bias" that were not shown (their bias counts as zero). has_bias:
    whether the result has biases at all. rate_hz: of the IMU, None if the result does not say.
    topic: of the Imu messages, "" if not known. axes: "flu" or "frd", what the recording's axes are
    on a vehicle. vehicle: parameters of its own calibration, by name. readings: "raw", "corrected"
    by these, or "" if nothing says it; instance: which of the vehicle's sensors "gyro" and "accel"
    were, as the user says. marker: of a pose, R (3, 3) from its axes to the IMU's, and its place in
    them (3,), m, nan if that is not known. parameters: rows of the result, as its JSON has them.
    """

    name: str
    header: tuple[str, ...]
    correction: Correction
    bias: Array
    bias_sigma: Array
    hidden: Mapping[str, str]
    has_bias: bool
    noise: Noise
    rate_hz: float | None
    topic: str
    axes: str
    vehicle: Mapping[str, float]
    readings: str
    instance: Mapping[str, int]
    marker: tuple[Array, Array] | None
    parameters: Sequence[Mapping[str, Any]]

    def commented(self, sign: str = "# ") -> str:
        """The header, each line behind a sign."""
        return "".join(f"{sign}{line}".rstrip() + "\n" for line in self.header)


def everything(correction: Correction) -> Correction:
    """What a format keeps of a correction if it can hold all of it."""
    return correction


@dataclass(frozen=True)
class Format:
    """A format: the program that reads it, one line for the list, and how it is written.

    write(contents): the text. keep(correction): the part of a correction that the format can hold,
    None for a format that corrects nothing (a table). notes: lines for the header. needs_bias:
    writing zeros where there are no biases would be wrong. online: the program finds biases itself,
    so it is no fault that the format has none. vehicle: of a program that flies a
    vehicle, with what the names in its logs begin. says(contents): what of the text is said in the
    terminal too, beside the header. lacks(vehicle): of a log's parameters, why its result could
    not be written. noise: levels that it holds, by their names in ``Noise``, each with the value
    that it has where none was measured; None for one that is needed.
    """

    program: str
    line: str
    write: Callable[[Contents], str]
    keep: Callable[[Correction], Correction] | None = everything
    notes: tuple[str, ...] = field(default=())
    needs_bias: bool = False
    online: bool = False
    vehicle: tuple[str, ...] = ()
    says: Callable[[Contents], Sequence[str]] = lambda _contents: ()
    lacks: Callable[[Mapping[str, float]], Sequence[str]] = lambda _vehicle: ()
    noise: Mapping[str, float | None] = field(default_factory=dict)


@cache
def formats() -> Mapping[str, Format]:
    """Every format by its name. Raises InputError where a package has something else to offer."""
    found: dict[str, Format] = {}
    packages = [__name__, *sorted(e.value for e in entry_points(group=GROUP))]
    for package in packages:
        for info in pkgutil.iter_modules(importlib.import_module(package).__path__):
            if info.name.startswith("_"):
                continue
            made = getattr(importlib.import_module(f"{package}.{info.name}"), "FORMAT", None)
            if not isinstance(made, Format) or info.name in found:
                raise InputError(
                    f"{package}.{info.name} has no FORMAT, or one that is there already."
                )
            found[info.name] = made
    return found


def format_of(name: str) -> Format:
    """The format of this name, in any case. Raises InputError with a list of those there are."""
    alike = {known.casefold(): known for known in formats()}
    found = name if name in formats() else alike.get(name.casefold())
    if found is None:
        near = did_you_mean(name, formats())
        raise InputError(f"Unknown format '{name}'.{near} Known: {', '.join(sorted(formats()))}.")
    return formats()[found]


def fitting(names: Sequence[str]) -> str:
    """The format for the vehicle in whose logs these names are; "" for none."""
    vehicles = {name: one.vehicle for name, one in formats().items() if one.vehicle}
    return next((v for v, own in vehicles.items() if any(n.startswith(own) for n in names)), "")


def of_vehicle(recording: Recording) -> str:
    """The format for the vehicle whose log a recording is; "" for none."""
    return fitting([*recording.vehicle, recording.topics.get("imu", "")])


def refusals(recording: Recording) -> list[str]:
    """Why a result of an autopilot's log could not be written for its vehicle, in sentences."""
    name = of_vehicle(recording)
    why = formats()[name].lacks(recording.vehicle) if name else ()
    return [f"handcal export --to {name} would refuse this log: {said}" for said in why]
