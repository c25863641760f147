"""``explain``: from recordings of one device to a verdict and its evidence."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from handcal.estimate.baseline import baseline, dense, plain, started
from handcal.estimate.case import Case, case_of, no_fit
from handcal.estimate.fit import TOLERANCE, fitted
from handcal.estimate.forked import in_parallel
from handcal.estimate.model import Model
from handcal.estimate.observed import check_apart, check_options
from handcal.estimate.rest_only import resting, travels
from handcal.estimate.scan import scan
from handcal.estimate.specification import (
    BASELINE,
    ONLINE,
    Options,
    Specification,
    as_seen,
    chosen_of,
    seen,
    settled,
)
from handcal.explain import held_out as held
from handcal.explain import importance
from handcal.explain.assembled import End, explanation_of, uncounted
from handcal.explain.moments import moments
from handcal.explanation import (
    Explanation,
    HeldOut,
)
from handcal.laws.with_motion import is_with_motion
from handcal.model_score import PRIOR, TERM_PRIOR
from handcal.search import outliers
from handcal.search.budget import SO_FAR, Budget, Report, after, part_of
from handcal.search.candidates import scanned_about
from handcal.search.climb import Made
from handcal.search.common_found import names_of
from handcal.search.drifting_point import begun, moving
from handcal.search.hand_assumption import foretold
from handcal.search.multistart import Found, advantage, astray, search
from handcal.search.plausible import sensible, too_large
from handcal.search.space import best_set, gains, space
from handcal.types import BoolArray, HandcalError, InputError, Prior, Recording

# Called with the share that is done, and the present stage.
Progress = Callable[[float, str], None]
# Nats that the final fit may lose against the end of the search: to count as equal, and at the most
# to count as a fit of the same model.
SAME, LOST = 1.0, 100.0

SEARCHING = "searching what is missing"
_MOVES = "a hand that moves"


def explain(
    recordings: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    *,
    assume: str = "auto",
    heading_sigma: float | None = None,
    latitude: float | None = None,
    height: float = 0.0,
    ignore: Sequence[str] = (),
    reference_exact: bool = False,
    budget: float | None = None,
    stop: Callable[[], bool] | None = None,
    before: Prior | None = None,
    progress: Progress | None = None,
) -> Explanation:
    """Find the physics that the baseline lacks to explain these recordings of one device.

    held_out: other recordings of the same device, for scoring only; without any, later blocks are
    predicted from earlier ones. budget: time after which nothing further is tried, s (None: no
    limit). stop: polled; if true, the search ends with the best model so far. before: prior of the
    device: of its biases in the search, of its effects in the final fit. Other options as in
    ``calibrate``. Raises InputError for wrong use, HandcalError if no fit converges.
    """
    began, report = time.monotonic(), progress or (lambda _, __: None)
    _check(recordings, held_out, assume, heading_sigma, ignore)
    fixed = {} if heading_sigma is None else {"heading_noise": heading_sigma}
    options = Options(latitude, height, fixed, tuple(ignore), reference_exact, before)
    cases = [_case(r, assume, options) for r in recordings]
    report(0.03, "fitting the baseline")
    base = dense(begun(cases))
    time_left, made = after(began, budget, stop), Made()
    # (about a diverged baseline, sums overflow)
    overflow: Literal["ignore"] | None = None if math.isfinite(base.log_evidence) else "ignore"
    with np.errstate(over=overflow, invalid=overflow):
        end = _searched(base, time_left, made, _so_far(report, SEARCHING, base, 0.1, 0.6))
    if assume == "auto":
        end = _by_the_rests(cases, end, options, time_left, made, report)
    if not math.isfinite(end.found.model.log_evidence):
        raise no_fit(recordings)
    report(0.75, "fitting the model that was found")
    end, chosen = _counted(*_finished(end, options, time_left, made, report), options)
    end = replace(end, base=plain(end.base))
    told = _told(end.found)
    report(0.8, "predicting what was not seen")
    others = [_case(r, "rest-only" if end.rests else assume, options) for r in held_out]
    scores, judged = _predicted(end, told, others)
    report(0.9, "judging what this motion could tell")
    out = explanation_of(end, told, scores, chosen, judged, tuple(time_left.untried))
    report(1.0, "")
    return out


def _check(
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    assume: str,
    heading_sigma: float | None,
    ignore: Sequence[str],
) -> None:
    if not recordings:
        raise InputError("There is no recording to explain.")
    for recording in recordings:
        check_options(recording, assume, heading_sigma, ignore)
    check_apart(recordings, held_out)


def _finished(
    end: End, options: Options, budget: Budget, made: Made, report: Progress
) -> tuple[End, Specification | None]:
    """The end of the search with the final fit of its model, and the specification of that fit. If
    the fit comes to implausible sizes, the search is repeated without those effects."""
    found, chosen = _refitted(end, end.found, options)
    large = too_large(found.model)
    if large and not budget.spent("a search without what came out too large"):
        # (the search's own fits had plausible sizes)
        told = _so_far(report, "searching again", end.base, 0.75, 0.05)
        base = dense(plain(end.base), large) if large & set(end.base.ids) else end.base
        other = search(base, told, large, budget, made=made)
        again, written = _refitted(replace(end, base=base), other, options)
        if sensible(again.model):
            # (this search used all readings, so that there are no outliers)
            found, chosen = replace(again, alone=end.found.alone), written
            end = replace(end, base=base, wrong=None)
    return replace(end, found=found), chosen


def _counted(
    end: End, chosen: Specification | None, options: Options
) -> tuple[End, Specification | None]:
    """The end without negligible laws, fitted again: the model holds only what is reported."""
    left = uncounted(end)
    if not left:
        return end, chosen
    found, model = end.found, end.found.model
    kept = [e for e in model.effects if e.id not in left]
    others = {i: e for i, e in found.space.effects.items() if i not in left}
    found = replace(found, space=replace(found.space, effects=others))
    found = _with(found, fitted(model.parts, kept, noise_rounds=2, tolerance=TOLERANCE))
    found, chosen = _refitted(end, found, options)
    return replace(end, found=found, left=tuple(left.values())), chosen


def _told(found: Found) -> Model:
    """The model without common effects that the recordings do not show. Evidence, residuals and
    unseen data are reported for it. The full model, if the reduced one fits much worse."""
    model = found.model
    names = names_of(found.space, model)
    wanted = [e for e in model.effects if e.always or e.id in names]
    if len(wanted) == len(model.effects):
        return model
    told = fitted(model.parts, wanted, noise_rounds=2, tolerance=TOLERANCE)
    return told if told.log_evidence > model.log_evidence + PRIOR else model


def _predicted(
    end: End, told: Model, others: Sequence[Case]
) -> tuple[HeldOut, importance.Judged | None]:
    """How well unseen data are predicted: other recordings, or else later blocks."""
    if not others:
        return held.later_blocks(end.base.bare, told), importance.by_later_blocks(end.found)
    scores, after = held.other_files(others, told)
    return scores, importance.by_other_files(end.found, after)


def _case(recording: Recording, assume: str, options: Options) -> Case:
    o = options
    return case_of(
        recording, assume, o.latitude, o.height, o.ignore, o.fixed,
        reference_exact=o.reference_exact, before=o.before,
    )  # fmt: skip


def _by_the_rests(
    cases: Sequence[Case],
    end: End,
    options: Options,
    budget: Budget,
    made: Made,
    report: Progress,
) -> End:
    """The end of a search from the rests alone, if the hand seems to travel and the rests
    contradict a held point; else the same end.

    (Only after the search, since sensor errors look like a travelling hand.)
    """
    far = [travels(f) for f in _as_held(end).parts]
    if not any(far) or budget.spent("a hand that travels between rests"):
        return end
    laid = dense(
        baseline(
            [
                resting(f, options.latitude, options.height, explained=True) if gone else case
                for case, f, gone in zip(cases, end.found.model.parts, far, strict=True)
            ]
        )
    )
    if not math.isfinite(laid.log_evidence):
        return end
    told = _so_far(report, "searching by the rests alone", laid, 0.4, 0.3)
    other = _searched(laid, budget, made, told)
    surely = foretold(end.found, laid, other.found)
    if surely > 0.0:
        return replace(end, surely=surely)
    return replace(other, surely=-surely, rests=True)


def _as_held(end: End) -> Model:
    """The model without motion-dependent noise of the accelerometer, which would absorb the travel
    of a hand; the baseline, if a fit without that noise does not come as far."""
    model = end.found.model
    kept = [e for e in model.effects if not (is_with_motion(e.id) and e.walks == "accel")]
    if len(kept) == len(model.effects):
        return model
    return max(fitted(model.parts, kept), end.base, key=lambda m: m.log_evidence)


def _refitted(end: End, found: Found, options: Options) -> tuple[Found, Specification | None]:
    """The model of a search, fitted again from a reproducible start as ``calibrate`` does, and its
    specification. None, with the search's own fit, if every such start ends far below it."""
    searched, base = found.model.bare, end.base
    found = replace(found, model=searched)
    chosen = chosen_of(searched, options, moments(found))
    if end.moves or not as_seen(base.parts, chosen):
        parts = zip(searched.parts, chosen.views, strict=True)
        base = dense(
            baseline([seen(f.case.read or f.case.recording, v, options) for f, v in parts])
        )
    exact = chosen_of(searched, options, moments(found), exact=True)
    ways = replace(chosen, begin=BASELINE), replace(chosen, begin=ONLINE), exact
    ends = []
    # (the first start that is as good ends the loop, since later ones are seldom better)
    calls = (partial(_settled, base, written) for written in ways)
    for model, written in zip(in_parallel(calls), ways, strict=False):
        ends.append((model, written))
        if _as_good(model, searched):
            break
    model, chosen = max(ends, key=lambda end: (sensible(end[0]), end[0].log_evidence))
    if model.log_evidence < searched.log_evidence - LOST:
        return found, None
    return _with(found, model), chosen


