"""What one calls from Python. ``import handcal`` has all of it; ``help(handcal)`` the conventions.

Every function takes recordings, or paths of files, or several of either; every result is what the
rest of the program works on, with a table that a notebook shows, ``plot`` and ``report``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from handcal.api.recording import Recording
from handcal.api.results import Calibration, Corrected, Explanation, Parameters
from handcal.explain import pipeline
from handcal.explain.explanation import Explanation as ExplanationData
from handcal.recordings import inputs
from handcal.types import InputError, Result
from handcal.types import Recording as RecordingData

if TYPE_CHECKING:
    from handcal.device import apply as device

__all__ = [
    "Calibration",
    "Corrected",
    "Explanation",
    "Parameters",
    "Recording",
    "apply",
    "calibrate",
    "conceal",
    "explain",
    "read",
]

Source = RecordingData | str | Path


def read(
    path: str | Path,
    *,
    topics: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
) -> Recording:
    """A recording from a file of any format that the command line reads.

    topics: which MCAP topic is which stream ({"imu": "/phone/imu"}). units: where they are not as
    the format states ({"accel": "g"}). Errors: InputError.
    """
    return Recording.of(inputs.load(path, topics=topics, units=units))


@overload
def calibrate(
    recording: Source, effects: Sequence[str] | str = (), **options: Any
) -> Calibration: ...
@overload
def calibrate(
    recording: Sequence[Source], effects: Sequence[str] | str = (), **options: Any
) -> tuple[Calibration, ...]: ...
def calibrate(
    recording: Source | Sequence[Source], effects: Sequence[str] | str = (), **options: Any
) -> Calibration | tuple[Calibration, ...]:
    """Sensor errors of a device from a recording, or from several together, and how well they are
    known.

    effects: ids of the catalogue beyond constant biases ("gyro_scale"). options: assume ("auto",
    "fixed-point", "rest-only"), heading_sigma (rad), latitude (rad), height (m), ignore (streams),
    observations, noise, noise_until (s), engine, reference_exact, progress. Of several recordings
    one result each: the effects are told by all of them together. Errors: InputError,
    HandcalError.
    """
    from handcal.estimate.calibration import calibrate_together

    recordings = _recordings(recording, "calibrate")
    wanted = [e.strip() for e in effects.split(",")] if isinstance(effects, str) else list(effects)
    done = calibrate_together(recordings, [e for e in wanted if e], **options)
    results = tuple(Calibration.of(r) for r in done)
    return results[0] if isinstance(recording, RecordingData | str | Path) else results


def explain(
    recording: Source | Sequence[Source],
    held_out: Source | Sequence[Source] = (),
    **options: Any,
) -> Explanation:
    """Which physics a recording of a device, or several together, hold beyond constant biases:
    where, which, how certain.

    held_out: other recordings of the device, for scoring alone. options: as of ``calibrate``,
    without engine, observations and noise; and budget: seconds after which nothing further is
    tried. Errors: InputError, HandcalError.
    """
    others = _recordings(held_out, "explain") if held_out else []
    return Explanation.of(pipeline.explain(_recordings(recording, "explain"), others, **options))


def conceal(recording: Source, effects: Mapping[str, Sequence[float]], seed: int = 0) -> Recording:
    """The recording as a device with further errors would have made it: {"gyro_scale": [0.01, 0,
    0]}, values in the order of the catalogue's parameters, SI. Errors: InputError, HandcalError."""
    from handcal.device import conceal as device

    (one,) = _recordings(recording, "conceal")
    rng = np.random.default_rng(seed)
    return Recording.of(device.conceal(one, effects, rng))


def apply(
    recording: Source, learnt: Result | ExplanationData | str | Path, *, biases: bool = False
) -> Corrected:
    """A recording of the device without the errors that were learnt, for any other program.

    learnt: a calibration or an explanation, or the path of its JSON. biases: take off also what
    differs from day to day. Errors: InputError, HandcalError.
    """
    from handcal.device import apply as device

    (one,) = _recordings(recording, "apply")
    done = device.apply(one, _learnt(learnt), biases=biases)
    return Corrected(Recording.of(done.recording), done.taken, done.left)


def _learnt(learnt: Result | ExplanationData | str | Path) -> device.Learnt:
    from handcal.device import apply as device

    if isinstance(learnt, str | Path):
        return device.read(Path(learnt))
    if isinstance(learnt, Result):
        return device.of_document("this calibration", Calibration.of(learnt).document)
    if isinstance(learnt, ExplanationData):
        return device.of_document("this explanation", Explanation.of(learnt).document)
    raise InputError(
        "apply takes what was learnt second: a calibration, an explanation, or the path of its "
        f"JSON, no {type(learnt).__name__}."
    )


def _recordings(given: Source | Sequence[Source], caller: str) -> list[RecordingData]:
    """One or several recordings or paths as recordings. Errors: InputError."""
    several = [given] if isinstance(given, RecordingData | str | Path) else given
    if isinstance(several, list | tuple):
        if all(isinstance(one, RecordingData | str | Path) for one in several):
            return [one if isinstance(one, RecordingData) else read(one) for one in several]
        given = next(x for x in several if not isinstance(x, RecordingData | str | Path))
    raise InputError(
        f"{caller} takes recordings or paths of files, no {type(given).__name__}; of arrays make "
        "one by handcal.Recording.from_arrays(t, gyro, accel)."
    )
