"""Options that several commands share, and what is made of them as typed."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from handcal.commands._precompile import compiled_ahead
from handcal.commands._progress import progress
from handcal.commands._registry import say

if TYPE_CHECKING:
    from handcal.device.apply import Learnt
    from handcal.trust import Trust
    from handcal.types import Prior, Recording, Result


class Assume(StrEnum):
    """What may be taken for granted about the hand."""

    auto = "auto"
    fixed_point = "fixed-point"
    rest_only = "rest-only"


class Engine(StrEnum):
    """Which implementation of the same filter runs."""

    compiled = "compiled"
    filterpy = "filterpy"


Topics = Annotated[
    list[str] | None,
    typer.Option(
        "--topic",
        metavar="NAME=TOPIC",
        help="Topic of a stream: imu=/phone/imu, or gyro=/a and accel=/b if these are separate "
        "topics (repeatable).",
    ),
]
Units = Annotated[
    str | None,
    typer.Option(
        metavar="NAME=UNIT,...",
        help="Units in the file, if not SI: accel=g,gyro=deg/s; of raw counts "
        "accel=g/16384,gyro=deg/s/131.",
    ),
]
ColumnsOf = Annotated[
    str | None,
    typer.Option(
        "--columns",
        metavar="NAME,...",
        help="Columns of a table, in order: t,gx,gy,gz,ax,ay,az; - skips a column.",
    ),
]
Rate = Annotated[
    float | None,
    typer.Option(
        "--rate",
        metavar="HZ",
        help="Sampling rate of a table that has no times, or whose time column counts samples.",
    ),
]
AxesOf = Annotated[
    list[str] | None,
    typer.Option(
        "--axes",
        metavar="SENSOR=AXES",
        help="Axes of gyro, accel or mag that are the IMU's x, y, z: mag=y,x,-z (repeatable).",
    ),
]
UnitsToo = Annotated[
    str | None,
    typer.Option(
        metavar="si|UNIT,...|NAME=UNIT,...",
        help="Units to show: si, or any of deg, deg/h, mrad, rad, mg, g, m/s^2, percent, ppm, "
        "mm, ms (JSON is always SI). NAME=UNIT is a unit in the file that is not SI: "
        "accel=g, accel=g/16384.",
    ),
]
Effects = Annotated[
    str,
    typer.Option(
        metavar="ID,...",
        help="Effects to estimate beyond those that every device has: gyro_quadratic,gravity.",
    ),
]
Only = Annotated[
    bool,
    typer.Option(
        "--only",
        help="Estimate only biases and --effects. The sigmas then hold only if the device has no "
        "other errors.",
    ),
]
HeadingSigma = Annotated[
    float | None,
    typer.Option(
        metavar="DEG", min=0.0, help="Heading noise, 1 sigma; estimated from the data if not given."
    ),
]
Assumption = Annotated[
    Assume,
    typer.Option(
        help="Assumption about the hand. fixed-point: the held point does not move; rest-only: "
        "the device is still in detected rests only; auto: chosen by evidence."
    ),
]
Latitude = Annotated[
    float | None,
    typer.Option(
        metavar="DEG", min=-90.0, max=90.0, help="Latitude, which sets gravity and the Earth rate."
    ),
]
Height = Annotated[
    float, typer.Option(metavar="M", help="Height above the ellipsoid, with --latitude.")
]
Ignore = Annotated[
    list[str] | None,
    typer.Option(metavar="STREAM", help="Leave a stream out: heading, mag, pose (repeatable)."),
]
ReferenceExact = Annotated[
    bool,
    typer.Option(
        "--reference-exact",
        help="/reference has no bias (a turntable): every difference is an error of the IMU.",
    ),
]
NoiseUntil = Annotated[
    float | None,
    typer.Option(metavar="S", min=0.0, help="Estimate noise levels from the first S seconds only."),
]
EngineOption = Annotated[
    Engine,
    typer.Option(help="Filter implementation: compiled, or filterpy (same mathematics, slower)."),
]
Anyway = Annotated[
    bool,
    typer.Option("--anyway", help="Accept a result even if its trust is none."),
]
Json = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Write the numbers as JSON; - for standard output."),
]
Report = Annotated[Path | None, typer.Option(metavar="FILE.html", help="Write a report to read.")]
Rrd = Annotated[
    Path | None, typer.Option(metavar="FILE.rrd", help="Save a recording for the Rerun viewer.")
]
EffectsFrom = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Add the effect files (*.py) of this folder to the catalogue. This runs their code: "
        "name only a folder that you trust.",
    ),
]


def say_what_runs(folder: Path) -> None:
    """That the code of a folder's effect files is run. Errors: InputError where there is none."""
    from handcal.user_effects import files

    names = ", ".join(path.name for path in files(folder))
    say(f"running the code of {names} in {folder}, as --effects-from asks")