def _settled(base: Model, written: Specification) -> Model:
    """The fit of a specification, without linearisations, to be sent between processes."""
    return settled(base, written).bare


def _as_good(model: Model, searched: Model) -> bool:
    """Whether a repeated fit is as good as the search's."""
    same = model.log_evidence > searched.log_evidence - SAME
    return same and sensible(model) and model.one_sided


def _with(found: Found, model: Model) -> Found:
    """The end of the search with another fit of its model."""
    candidates = list(found.space.effects.values())
    where = space(scan(model, candidates), candidates, found.space.prior)
    return replace(found, model=model, space=where)


def _so_far(report: Progress, stage: str, base: Model, start: float, share: float) -> Report:
    """A report of the progress of a search, and of the effects found so far."""
    have = set(base.ids)

    def told(f: float, model: Model) -> None:
        found = [e.id for e in model.effects if e.id not in have]
        report(f, f"{stage}{SO_FAR}{', '.join(found)}" if found else stage)

    return partial(part_of, told, start, share)


def _searched(base: Model, budget: Budget, made: Made, report: Report) -> End:
    """The end of the search from this baseline, with outliers and moving hands on trial."""
    # (about a diverged fit any reading looks like an outlier)
    told = not astray(base)
    cleaned, wrong = outliers.cleaned(base) if told else (base, None)
    base, cleaned = base.bare, cleaned.bare
    hand = _Hand(base, told and wrong is None, budget)
    found = search(cleaned, report, budget=budget, superseded=hand.moves, made=made)
    again = wrong is not None and wrong.burst is not None
    if wrong is not None and wrong.burst is None:
        whole = outliers.put_back(base, found.model)
        if found.model.log_evidence - whole.log_evidence + PRIOR < 0.0:
            found, wrong = _with(found, whole), None
        elif any(e.held for e in found.model.effects):
            again = _promises(whole, found.model)
    if wrong is not None and again:
        # (a burst may be a known heading error, and outliers may be the readings after a step)
        other = search(base, report, budget=budget, made=made)
        if advantage(other, found) > (TERM_PRIOR if wrong.burst else PRIOR):
            found, wrong = other, None
    if wrong is None:
        found, wrong = _without_outliers(
            base, base if told else found.model, found, budget, made, report
        )
    still = wrong is not None or budget.spent(_MOVES)
    other_hand = None if still else hand.other(found)
    if other_hand is None:
        return End(base, found, wrong, math.nan)
    base, surely = other_hand
    return End(base, search(base, report, budget=budget, made=made), wrong, surely, moves=True)


