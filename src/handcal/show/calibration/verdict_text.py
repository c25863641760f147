"""The sentences in which a calibration is told, the same in terminal, report and dashboard: what
was learnt, whether it can be trusted, and what the motion did not show."""

from __future__ import annotations

import math
from collections.abc import Sequence

from handcal.estimate.rest_only import DOUBTED
from handcal.estimate.white import white_levels
from handcal.show.calibration import how_good
from handcal.show.calibration.shown import BIASES, hardly_any, in_front, rest_motion
from handcal.show.words import (
    NBSP,
    Verdict,
    by_effect,
    deaf_heading,
    effect_motion,
    effect_title,
    kind_title,
    listed,
    noise_title,
    parameter_title,
    shown_group,
)
from handcal.types import Innovations, Parameter, Result

INFLATED = 5.0
STRAYED = 6.0  # sigma; of thousands of looks at an honest estimate hardly one gets there
# What shows the gyro's bias beside a reference, and what is to be said of both biases.
_BESIDE = "rests"
_REFERENCE_TOO = (
    ", for the reference has a bias of its own, which only rests show (--reference-exact where it "
    "has none)"
)


def nis_word(innovations: Innovations) -> str:
    """Whether the filter's own error bounds agree with what it saw.

    Thousands of updates make a chi-square test reject models that are perfectly
    usable, so "consistent" is NIS per degree of freedom from 0.5 to 1.6: sigmas
    right to about a quarter.
    """
    mean = innovations.mean_nis
    if mean is None:
        return "no data"
    return "too confident" if mean > 1.6 else "too cautious" if mean < 0.5 else "consistent"


def nis_sentence(kind: str, innovations: Innovations) -> str | None:
    """What a NIS away from one means for the numbers above; None where it is consistent."""
    word, mean = nis_word(innovations), innovations.mean_nis
    if mean is None or word == "consistent":
        return None
    title = kind_title(kind)
    if word == "too confident":
        return (
            f"The {title} observations scatter {math.sqrt(mean):.1f} times as far as the filter "
            f"expects: true errors may be that much larger than the ± values."
        )
    return (
        f"The {title} observations agree {1 / math.sqrt(mean):.1f} times better than the filter "
        f"expects: the ± values are on the large side."
    )


def strayed(result: Result) -> tuple[str, ...]:
    """A sentence for each effect whose estimate moved further than its own sigmas allow.

    An estimate at t and the final one differ with the variance P(t) - P(end) if the model
    holds (Hausman's test); looked at in the second half of the recording.
    """
    h, sentences = result.history, []
    late = h.t >= 0.5 * (h.t[0] + h.t[-1])
    for group in by_effect(result.parameters).values():
        worst: tuple[float, Parameter, float] | None = None
        for p in group:
            c = result.parameters.index(p)
            moved = abs(h.parameters[late, c] - h.parameters[-1, c])
            floor = 0.5 * h.parameter_sigma[-1, c] ** 2
            spread = (h.parameter_sigma[late, c] ** 2 - h.parameter_sigma[-1, c] ** 2).clip(floor)
            ratio = moved / spread**0.5
            at = int(ratio.argmax())
            if p.shown and ratio[at] > STRAYED and (worst is None or ratio[at] > worst[0]):
                worst = (float(ratio[at]), p, float(moved[at]))
        if worst is not None:
            _, p, moved_by = worst
            unit = shown_group(group)
            by = f"{unit.value(moved_by, p.sigma)}{NBSP}{unit.unit}"
            sentences.append(
                f"{parameter_title(p)} moved by {by} in the second half, more than its ± values "
                f"allow: it changes, or it stands in for "
                f"an effect that the model lacks."
            )
    return tuple(sentences)


