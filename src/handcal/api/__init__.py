"""What one calls from Python. ``import handcal`` has all of it; ``help(handcal)`` the conventions.

Every function takes recordings, or paths of files, or several of either; every result is what the
rest of the program works on, with a table that a notebook shows, ``plot`` and ``report``.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from numbers import Real
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Unpack, overload

import numpy as np

from handcal import output, user_effects
from handcal.allan import analysis
from handcal.api import options
from handcal.api.noise import Allan
from handcal.api.options import CalibrateOptions, ExplainOptions
from handcal.api.recording import Recording
from handcal.api.results import Calibration, Corrected, Explanation, Parameters
from handcal.api.saved import Saved, opened
from handcal.api.words import in_python, spoken
from handcal.documents import read_json
from handcal.estimate.calibration import calibrate_together, recalibrate
from handcal.explain import model_file, pipeline
from handcal.explanation import Explanation as ExplanationData
from handcal.recordings import inputs
from handcal.recordings.inputs._options import ALONE, HALVES
from handcal.types import InputError, Result
from handcal.types import Recording as RecordingData

__all__ = [
    "Allan",
    "Calibration",
    "Corrected",
    "Explanation",
    "Parameters",
    "Recording",
    "Saved",
    "allan",
    "apply",
    "calibrate",
    "conceal",
    "effects_from",
    "explain",
    "export",
    "open_result",
    "read",
]

Source = RecordingData | str | Path
Found = Result | ExplanationData | Saved | str | Path
_OF_ARRAYS = "of arrays make one by handcal.Recording.from_arrays(t, gyro, accel)."


@spoken()
def read(
    path: str | Path,
    *,
    topics: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    columns: Sequence[str] | str = (),
    rate_hz: float | None = None,
    axes: Mapping[str, str] | None = None,
    needs: tuple[str, ...] = HALVES,
) -> Recording:
    """A recording from a file of any format that the command line reads.

    topics: which topic is which stream ({"imu": "/phone/imu"}). units: where they are not as
    the format states ({"accel": "g"}, {"accel": "g/16384"}). columns: what those of a table are, in
    their order ("t,gx,gy,gz,ax,ay,az", "-" leaves one aside). rate_hz: of a table without times.
    axes: of gyro, accel or mag, which of its axes stand for the IMU's x, y, z ({"mag": "y,x,-z"}).
    needs: of gyro and accel those that there have to be; of one alone ``allan`` makes something.
    Errors: InputError.
    """
    if not isinstance(path, str | Path):
        raise InputError(f"read takes the path of a file, no {type(path).__name__}; {_OF_ARRAYS}")
    for name, given, example in (
        ("topics", topics, '{"imu": "/phone/imu"}'), ("units", units, '{"accel": "g"}'),
        ("axes", axes, '{"mag": "y,x,-z"}'),
    ):  # fmt: skip
        for key, value in options.mapping(name, {} if given is None else given, example).items():
            if not isinstance(value, str):
                raise InputError(f"{name}: {key} takes a name, as {example}, no {value!r:.40}.")
    if rate_hz is not None:
        options.number("rate_hz", rate_hz, " (Hz)")
    named = options.ids("columns", columns)
    read = inputs.load(
        path, topics=topics, units=units, columns=named, rate_hz=rate_hz, axes=axes, needs=needs
    )
    return Recording.of(replace(read, warnings=tuple(map(in_python, read.warnings))))


@overload
def calibrate(  # type: ignore[overload-overlap]
    recording: Source,
    effects: Sequence[str] | str = (),
    learnt: Found | None = None,
    **more: Unpack[CalibrateOptions],
) -> Calibration: ...
@overload
def calibrate(
    recording: Sequence[Source],
    effects: Sequence[str] | str = (),
    learnt: Found | None = None,
    **more: Unpack[CalibrateOptions],
) -> tuple[Calibration, ...]: ...
@spoken()
def calibrate(
    recording: Source | Sequence[Source],
    effects: Sequence[str] | str = (),
    learnt: Found | None = None,
    **more: Unpack[CalibrateOptions],
) -> Calibration | tuple[Calibration, ...]:
    """Sensor errors of a device from a recording, or from several together, and how well they are
    known.

    effects: ids of the catalogue beyond what every device has ("gravity"); only: these and biases
    alone. learnt: an explanation or a calibration, new or saved, whose fit is repeated; of other
    recordings, the same effects and laws are estimated. assume: "auto", "fixed-point" or
    "rest-only". heading_sigma (rad), if known; latitude (rad) and height (m) of
    the place; ignore: streams to leave out; reference_exact: a reference has no bias; before: what
    is known of the device. observations: kinds to use instead; noise: levels to keep fixed, SI, by
    name; noise_until (s): where the part ends of which the others are found; start; engine;
    progress: called with the share done. Of several recordings one result each: the effects are
    told by all of them together. Errors: InputError, HandcalError.
    """
    chosen = options.checked("calibrate", more, CalibrateOptions)
    wanted = options.ids("effects", effects)
    recordings = _recordings(recording, "calibrate")
    if learnt is None:
        done = calibrate_together(recordings, wanted, **chosen)
    else:
        own = [*(["effects"] if wanted else []), *(chosen.keys() - {"before", "progress"})]
        if own:
            raise InputError(
                f"learnt holds the model with its options; leave out {', '.join(own)}."
            )
        model = model_file.of_document(*_document("calibrate", learnt))
        done = recalibrate(recordings, model, chosen.get("progress"), chosen.get("before"))
    results = tuple(Calibration.of(r) for r in done)
    return results[0] if isinstance(recording, RecordingData | str | Path) else results


@spoken()
def explain(
    recording: Source | Sequence[Source],
    held_out: Source | Sequence[Source] = (),
    **more: Unpack[ExplainOptions],
) -> Explanation:
    """Which physics a recording of a device, or several together, hold beyond constant biases:
    where, which, how certain.

    held_out: other recordings of the device, for scoring alone. budget: seconds after which
    nothing further is tried; stop: asked again and again whether to end likewise, with the best
    model so far. Others as of ``calibrate``; progress is called with the share done,
    and what is being done. Errors: InputError, HandcalError.
    """
    chosen = options.checked("explain", more, ExplainOptions)
    others = _recordings(held_out, "explain")
    return Explanation.of(pipeline.explain(_recordings(recording, "explain"), others, **chosen))


@spoken()
def allan(recording: Source, span: tuple[float, float] | None = None) -> Allan:
    """Noise of a device at rest: Allan deviation of each channel, its terms (N, B, K, Q, R) with
    sigmas, and levels for the filter.

    span: start and end (s) of the stretch to analyse; without it, the longest rest. Errors:
    InputError for a span outside, HandcalError where nothing is long enough.
    """
    if span is not None:
        if not isinstance(span, Sequence) or isinstance(span, str) or len(span) != 2:
            raise InputError(f"span takes two numbers (s), (start, end), not {span!r:.40}.")
        for value in span:
            options.number("span", value, " (s)")
    return Allan.of(analysis.analyse(_one(recording, "allan", needs=()), span))


@spoken()
def conceal(
    recording: Source,
    effects: Mapping[str, Sequence[float] | float],
    seed: int = 0,
    learnt: Found | None = None,
    *,
    anyway: bool = False,
) -> Recording:
    """The recording as a device with further errors would have made it: {"gyro_scale": [0.01, 0,
    0]}, values in the order of the catalogue's parameters, SI; a number of an effect that has but
    one. learnt: what was learnt of this recording as it is, whose errors are no part of the motion
    on which depends what is added. anyway: also of a result that is not to be trusted. Errors:
    InputError, HandcalError."""
    from handcal import trust
    from handcal.device import apply as known
    from handcal.device import conceal as device

    values: dict[str, Any] = {}
    for name, given in options.mapping("conceal", effects, '{"gyro_scale": [0.01, 0, 0]}').items():
        values[name] = [given] if isinstance(given, Real) else given
        if isinstance(given, str) or not isinstance(values[name], Iterable):
            raise InputError(f"{name} takes numbers, no {type(given).__name__}.")
        for value in values[name]:
            options.number(name, value)
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"conceal: the seed is a whole number from 0 on, not {seed!r:.40}.")
    one = _one(recording, "conceal")
    truth = None
    if learnt is not None:
        name, document = _document("conceal", learnt)
        with model_file.laws_of(name, document):
            own = known.of_document(name, document)
            trust.check(own.path, own.trust, anyway)
            truth = known.apply(one, own, biases=True).recording.imu
    return Recording.of(device.conceal(one, values, np.random.default_rng(seed), truth))


@spoken()
def apply(
    recording: Source, learnt: Found, *, biases: bool = False, anyway: bool = False
) -> Corrected:
    """A recording of the device without the errors that were learnt, for any other program.

    learnt: a calibration or an explanation, new or saved, or the path of its JSON. biases: take off
    also what differs from day to day. anyway: use also what is not to be trusted (trust "none").
    Errors: InputError, HandcalError.
    """
    from handcal import trust
    from handcal.device import apply as device
    from handcal.device.another import check_corrected, unlike

    name, document = _document("apply", learnt)
    with model_file.laws_of(name, document):
        known, given = device.of_document(name, document), _one(recording, "apply")
        trust.check(known.path, known.trust, anyway)
        check_corrected(given, known, anyway)
        done = device.apply(given, known, biases=biases)
    warnings = *trust.said(known.path, known.trust), *unlike(given, known)
    said = tuple(in_python(w) for w in warnings)
    return Corrected(Recording.of(done.recording), done.taken, done.left, said)


@spoken()
def open_result(path: str | Path) -> Saved:
    """A calibration or an explanation that ``save`` or the command line wrote as JSON: its numbers,
    verdict and doubts, for ``apply`` and ``export`` too. Errors: InputError."""
    if not isinstance(path, str | Path):
        raise InputError(f"open_result takes the path of a JSON, no {type(path).__name__}.")
    return opened(Path(path))


@spoken()
def export(
    learnt: Found | Allan,
    to: str,
    path: str | Path | None = None,
    *,
    recording: Source | None = None,
    noise: Allan | str | Path | None = None,
    topic: str | None = None,
    axes: str | None = None,
    parameters: str | Path | None = None,
    readings: str = "",
    instance: int | Mapping[str, int] | None = None,
    anyway: bool = False,
) -> str:
    """What was learnt in the format of another program ("kalibr", "px4", ...): its text, which is
    written to ``path`` too if that is given. Of ``allan`` the noise alone.

    recording: where what the format cannot hold is measured. noise: of the device at rest, by
    ``allan``. topic: of the Imu messages, where not that of the recording. axes: "flu" or "frd",
    what the recording's axes are on a vehicle; parameters: a file of the vehicle's own;
    readings: "raw" or "corrected" by the vehicle, where the recording does not say it; instance:
    which of its sensors was read (1, or {"gyro": 1, "accel": 2}). anyway: also of a result that is
    not to be trusted. Errors: InputError, HandcalError.
    """
    from handcal.exports import format_of
    from handcal.exports._contents import contents

    form = format_of(to)
    which = dict.fromkeys(HALVES, instance) if isinstance(instance, int) else instance
    given = None if recording is None else _one(recording, "export")
    with TemporaryDirectory() as folder:
        source, allan_file = _file(learnt, Path(folder)), None
        if isinstance(noise, Allan):
            allan_file = Path(folder) / "allan.json"
            noise.save(allan_file)
        elif noise is not None:
            allan_file = Path(noise)
        if path is not None:
            output.check_outputs((Path(path),), (source, allan_file))
        own = None if parameters is None else Path(parameters)
        with model_file.laws_of(str(source), read_json(source)):
            made = contents(
                source, form, given, allan_file, topic, axes, own,
                readings=readings, instance=which, anyway=anyway,
            )  # fmt: skip
            text = form.write(made)
    if path is not None:
        output.write_text(path, text)
    return text


def _file(learnt: Found | Allan, folder: Path) -> Path:
    """The JSON of what was learnt, of a new result in the folder. Errors: InputError."""
    if isinstance(learnt, str | Path):
        return Path(learnt)
    if isinstance(learnt, Saved):
        return learnt.path
    if isinstance(learnt, Result):
        written = folder / "calibration.json"
        Calibration.of(learnt).save(written)
        return written
    if isinstance(learnt, Allan):
        written = folder / "noise.json"
        learnt.save(written)
        return written
    if isinstance(learnt, ExplanationData):
        written = folder / "explanation.json"
        Explanation.of(learnt).save(written)
        return written
    raise InputError(
        "export takes what was learnt first: a calibration, an explanation, or the path of its "
        f"JSON, no {type(learnt).__name__}."
    )


@contextmanager
def effects_from(folder: str | Path) -> Iterator[None]:
    """``with handcal.effects_from("my-effects"):`` inside, the catalogue has the effects of a
    folder's files too, which are run: name none that you do not trust. Errors: InputError."""
    if not isinstance(folder, str | Path):
        raise InputError(f"effects_from takes a folder, no {type(folder).__name__}.")
    with spoken(), user_effects.effects_from(Path(folder)):
        yield


