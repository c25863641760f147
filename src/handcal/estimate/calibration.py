"""``calibrate``: from recordings to what is known of a device's sensors.

1. segment the recording, choose observations and the assumption about the hand (``estimate.case``),
2. filter once as a live filter would, smooth, relinearise, and find the noise levels by evidence:
   the baseline (``estimate.fit``),
3. the same with all common effects, then with those asked for (``estimate.specification``),
4. filter once more about the settled trajectory: that pass is what is shown (``estimate.result``).

``explain`` ends in the same fit of the model that it chose.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from handcal.effects import PLACE, Effect, select
from handcal.effects import catalogue as known
from handcal.estimate.baseline import baseline, common, dense
from handcal.estimate.case import Case, case_of
from handcal.estimate.filter import ENGINES
from handcal.estimate.model import Model
from handcal.estimate.noise_look import EVIDENT, drifting
from handcal.estimate.observed import check_apart, check_options
from handcal.estimate.pieces import by_pieces
from handcal.estimate.rest_only import resting, travels
from handcal.estimate.result import results
from handcal.estimate.specification import (
    Options,
    Specification,
    document_of,
    seen,
    settled,
    view_of,
)
from handcal.estimate.start import Start
from handcal.observations import catalogue
from handcal.recordings.bridged import bridged
from handcal.types import InputError, Prior, Recording, Result

Progress = Callable[[float], None]

# Noise levels are found in no less, s.
LEAST_NOISE_S = 2.0
DRIFTING = (
    "The biases drift within the recording: the fit follows them as random walks, and gives "
    "their means."
)
ONLY = "These sigmas hold only if the device has no errors but its biases"


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
    reference_exact: bool = False,
    before: Prior | None = None,
    only: bool = False,
    progress: Progress | None = None,
) -> Result:
    """Estimate biases, the errors that every device has (``Effect.common``) and those asked for,
    from one recording.

    effects: ids of the catalogue, beside the common ones; only: without those, so that the sigmas
    hold only if nothing else is there. observations: kinds to use instead of those that
    ``assume`` ("auto", "fixed-point", "rest-only") and the streams suggest. heading_sigma:
    rad, if known. latitude (rad) and height (m) switch on the Earth's rate and true
    gravity. noise: levels to keep fixed, SI, by name; all others are estimated, from the
    part before ``noise_until`` (s) if given. start: a prior of the first state instead of
    levelling. ignore: streams to leave out. reference_exact: a reference has no bias of its own.
    before: what is known of the device (a device file's).
    progress: called with the fraction done.

    Raises InputError for unknown names or options, HandcalError where no result could be
    made. Source: paper 002 for the pseudo-observations, equations 7-12.
    """
    (result,) = calibrate_together(
        [recording], effects, observations, assume=assume, heading_sigma=heading_sigma,
        latitude=latitude, height=height, noise=noise, noise_until=noise_until, start=start,
        engine=engine, ignore=ignore, reference_exact=reference_exact, before=before,
        only=only, progress=progress,
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
    reference_exact: bool = False,
    before: Prior | None = None,
    only: bool = False,
    progress: Progress | None = None,
) -> tuple[Result, ...]:
    """``calibrate`` for recordings of one device: its effects are theirs together, biases and
    noise levels each recording's own. Options and errors as there."""
    report = progress or (lambda _: None)
    _check(engine, observations)
    wanted = tuple(e for e in select(effects) if not e.baseline)
    _check_calibrates(wanted)
    fixed = dict(noise or {})
    if heading_sigma is not None:
        fixed["heading_noise"] = heading_sigma
    check_apart(recordings)
    if noise_until is not None and not noise_until >= LEAST_NOISE_S:
        raise InputError(
            f"Noise levels need at least {LEAST_NOISE_S:g} s: {noise_until:g} s are too few."
        )
    cases = []
    for recording in recordings:
        check_options(recording, assume, heading_sigma, ignore)
        case = case_of(
            recording, assume, latitude, height, ignore, fixed, kinds=observations,
            start=start, reference_exact=reference_exact, before=before,
        )  # fmt: skip
        _check_effects(wanted, case.kinds, recording)
        cases.append(replace(case, noise_until=noise_until))
    options = Options(latitude, height, fixed, tuple(ignore), reference_exact, before)
    auto = assume == "auto" and observations is None
    with by_pieces():
        return _calibrated(cases, wanted, options, engine, auto, only, report)


def _calibrated(
    cases: list[Case],
    wanted: Sequence[Effect],
    options: Options,
    engine: str,
    auto: bool,
    only: bool,
    report: Progress,
) -> tuple[Result, ...]:
    """The results; auto: where a hand travels, by the rests alone."""
    model, chosen = _fitted(cases, wanted, options, engine, only, report)
    far = [auto and travels(f) for f in model.parts]
    if any(far):
        cases = [
            resting(f, options.latitude, options.height) if gone else case
            for case, f, gone in zip(cases, model.parts, far, strict=True)
        ]
        model, chosen = _fitted(cases, wanted, options, engine, only, report)
    told = _told(model, chosen, report)
    if {e.id for e in chosen.effects if e.walks} - {e.id for e in wanted}:
        told = tuple(replace(r, warnings=(*r.warnings, DRIFTING)) for r in told)
    return _said_alone(told, wanted) if only else told


def _said_alone(told: Sequence[Result], effects: Sequence[Effect]) -> tuple[Result, ...]:
    """The results with a warning that nothing was estimated but biases and these effects."""
    names = ", ".join(e.id for e in effects)
    alone = f"{ONLY} and {names}." if names else f"{ONLY}."
    return tuple(replace(r, warnings=(*r.warnings, alone), doubts=(*r.doubts, alone)) for r in told)


def recalibrate(
    recordings: Sequence[Recording],
    chosen: Specification,
    progress: Progress | None = None,
    before: Prior | None = None,
) -> tuple[Result, ...]:
    """A model that was written down (``explain`` and ``calibrate`` say theirs), fitted again.

    To the recordings that it is of (known by the number of their samples): equal to the fit that
    it was written down of. To others of the device: its effects and its laws without a name, but
    for what happened at one moment or goes with time; observations and hand chosen anew.

    before: what is known of the device. Errors as of ``calibrate``.
    """
    report = progress or (lambda _: None)
    options = replace(chosen.options, before=before)
    chosen = replace(chosen, options=options)
    theirs = [v.samples for v in chosen.views]
    if [len(bridged(r).imu.t) for r in recordings] == theirs:
        cases = [seen(r, v, options) for r, v in zip(recordings, chosen.views, strict=True)]
    else:
        effects = tuple(e for e in chosen.effects if e.id in known() or _law_of_device(e))
        cases = [
            case_of(
                r, "auto", options.latitude, options.height,
                [s for s in options.ignore if s in r.streams], options.fixed,
                reference_exact=options.reference_exact, before=before,
            )
            for r in recordings
        ]  # fmt: skip
        views = tuple(view_of(c) for c in cases)
        chosen = replace(chosen, effects=effects, views=views, moments={}, levels=(), begin="")
        for case in cases:
            _check_effects(effects, case.kinds, case.recording)
    base = _as_written(baseline(cases), cases, chosen)
    chosen = replace(chosen, effects=_with_those_of_all(chosen.effects, base))
    report(0.5)
    told = _told(settled(base, chosen), chosen, report)
    if not {e.id for e in common(cases)} <= {e.id for e in chosen.effects}:
        told = _said_alone(told, [e for e in chosen.effects if not e.always])
    return tuple(replace(r, repeated=True) for r in told)


def _as_written(base: Model, cases: Sequence[Case], chosen: Specification) -> Model:
    """The baseline, or its fit with all common effects, or with as many of them as it could be
    fitted with, where the model that was written down is one that begins there."""
    ids = {e.id for e in chosen.effects}
    if not {e.id for e in common(cases) if e.imu_error is None} <= ids:
        return base
    whole = dense(base)
    return whole if set(whole.ids) <= ids else base


def _fitted(
    cases: Sequence[Case],
    effects: Sequence[Effect],
    options: Options,
    engine: str,
    only: bool,
    report: Progress,
) -> tuple[Model, Specification]:
    base = baseline(cases, engine)
    base = base if only else dense(base)
    report(0.5)
    effects = _with_those_of_all(effects, base)
    chosen = Specification(effects, tuple(view_of(c) for c in cases), options)
    model = settled(base, chosen, engine)
    if not only and (walks := drifting(model)):
        wider = replace(chosen, effects=(*effects, *walks))
        other = settled(base, wider, engine)
        if other.log_evidence > model.log_evidence + EVIDENT:
            return other, wider
    return model, chosen


def _with_those_of_all(effects: Sequence[Effect], base: Model) -> tuple[Effect, ...]:
    """The effects that were asked for, and before them those that every model has."""
    have = {e.id for e in effects}
    return (*(e for e in base.effects if e.id not in have), *effects)


def _told(model: Model, chosen: Specification, report: Progress) -> tuple[Result, ...]:
    report(0.95)
    document = document_of(chosen)
    out = tuple(replace(r, model=document) for r in results(model, chosen.moments))
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
                f"The effect '{e.id}' cannot be calibrated, because the filter uses every "
                "reading. Leave it out here; 'explain' can find it."
            )


def _law_of_device(effect: Effect) -> bool:
    """Whether this is a law without a name that another recording of the device may have too."""
    return "+=" in effect.id and not effect.of_one_day


def _check_effects(effects: Sequence[Effect], kinds: Sequence[str], recording: Recording) -> None:
    for e in effects:
        acts = e.imu_error is not None or e.walks or e.acts_on & set(kinds)
        if not acts:
            beside = "mag" in recording.streams and "heading" in kinds
            why = "no such observation is made here: leave it out"
            if beside and "magnetometer" in e.acts_on:
                why = (
                    "the magnetometer is not used beside a heading: leave it out, or the "
                    "heading (--ignore heading)"
                )
            raise InputError(
                f"The effect '{e.id}' acts on {' or '.join(sorted(e.acts_on))}, and {why}."
            )
        if PLACE in e.needs and not any(catalogue()[k].places for k in kinds):
            raise InputError(
                f"The effect '{e.id}' depends on the position of the device, and here there is "
                "neither a held point nor a pose: leave it out."
            )