def _shaped(run: Callable[..., None], parameters: Sequence[Parameter]) -> Callable[..., None]:
    """A function that the command line sees with these parameters."""
    run.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {p.name: p.annotation for p in parameters}
    return run


def _option(name: str, annotation: object) -> Parameter:
    return Parameter(name, Parameter.KEYWORD_ONLY, default=None, annotation=annotation)


def with_own_effects(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the option --effects-from: it runs with those effects in the catalogue. One
    that has that option itself is told the folder."""
    own = signature(command, eval_str=True)
    told = "effects_from" in own.parameters

    @wraps(command)
    def run_with(*arguments: Any, effects_from: Path | None = None, **options: Any) -> None:
        if told:
            options["effects_from"] = effects_from
        if effects_from is None:
            command(*arguments, **options)
            return
        from handcal import user_effects

        say_what_runs(effects_from)
        with user_effects.effects_from(effects_from):
            command(*arguments, **options)

    others = [p for name, p in own.parameters.items() if name != "effects_from"]
    return _shaped(run_with, [*others, _option("effects_from", EffectsFrom)])


@dataclass(frozen=True)
class Reading:
    """What was typed of the file of a recording."""

    topic: list[str] | None = None
    units: str | None = None
    columns: str | None = None
    rate: float | None = None
    axes: list[str] | None = None

    @property
    def topics(self) -> dict[str, str]:
        """Topic by stream. Errors: InputError."""
        return pairs(self.topic or [], "--topic")

    @property
    def said(self) -> dict[str, Any]:
        """The options as ``handcal.load`` takes them. Errors: InputError."""
        return {
            "topics": self.topics,
            "units": pairs(comma_separated(self.units or ""), "--units"),
            "columns": tuple(
                word.strip() for word in (self.columns or "").split(",") if self.columns
            ),
            "rate_hz": self.rate,
            "axes": pairs(self.axes or [], "--axes"),
        }

    @property
    def typed(self) -> list[str]:
        """The options as they were typed."""
        one = [("--units", self.units), ("--columns", self.columns), ("--rate", self.rate)]
        several = [("--topic", self.topic), ("--axes", self.axes)]
        one += [(name, word) for name, words in several for word in words or ()]
        return [word for name, value in one if value is not None for word in (name, str(value))]


AS_IT_IS = Reading()
_READING = {"topic": Topics, "units": Units, "columns": ColumnsOf, "rate": Rate, "axes": AxesOf}


def reads_recordings(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the options that say what is in a file, which it gets as ``how``; one of
    them that it has itself stays its own."""
    own = signature(command, eval_str=True).parameters
    names = [name for name in _READING if name not in own]

    @wraps(command)
    def run_reading(*arguments: Any, **options: Any) -> None:
        how = Reading(**{name: options.pop(name, None) for name in names})
        command(*arguments, how=how, **options)

    others = [p.replace(kind=Parameter.KEYWORD_ONLY) for n, p in own.items() if n != "how"]
    at = list(own).index("how")
    added = [_option(name, _READING[name]) for name in names]
    return _shaped(run_reading, [*others[:at], *added, *others[at:]])


def in_units(command: Callable[..., None]) -> Callable[..., None]:
    """The command, showing its numbers in the units that --units asks for; what it says of the
    file (NAME=UNIT) is left to the command."""
    own = signature(command, eval_str=True).parameters

    @wraps(command)
    def run_in(*arguments: Any, units: str | None = None, **options: Any) -> None:
        from handcal.units import showing

        items = comma_separated(units or "")
        of_file = [u for u in items if "=" in u]
        with showing([u for u in items if "=" not in u]):
            command(*arguments, units=",".join(of_file) or None, **options)

    shown = {"units": own["units"].replace(annotation=UnitsToo)}
    return _shaped(run_in, list({**own, **shown}.values()))


def comma_separated(text: str) -> tuple[str, ...]:
    """Words with commas between them."""
    return tuple(word.strip() for word in text.split(",") if word.strip())


def pairs(items: Sequence[str], option: str) -> dict[str, str]:
    """NAME=VALUE strings as a dictionary. Errors: InputError."""
    from handcal.types import InputError

    pairs: dict[str, str] = {}
    for item in items:
        name, equals, value = item.partition("=")
        if not (equals and name.strip()):
            raise InputError(f"{option} {item}: expected NAME=VALUE.")
        pairs[name.strip()] = value.strip()
    return pairs


def load(
    path: Path, how: Reading = AS_IT_IS, needs: tuple[str, ...] = ("gyro", "accel")
) -> Recording:
    """A recording with the options as typed; needs: sensors that it has to hold. Errors:
    InputError."""
    import handcal

    said = how.said
    with progress(f"reading {path.name}") as report:
        recording: Recording = handcal.load(path, **said, progress=report, needs=needs)
    return recording


def heard(path: Path, own: Trust, anyway: bool) -> None:
    """Say what a result doubts of itself. Errors: HandcalError where it is not to be trusted."""
    from handcal import trust

    trust.check(str(path), own, anyway)
    for doubt in trust.said(str(path), own):
        say(doubt)


@contextlib.contextmanager
def learnt_in(path: Path, anyway: bool) -> Iterator[Learnt]:
    """What a result holds of a device, its laws in the catalogue meanwhile; what it doubts of
    itself is said. Errors: InputError, HandcalError where it is not to be trusted."""
    from handcal.device.apply import of_document
    from handcal.documents import read_json
    from handcal.explain.model_file import laws_of

    document = read_json(path)
    with laws_of(str(path), document):
        learnt = of_document(str(path), document)
        heard(path, learnt.trust, anyway)
        yield learnt


def say_unused(recordings: Sequence[Recording], given: Mapping[str, Any]) -> None:
    """Say which options are left aside, being for something that is not there."""
    there = {name for r in recordings for name in r.streams} - set(given["ignore"] or ())
    if given["height"] and given["latitude"] is None:
        say("--height is ignored: it needs --latitude (without it, gravity is standard gravity)")
    if given["heading_sigma"] is not None and not there & {"heading", "mag"}:
        say("--heading-sigma is ignored: there is no heading")
    if given.get("reference_exact") and "reference" not in there:
        say("--reference-exact is ignored: there is no /reference")


def radians(degrees: float | None) -> float | None:
    """An angle as typed; None for unset."""
    return None if degrees is None else math.radians(degrees)


def calibrated(
    recordings: list[Recording], effects: str, learnt_from: Path | None = None,
    before: Prior | None = None, anyway: bool = False, **settings: Any,
) -> tuple[Result, ...]:  # fmt: skip
    """Run the filter with the options as typed: angles in degrees, enums, None for unset."""
    from handcal.estimate.calibration import calibrate_together, recalibrate
    from handcal.types import InputError

    for name in ("heading_sigma", "latitude", "height", "noise_until"):
        value = settings[name]
        if value is not None and not math.isfinite(value):
            raise InputError(f"--{name.replace('_', '-')} {value}: expected a finite number.")
    for name in ("heading_sigma", "latitude"):
        settings[name] = radians(settings[name])
    say_unused(recordings, settings)
    settings |= {"assume": str(settings["assume"]), "engine": str(settings["engine"])}
    settings["ignore"] = tuple(settings["ignore"] or ())
    ids = comma_separated(effects)
    names = ", ".join(Path(r.path).name for r in recordings)
    if learnt_from is None:
        with progress(f"calibrating {names}") as report, compiled_ahead():
            return calibrate_together(recordings, ids, progress=report, before=before, **settings)
    from handcal.documents import read_json
    from handcal.explain.model_file import read
    from handcal.trust import of_document

    usual = {"assume": "auto", "engine": "compiled", "height": 0.0, "ignore": (),
             "reference_exact": False, "only": False}  # fmt: skip
    own = [n for n, v in settings.items() if v != usual.get(n)]
    if ids or own:
        said = ", ".join(f"--{n.replace('_', '-')}" for n in (["effects"] if ids else []) + own)
        raise InputError(f"--from already sets the model and its options: leave out {said}.")
    heard(learnt_from, of_document(str(learnt_from), read_json(learnt_from)), anyway)
    chosen = read(learnt_from)
    with progress(f"calibrating {names}") as report, compiled_ahead():
        return recalibrate(recordings, chosen, report, before)
