"""The command line: ``handcal COMMAND``. Everything slow is imported where it is used.

Exit status: 0 done; 1 no result (a sentence says why); 2 wrong use or unreadable
input; 130 interrupted.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from enum import StrEnum
from functools import wraps
from inspect import Parameter, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from handcal import _memory
from handcal.commands import Commands, run, say
from handcal.progress import progress

if TYPE_CHECKING:
    from handcal.types import Recording, Result


class Assume(StrEnum):
    """What may be taken for granted about the hand."""

    auto = "auto"
    fixed_point = "fixed-point"
    rest_only = "rest-only"


class Engine(StrEnum):
    """Which implementation of the same filter runs."""

    compiled = "compiled"
    filterpy = "filterpy"


app = typer.Typer(
    cls=Commands, add_completion=False, pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)  # fmt: skip


def _version(wanted: bool) -> None:
    if wanted:
        from handcal import __version__

        print(f"handcal {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Say which version.")
    ] = False,
) -> None:
    """Calibrate cheap inertial sensors while they are simply turned in the hand."""


# Options that several commands share.
Topics = Annotated[
    list[str] | None,
    typer.Option(
        "--topic",
        metavar="NAME=TOPIC",
        help="Which MCAP topic is which stream, as imu=/phone/imu (repeatable).",
    ),
]
Units = Annotated[
    str | None,
    typer.Option(
        metavar="NAME=UNIT,...", help="Units in the file where they are not SI: accel=g,gyro=deg/s."
    ),
]
Effects = Annotated[
    str,
    typer.Option(
        metavar="ID,...", help="Effects to estimate beyond constant biases: gyro_scale,lever_arm."
    ),
]
HeadingSigma = Annotated[
    float | None,
    typer.Option(
        metavar="DEG", min=0.0, help="Noise of the heading; found from the data if not given."
    ),
]
Assumption = Annotated[
    Assume,
    typer.Option(
        help="fixed-point: the held point stays in its place; rest-only: still in detected rests "
        "alone; auto: chosen by evidence."
    ),
]
Latitude = Annotated[
    float | None,
    typer.Option(
        metavar="DEG", min=-90.0, max=90.0, help="Take gravity and the Earth's turning from here."
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
        help="/reference has no bias (a turntable): what both differ by is the IMU's.",
    ),
]
NoiseUntil = Annotated[
    float | None,
    typer.Option(metavar="S", min=0.0, help="Find noise levels in the first S seconds only."),
]
EngineOption = Annotated[
    Engine, typer.Option(help="compiled, or filterpy: slower, the same mathematics.")
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
        help="Take the effect files (*.py) of this folder into the catalogue. This runs their "
        "code: name no folder that you do not trust.",
    ),
]


def with_own_effects(command: Callable[..., None]) -> Callable[..., None]:
    """The command with the option --effects-from: it runs with those effects in the catalogue."""

    @wraps(command)
    def run_with(*arguments: Any, effects_from: Path | None = None, **options: Any) -> None:
        if effects_from is None:
            command(*arguments, **options)
            return
        from handcal import own_effects

        names = ", ".join(path.name for path in own_effects.files(effects_from))
        say(f"running the code of {names} in {effects_from}, as --effects-from asks")
        with own_effects.effects_from(effects_from):
            command(*arguments, **options)

    own = signature(command, eval_str=True)
    option = Parameter("effects_from", Parameter.KEYWORD_ONLY, default=None, annotation=EffectsFrom)
    run_with.__signature__ = own.replace(parameters=[*own.parameters.values(), option])  # type: ignore[attr-defined]
    run_with.__annotations__ = {**command.__annotations__, "effects_from": EffectsFrom}
    return run_with


def _pairs(items: list[str], option: str) -> dict[str, str]:
    """NAME=VALUE strings as a dictionary. Errors: InputError."""
    from handcal.types import InputError

    pairs: dict[str, str] = {}
    for item in items:
        name, equals, value = item.partition("=")
        if not (equals and name.strip()):
            raise InputError(f"{option} {item}: expected NAME=VALUE.")
        pairs[name.strip()] = value.strip()
    return pairs


def load(path: Path, topics: list[str] | None, units: str | None) -> Recording:
    """A recording with the options as typed. Errors: InputError."""
    import handcal

    chosen = _pairs(topics or [], "--topic")
    said = _pairs([u for u in (units or "").split(",") if u.strip()], "--units")
    with progress(f"reading {path.name}") as report:
        recording: Recording = handcal.load(path, topics=chosen, units=said, progress=report)
    return recording


def radians(degrees: float | None) -> float | None:
    """An angle as typed; None for unset."""
    return None if degrees is None else math.radians(degrees)


def _calibrated(
    recordings: list[Recording], effects: str, learnt_from: Path | None = None, **settings: Any
) -> tuple[Result, ...]:
    """Run the filter with the options as typed: angles in degrees, enums, None for unset."""
    from handcal.calibration import calibrate_together, recalibrate
    from handcal.types import InputError

    for name in ("heading_sigma", "latitude", "height", "noise_until"):
        value = settings[name]
        if value is not None and not math.isfinite(value):
            raise InputError(f"--{name.replace('_', '-')} {value}: expected a finite number.")
    for name in ("heading_sigma", "latitude"):
        settings[name] = radians(settings[name])
    settings |= {"assume": str(settings["assume"]), "engine": str(settings["engine"])}
    settings["ignore"] = tuple(settings["ignore"] or ())
    ids = tuple(e.strip() for e in effects.split(",") if e.strip())
    names = ", ".join(Path(r.path).name for r in recordings)
    if learnt_from is None:
        with progress(f"calibrating {names}") as report:
            return calibrate_together(recordings, ids, progress=report, **settings)
    from handcal.explain.written import read

    usual = {"assume": "auto", "engine": "compiled", "height": 0.0, "ignore": (),
             "reference_exact": False}  # fmt: skip
    own = [n for n, v in settings.items() if v != usual.get(n)]
    if ids or own:
        said = ", ".join(f"--{n.replace('_', '-')}" for n in (["effects"] if ids else []) + own)
        raise InputError(f"--from holds the model with its options; leave out {said}.")
    chosen = read(learnt_from)
    with progress(f"calibrating {names}") as report:
        return recalibrate(recordings, chosen, report)


@app.command()
@with_own_effects
def calibrate(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="Recordings of one device.")
    ],
    effects: Effects = "",
    learnt_from: Annotated[
        Path | None,
        typer.Option(
            "--from",
            metavar="RESULT.json",
            help="Repeat the fit that `explain --json` or `calibrate --json` wrote of these files; "
            "of others, estimate the same effects.",
        ),
    ] = None,
    heading_sigma: HeadingSigma = None,
    assume: Assumption = Assume.auto,
    latitude: Latitude = None,
    height: Height = 0.0,
    topic: Topics = None,
    units: Units = None,
    ignore: Ignore = None,
    reference_exact: ReferenceExact = False,
    noise_until: NoiseUntil = None,
    engine: EngineOption = Engine.compiled,
    json: Json = None,
    report: Report = None,
    rrd: Rrd = None,
) -> None:
    """Run the filter over recordings of one device: sensor errors, how well they are known.

    Effects are those of the device, so several recordings tell them together; biases and noise
    are each recording's own. With --from, the fit of that result is repeated; of other
    recordings, the same effects are estimated.
    """
    from handcal.output import beside, check_outputs

    check_outputs((json, report, rrd), (*files, learnt_from))
    recordings = [load(path, topic, units) for path in files]
    for several in (report, rrd):
        if several:
            check_outputs(beside(several, recordings), (*files, learnt_from))
    results = _calibrated(
        recordings, effects, learnt_from, heading_sigma=heading_sigma, assume=assume,
        latitude=latitude, height=height, ignore=ignore, reference_exact=reference_exact,
        noise_until=noise_until, engine=engine,
    )  # fmt: skip
    if report:
        from handcal.report import write_report

        for result, path in zip(results, beside(report, recordings), strict=True):
            write_report(result, path)
    if rrd:
        from handcal.dashboard import save_rrd

        for result, path in zip(results, beside(rrd, recordings), strict=True):
            save_rrd(result, path)
    if json:
        from handcal.summary import calibration_json, write_json

        write_json(calibration_json(results), json)
    if str(json) != "-":  # last: whoever reads this may have had enough before its end
        for result in results:
            _show(result)


def _show(result: Result) -> None:
    from rich.console import Console

    from handcal.summary import print_summary

    print_summary(result, Console())


@app.command("import")
def import_(
    source: Annotated[
        Path, typer.Argument(metavar="SOURCE", help="A phone log or any other format.")
    ],
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="FILE.mcap", help="Recording to write.")
    ],
    topic: Topics = None,
    units: Units = None,
) -> None:
    """Turn a phone log or another format into an MCAP recording."""
    from handcal.export import write_mcap
    from handcal.output import check_outputs

    check_outputs((out,), (source,))
    recording = load(source, topic, units)
    write_mcap(recording, out)
    for warning in recording.warnings:
        say(warning)
    streams = ", ".join(["imu", *recording.streams])
    print(f"{out}: {recording.duration_s:.1f} s at {recording.rate_hz:.0f} Hz, {streams}")


@app.command()
@with_own_effects
def conceal(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording, real ones too.")],
    effect: Annotated[
        list[str],
        typer.Option(
            metavar="ID=v,v,...",
            help="Effect to add, values in the order of its parameters (repeatable); a wrong one "
            "lists them.",
        ),
    ],
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="FILE.mcap", help="Recording to write.")
    ],
    learnt_from: Annotated[
        Path | None,
        typer.Option(
            "--from",
            metavar="EXPLANATION.json",
            help="What `explain --json` said of this recording as it is: what is added depends on "
            "the true motion, and the device's own errors are no part of that.",
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Same seed, same file (drawn, and said).")
    ] = None,
    topic: Topics = None,
    units: Units = None,
) -> None:
    """Add an effect to a recording, to see whether it is found."""
    import secrets

    import numpy as np

    from handcal import conceal as hidden
    from handcal.export import write_mcap
    from handcal.output import check_outputs

    values = dict(hidden.parse(text) for text in effect)
    check_outputs((out,), (file, learnt_from))
    seed = secrets.randbelow(2**31) if seed is None else seed
    recording = load(file, topic, units)
    truth = None
    if learnt_from is not None:
        from handcal import apply as known

        truth = known.apply(recording, known.read(learnt_from), biases=True).recording.imu
    write_mcap(hidden.conceal(recording, values, np.random.default_rng(seed), truth), out)
    print(f"{out}: {', '.join(values)} concealed in {Path(recording.path).name}, seed {seed}")


@app.command()
@with_own_effects
def replay(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording.")],
    speed: Annotated[
        float, typer.Option(min=0.0, help="Times as fast as it happened; 0: no waiting.")
    ] = 1.0,
    web: Annotated[
        bool, typer.Option("--web", help="Watch in a browser instead of a window.")
    ] = False,
    no_viewer: Annotated[bool, typer.Option("--no-viewer", help="Only write --rrd.")] = False,
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="Port of the viewer, on this machine only.")
    ] = None,
    rrd: Rrd = None,
    effects: Effects = "",
    heading_sigma: HeadingSigma = None,
    assume: Assumption = Assume.auto,
    latitude: Latitude = None,
    height: Height = 0.0,
    topic: Topics = None,
    units: Units = None,
    ignore: Ignore = None,
    noise_until: NoiseUntil = None,
    engine: EngineOption = Engine.compiled,
) -> None:
    """Run the filter over a recording as if live, and show it in the Rerun viewer as it goes.

    A calibration goes before it: that is where the noise levels come from.
    """
    from handcal.output import check_outputs
    from handcal.types import InputError
    from handcal.viewer import require_display

    if no_viewer and rrd is None:
        raise InputError("--no-viewer without --rrd FILE.rrd leaves nothing to do.")
    check_outputs((rrd,), (file,))
    recording = load(file, topic, units)
    if not (no_viewer or web):
        require_display()
    (result,) = _calibrated(
        [recording], effects, heading_sigma=heading_sigma, assume=assume,
        latitude=latitude, height=height, ignore=ignore, noise_until=noise_until, engine=engine,
    )  # fmt: skip
    # rerun reports a viewer that its owner has closed as errors; set before its import
    os.environ.setdefault("RUST_LOG", "warn,re_grpc_client=off,re_sdk=off")
    from handcal import dashboard
    from handcal.frames import layout_of
    from handcal.live import live_frames

    frames = live_frames(result, latitude=radians(latitude), height=height, engine=str(engine))
    layout = layout_of(result, live=True)
    dashboard.replay(
        frames, layout, speed=speed, rrd=rrd, show=not no_viewer, web=web, port=port, say=say
    )


def main() -> None:
    """The ``handcal`` command. Leaves by SystemExit."""
    # Before numpy is imported: threads on matrices of a hundred rows cost more than they bring.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    _memory.kept()
    run(app)


if __name__ == "__main__":
    main()
