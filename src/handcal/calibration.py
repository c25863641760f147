"""``calibrate``: from recordings to what is known of a device's sensors.

1. segment the recording, choose observations and the assumption about the hand (``estimate.case``),
2. filter once as a live filter would, smooth, relinearise, and find the noise levels by evidence:
   the baseline (``estimate.fit``),
3. the same with the effects asked for, from there (``estimate.chosen``),
4. filter once more about the settled trajectory: that pass is what is shown (``estimate.result``).

``explain`` ends in the same fit of the model that it chose.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from handcal.effects import Effect, select
from handcal.estimate.case import Case, case_of
from handcal.estimate.chosen import Chosen, Options, seen, settled, view_of
from handcal.estimate.fit import Model, baseline
from handcal.estimate.hand import resting, travels
from handcal.estimate.observed import check_options
from handcal.estimate.result import results
from handcal.filter import ENGINES
from handcal.observations import catalogue
from handcal.start import Start
from handcal.types import InputError, Recording, Result

Progress = Callable[[float], None]


def calibrate(
    recording: Recording,
    effects: Sequence[str] = (),
    observations: Sequence[str] | None = None,
    *,
    assume: str = "auto",
    heading_sigma: float | None = None,
    latitude: float | None = None,
    height: float = 0.0,
    noise: Mapping[str, float] | None = None,
    noise_until: float | None = None,
    start: Start | None = None,
    engine: str = "compiled",
    ignore: Sequence[str] = (),
    progress: Progress | None = None,
) -> Result:
    """Estimate biases, and the parameters of the effects asked for, from one recording.

    effects: ids of the catalogue. observations: kinds to use instead of those that
    ``assume`` ("auto", "fixed-point", "rest-only") and the streams suggest. heading_sigma:
    rad, if known. latitude (rad) and height (m) switch on the Earth's rate and true
    gravity. noise: levels to keep fixed, SI, by name; all others are estimated, from the
    part before ``noise_until`` (s) if given. start: a prior of the first state instead of
    levelling. ignore: streams to leave out. progress: called with the fraction done.

    Raises InputError for unknown names or options, HandcalError where no result could be
    made. Source: paper 002 for the pseudo-observations, equations 7-12.
    """
    (result,) = calibrate_together(
        [recording], effects, observations, assume=assume, heading_sigma=heading_sigma,
        latitude=latitude, height=height, noise=noise, noise_until=noise_until, start=start,
        engine=engine, ignore=ignore, progress=progress,
    )  # fmt: skip
    return result


def calibrate_together(
    recordings: Sequence[Recording],
    effects: Sequence[str] = (),
    observations: Sequence[str] | None = None,
    *,
    assume: str = "auto",
    heading_sigma: float | None = None,
    latitude: float | None = None,
    height: float = 0.0,
    noise: Mapping[str, float] | None = None,
    noise_until: float | None = None,
    start: Start | None = None,
    engine: str = "compiled",
    ignore: Sequence[str] = (),
    progress: Progress | None = None,
) -> tuple[Result, ...]:
    """``calibrate`` for recordings of one device: its effects are theirs together, biases and
    noise levels each recording's own. Options and errors as there."""
    report = progress or (lambda _: None)
    _check(engine, observations)
    wanted = select(effects)
    _check_calibrates(wanted)
    fixed = dict(noise or {})
    if heading_sigma is not None:
        fixed["heading_noise"] = heading_sigma
    cases = []
    for recording in recordings:
        check_options(recording, assume, heading_sigma, ignore)
        case = case_of(
            recording, assume, latitude, height, ignore, fixed, kinds=observations, effects=wanted,
            start=start,
        )  # fmt: skip
        _check_effects(wanted, case.kinds)
        cases.append(replace(case, noise_until=noise_until))
    options = Options(latitude, height, fixed, tuple(ignore))
    model = _fitted(cases, wanted, options, engine, report)
    if assume == "auto" and observations is None and any(travels(f) for f in model.parts):
        cases = [
            replace(resting(f, latitude, height, wanted), noise_until=noise_until)
            if travels(f)
            else f.case
            for f in model.parts
        ]
        model = _fitted(cases, wanted, options, engine, report)
    report(0.95)
    out = results(model, {})
    report(1.0)
    return out


def _fitted(
    cases: Sequence[Case],
    effects: Sequence[Effect],
    options: Options,
    engine: str,
    report: Progress,
) -> Model:
    base = baseline(cases, engine)
    report(0.5)
    return settled(base, Chosen(tuple(effects), tuple(view_of(c) for c in cases), options))


def recalibrate(
    recordings: Sequence[Recording], chosen: Chosen, progress: Progress | None = None
) -> tuple[Result, ...]:
    """The fit of a model that was written down (``explain`` and ``calibrate`` say theirs) to
    recordings, one for each of its views: equal to the fit that it was written down of."""
    report = progress or (lambda _: None)
    if len(recordings) != len(chosen.views):
        raise InputError(
            f"The model is of {len(chosen.views)} recordings, and {len(recordings)} were given."
        )
    cases = [seen(r, v, chosen.options) for r, v in zip(recordings, chosen.views, strict=True)]
    base = baseline(cases)
    report(0.5)
    out = results(settled(base, chosen), chosen.moments)
    report(1.0)
    return out


def _check(engine: str, observations: Sequence[str] | None) -> None:
    if engine not in ENGINES:
        raise InputError(f"Unknown engine '{engine}'. Known: {', '.join(ENGINES)}.")
    for kind in observations or ():
        if kind not in catalogue():
            raise InputError(f"Unknown observation '{kind}'. Known: {', '.join(catalogue())}.")


def _check_calibrates(effects: Sequence[Effect]) -> None:
    for e in effects:
        if e.outliers:
            raise InputError(
                f"The effect '{e.id}' cannot be calibrated: the filter believes every reading. "
                "'explain' can find it; leave it out here."
            )


def _check_effects(effects: Sequence[Effect], kinds: Sequence[str]) -> None:
    for e in effects:
        acts = e.imu_error is not None or e.walks or set(e.observation_error) & set(kinds)
        if not acts:
            raise InputError(
                f"The effect '{e.id}' acts on {' or '.join(sorted(e.observation_error))}, and "
                "nothing like that is observed here: leave it out."
            )