def _document(caller: str, learnt: Found) -> tuple[str, Any]:
    """What was learnt as its JSON has it; before it, its name. Errors: InputError."""
    if isinstance(learnt, Saved):
        return str(learnt.path), learnt.document
    if isinstance(learnt, str | Path):
        return str(learnt), read_json(Path(learnt))
    if isinstance(learnt, Result):
        return "this calibration", Calibration.of(learnt).document
    if isinstance(learnt, ExplanationData):
        return "this explanation", Explanation.of(learnt).document
    where = "second" if caller == "apply" else "as learnt"
    raise InputError(
        f"{caller} takes what was learnt {where}: a calibration, an explanation, or the path of "
        f"its JSON, no {type(learnt).__name__}."
    )


def _one(given: Source, caller: str, needs: tuple[str, ...] = HALVES) -> RecordingData:
    """The one recording that a function takes. Errors: InputError."""
    found = _recordings(given, caller, needs)
    if len(found) != 1:
        raise InputError(f"{caller} takes one recording, not {len(found)}.")
    return found[0]


def _recordings(
    given: Source | Sequence[Source], caller: str, needs: tuple[str, ...] = HALVES
) -> list[RecordingData]:
    """One or several recordings or paths as recordings. Errors: InputError."""
    several = [given] if isinstance(given, RecordingData | str | Path) else given
    if isinstance(several, list | tuple):
        if all(isinstance(one, RecordingData | str | Path) for one in several):
            found = [
                one if isinstance(one, RecordingData) else read(one, needs=needs) for one in several
            ]
            for one in found:
                if not set(needs) <= set(one.sensors):
                    raise InputError(f"{one.path} holds the {one.sensors[0]} alone. {ALONE}")
            return found
        given = next(x for x in several if not isinstance(x, RecordingData | str | Path))
    raise InputError(
        f"{caller} takes recordings or paths of files, no {type(given).__name__}; {_OF_ARRAYS}"
    )


options.show(calibrate, CalibrateOptions, calibrate_together)
options.show(explain, ExplainOptions, pipeline.explain)


def _speaks_for(package: str, function: Callable[..., Any]) -> None:
    """Let a package that may be called as a function be described as that."""
    signature, module = inspect.signature(function), sys.modules[package]
    first, _, rest = inspect.cleandoc(function.__doc__ or "").partition("\n\n")
    module.__doc__ = f"{' '.join(first.split())}\n\n{function.__name__}{signature}\n\n{rest}"
    module.__signature__ = signature  # type: ignore[attr-defined]


_speaks_for("handcal.explain", explain)
_speaks_for("handcal.allan", allan)