def _promises(whole: Model, model: Model) -> bool:
    """Whether a scan about the fit to all readings, with steps at other moments, could gain what
    the removal of outliers gains.

    whole: fit to all readings. model: fit without outliers.
    """
    if not math.isfinite(whole.log_evidence):
        return True
    about = scanned_about(whole.bare)
    gained = about.score(best_set(about, whole.chosen)) - about.score(whole.chosen)
    worth = about.quadratic.worth
    return gained > worth * (model.log_evidence - whole.log_evidence) + PRIOR


@dataclass
class _Hand:
    """The test of a moving hand against the end of a search.

    clean: whether no outliers were removed before the search. last: the last end tested, and the
    result.
    """

    base: Model
    clean: bool
    budget: Budget
    last: tuple[Found, tuple[Model, float] | None] | None = None

    def moves(self, found: Found) -> bool:
        """Whether a moving hand explains as much as the end of a climb, without outliers. Then the
        search restarts with it, and further climbs are useless."""
        if not self.clean or outliers.standing_out(self.base) or self.budget.spent(_MOVES):
            return False
        return self.other(found) is not None

    def other(self, found: Found) -> tuple[Model, float] | None:
        """The baseline with a moving hand and its advantage, nats, or None; see ``moving``."""
        if self.last is None or self.last[0] is not found:
            self.last = found, moving(self.base, found.model, _gained(found))
        return self.last[1]