def inflated(result: Result) -> tuple[str, ...]:
    """A sentence for each sensor whose noise had to be taken far above what its readings show."""
    if result.recording.imu.t.size < 100:
        return ()
    shown_by_readings, sentences = white_levels(result.recording), []
    for n in result.noise:
        ratio = n.value / shown_by_readings.get(n.name, math.inf)
        if n.estimated and ratio > INFLATED:
            sentences.append(
                f"{noise_title(n.name)} had to be taken {ratio:.0f} times as large as the readings "
                f"show, to make up for something that the model lacks; the ± values include that."
            )
    return tuple(sentences)


def _known_to(parameters: Sequence[Parameter]) -> str:
    worst, unit = max(p.sigma for p in parameters), shown_group(parameters)
    title = effect_title(parameters[0].effect).lower()
    return f"{title} ±{unit.value(worst, worst)}{NBSP}{unit.unit}"


def verdict(result: Result) -> Verdict:
    """What was learnt, and whether it can be trusted, in a few sentences."""
    front, rest = in_front(result.parameters)
    learnt = [p for p in front if p.shown]
    n, of = len(learnt), len(front)
    doubts = [s for k, i in result.innovations.items() if (s := nis_sentence(k, i))]
    lacking = [*strayed(result), *inflated(result)]
    if (deaf := deaf_heading(result.noise)) is not None:
        lacking.append(deaf)
    if not result.settled:
        lacking.append("The estimate had not come to rest when it was given up.")
    doubts += lacking
    overconfident = bool(lacking) or any(
        nis_word(i) == "too confident" for i in result.innovations.values()
    )
    fell_back = any(w.startswith(DOUBTED) for w in result.warnings)
    if hardly_any(result.parameters):
        level, headline = next_first(front)
    elif fell_back:
        level, headline = "partly", "These numbers are of the rests alone, and may be far off."
    elif overconfident:
        level, headline = "partly", "Something in this recording is not explained by the model."
    elif n < of:
        level, headline = "partly", f"{n} of {of} parameters were learnt from this motion."
    else:
        what = "All that this motion shows" if rest else "Every parameter"
        level, headline = "good", f"{what} was learnt, and the numbers hold together."
    more = how_good.sentences(result.parameters, result.covariance, result.before)
    more += _sentences(result, learnt, doubts, fell_back)
    if overconfident and not result.repeated:
        more.append(
            "Usual causes: a held point that moved, or an effect that --effects did not include: "
            "handcal explain tries them all."
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
    result: Result, learnt: Sequence[Parameter], doubts: Sequence[str], fell_back: bool
) -> list[str]:
    """What is known, and what there is to doubt."""
    sentences: list[str] = []
    # (of what is hardly other than zero, the table tells)
    told = {p.effect for p in learnt if p.effect in BIASES or abs(p.value) > 3.0 * p.sigma}
    groups = [g for g in by_effect(learnt).values() if g[0].unit and g[0].effect in told]
    if groups:
        known = listed([_known_to(g) for g in groups])
        sentences.append(f"If the model is complete, known to one sigma: {known}.")
    if fell_back:
        sentences.append(
            "As a held point the hand would have moved too far. Effects that the model lacks look "
            "the same, and then they are in these biases, many times the ± values: handcal explain "
            "tells the two apart."
        )
    elif result.innovations and not doubts:
        sentences.append("The residuals match the predicted uncertainty.")
    return [*sentences, *doubts]


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
        why = f"{subject}: ±{now}{NBSP}{unit.unit} now, against ±{before}{NBSP}{unit.unit} before"
        if reference and effect in BIASES:
            motion = (_BESIDE if effect == "gyro_bias" else motion) + _REFERENCE_TOO
        elif effect == "gyro_bias" and not heading:
            motion += (
                ". Without a heading, the bias of the axis that stays vertical looks like a slow "
                "turn: turn about a second axis too, or record a magnetometer or compass heading"
            )
        sentences.append(f"{why}. What would show it: {motion}.")
    return (*sentences, rest_motion(rest)) if rest else tuple(sentences)
