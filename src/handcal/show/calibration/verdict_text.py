"""The sentences in which a calibration is told, the same in terminal, report and dashboard: what
was learnt, whether it can be trusted, and what the motion did not show."""

from __future__ import annotations

from collections.abc import Sequence

from handcal.estimate.rest_only import DOUBTED
from handcal.show import doubts
from handcal.show.calibration import how_good
from handcal.show.calibration.shown import BIASES, hardly_any, in_front, rest_motion
from handcal.show.words import (
    NBSP,
    Verdict,
    by_effect,
    effect_motion,
    effect_title,
    listed,
    parameter_title,
    shown_group,
)
from handcal.trust import NONE
from handcal.types import Parameter, Result

# What shows the gyro's bias beside a reference, and what is to be said of both biases.
_BESIDE = "rests"
_REFERENCE_TOO = (
    ", for the reference has a bias of its own, which only rests show (--reference-exact where it "
    "has none)"
)


def _known_to(parameters: Sequence[Parameter]) -> str:
    worst, unit = max(p.sigma for p in parameters), shown_group(parameters)
    title = effect_title(parameters[0].effect).lower()
    return f"{title} ±{unit.value(worst, worst)}{NBSP}{unit.unit}"


def verdict(result: Result) -> Verdict:
    """What was learnt, and whether it can be trusted, in a few sentences."""
    front, rest = in_front(result.parameters)
    learnt = [p for p in front if p.shown]
    n, of = len(learnt), len(front)
    trust = doubts.of_calibration(result)
    # (of the hand and of --only the warnings tell)
    reasons = [r for r in trust.reasons if r not in result.doubts]
    against = [*doubts.cautious(result), *(r for r in reasons if r not in result.warnings)]
    fell_back = any(w.startswith(DOUBTED) for w in result.warnings)
    if trust.level == NONE:
        level, headline = "poor", "The fit is physically impossible."
    elif hardly_any(result.parameters):
        level, headline = next_first(front)
    elif fell_back:
        level, headline = "partly", "These numbers come from the rests alone, and may be far off."
    elif reasons:
        level, headline = "partly", "Something in this recording is not explained by the model."
    elif n < of:
        level, headline = "partly", f"This motion determined {n} of {of} parameters."
    else:
        what = "All that this motion shows" if rest else "Every parameter"
        level = "good"
        headline = f"{what} was determined, and the residuals are consistent with the model."
    if trust.level == NONE:
        return Verdict(level, headline, trust.reasons)
    more = how_good.sentences(result.parameters, result.covariance, result.before)
    more += _sentences(result, learnt, against, fell_back)
    if reasons and not result.repeated:
        more.append(
            "Usual causes: the held point moved, or an effect is missing from --effects. handcal "
            "explain tries all effects."
        )
    return Verdict(level, headline, tuple(more))


def next_first(parameters: Sequence[Parameter]) -> tuple[str, str]:
    """Level and headline where hardly anything is shown: what to do next."""
    biases = [p for p in parameters if p.effect in BIASES]
    hidden = dict.fromkeys(p.effect for p in biases if not p.shown)
    wanted = "; ".join(effect_motion(e) for e in hidden)
    level = "partly" if any(p.shown for p in biases) else "poor"
    return level, f"To do next: {wanted}. This motion showed hardly anything."


def _sentences(
    result: Result, learnt: Sequence[Parameter], against: Sequence[str], fell_back: bool
) -> list[str]:
    """What is known, and what there is to doubt."""
    sentences: list[str] = []
    # (of what is hardly other than zero, the table tells)
    told = {p.effect for p in learnt if p.effect in BIASES or abs(p.value) > 3.0 * p.sigma}
    groups = [g for g in by_effect(learnt).values() if g[0].unit and g[0].effect in told]
    if groups:
        known = listed([_known_to(g) for g in groups])
        sentences.append(f"One sigma, if the model is complete: {known}.")
    if fell_back:
        sentences.append(
            "With a fixed held point, the fit needs more sway than a hand makes. Either the hand "
            "travelled, or effects are missing from the model; these then bias the numbers by "
            "many times the ± values. handcal explain finds out which."
        )
    elif result.innovations and not against:
        sentences.append("The residuals match the predicted uncertainty.")
    return [*sentences, *against]


def not_shown(result: Result) -> tuple[str, ...]:
    """A sentence for each effect in front that this motion left unknown, with what would show it,
    and one for the rest."""
    front, rest = in_front(result.parameters)
    sentences = []
    heading = "heading" in result.innovations or "magnetometer" in result.innovations
    reference = "known_input" in result.innovations
    for (effect, _), group in by_effect(front).items():
        hidden = [p for p in group if not p.shown]
        if not hidden:
            continue
        best, unit = min(hidden, key=lambda p: p.sigma / p.prior_sigma), shown_group(group)
        motion = effect_motion(effect)
        subject = listed([parameter_title(hidden[0]), *(p.name for p in hidden[1:])])
        now, before = unit.value(best.sigma, best.sigma), unit.value(best.prior_sigma)
        why = f"{subject}: ±{now}{NBSP}{unit.unit}, from a prior of ±{before}{NBSP}{unit.unit}"
        if reference and effect in BIASES:
            motion = (_BESIDE if effect == "gyro_bias" else motion) + _REFERENCE_TOO
        elif effect == "gyro_bias" and not heading:
            motion += (
                ". Without a heading, the bias of the axis that stays vertical looks like a slow "
                "turn: turn about a second axis too, or record a magnetometer or compass heading"
            )
        sentences.append(f"{why}. Motion that would show it: {motion}.")
    return (*sentences, rest_motion(rest)) if rest else tuple(sentences)