def _gained(found: Found) -> dict[str, float]:
    """Gain of each effect, noise included, nats."""
    return gains(found.space, found.model.chosen) | found.noise


def _fits_without(found: Found, masks: Sequence[BoolArray | None], cases: Sequence[Case]) -> bool:
    """Whether the model gains from removal of these headings by more than their odds, fitted from
    its present state or from the online filter."""
    model = found.model
    enough = model.log_evidence - PRIOR
    if fitted(outliers.without(model, masks), model.effects).log_evidence > enough:
        return True
    try:
        begin = [started(c, model.effects) for c in cases]
    except HandcalError:  # (the online filter diverges with these effects)
        return False
    return fitted(begin, model.effects, noise_rounds=2).log_evidence > enough


def _without_outliers(
    start: Model, about: Model, found: Found, budget: Budget, made: Made, report: Report
) -> tuple[Found, outliers.Wrong | None]:
    """The search repeated without headings that stand out from their neighbours about a model, if
    that raises the score. (Missing physics may have hidden these outliers before.)"""
    masks = outliers.standing_out(about)
    if masks is None or budget.spent("single readings that are wrong"):
        return found, None
    # (from the online filter again, since outliers may have distorted the first trajectory)
    cases = [f.case for f in outliers.without(start, masks)]
    if not _fits_without(found, masks, cases):
        return found, None
    begin = [started(c, start.effects) for c in cases]
    other = search(fitted(begin, start.effects, noise_rounds=2), report, budget=budget, made=made)
    gain = advantage(other, found)
    if gain + PRIOR < 0.0:
        return found, None
    return replace(other, alone=found.alone), outliers.share(other.model, masks, gain)
