"""What there is to doubt about a calibration or an explanation, in sentences, and the trust that is
left: the same in terminal, page, JSON and Python, and wherever a result is handed on."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from handcal.estimate.impossible import of_result, strange, too_large
from handcal.estimate.result import MOVED
from handcal.estimate.white import white_levels
from handcal.explanation import Explanation, broken_off
from handcal.show.words import (
    NBSP,
    by_effect,
    deaf_heading,
    kind_title,
    noise_title,
    parameter_title,
    shown_group,
)
from handcal.trust import Trust, judged
from handcal.types import Array, Innovations, Parameter, Recording, Result

OVERSURE, OVERCAUTIOUS = 1.6, 0.5  # NIS per degree of freedom: sigmas right to about a quarter
INFLATED = 5.0
STRAYED = 6.0  # sigma; of thousands of looks at an honest estimate hardly one gets there
WORSE = 1.0  # nats on unseen data that are no accident
# Of the motion, the share without a measurement from which that is much.
MUCH = 0.1


def of_calibration(result: Result) -> Trust:
    """How far the numbers of a calibration can be trusted, and why no further."""
    doubts = [
        *result.doubts,
        *([] if result.settled else [MOVED]),
        strange(too_large(result.parameters)),
        saturated(result.recording, result.rests),
        *oversure(result),
        *strayed(result),
        *inflated(result),
        deaf_heading(result.noise),
    ]
    unfit = [result.recording.unfit] if result.recording.unfit else []
    return judged([*unfit, *of_result(result)], filter(None, doubts))


def of_explanation(explanation: Explanation) -> Trust:
    """How far the numbers of an explanation can be trusted, and why no further."""
    e = explanation
    doubts = [
        broken_off(e.untried),
        *e.doubts,
        worse_unseen(e),
        *dict.fromkeys(saturated(r.recording, r.rests) for r in e.recordings),
        *left_over(e.after.nis),
        deaf_heading(n for r in e.recordings for n in r.noise),
    ]
    unfit = dict.fromkeys(r.recording.unfit for r in e.recordings if r.recording.unfit)
    return judged([*unfit, *e.impossible], filter(None, doubts))


def held_out_gain(explanation: Explanation) -> float:
    """Nats of the final model over the baseline on unseen data; 0 where there were none."""
    h = explanation.held_out
    return h.log_score_after - h.log_score_before if h else 0.0


def worse_unseen(explanation: Explanation) -> str | None:
    """That data which the fit has not seen speak against it; None where they do not."""
    h, gain = explanation.held_out, held_out_gain(explanation)
    if h is None or not gain <= -WORSE:
        return None
    return (
        f"On held-out data ({h.source}) the final model does worse, by {-gain:.3g} nats: do not "
        "rely on it yet."
    )


def left_over(nis: Mapping[str, float]) -> list[str]:
    """A sentence for each kind or channel where the final model expects too little of itself."""
    return [
        f"Even so, {kind_title(kind)} scatters {math.sqrt(value):.1f} times as "
        f"far as the final model expects: some of it is not accounted for."
        for kind, value in nis.items() if math.isfinite(value) and value > OVERSURE
    ]  # fmt: skip


def saturated(recording: Recording, rests: Array) -> str | None:
    """That much of the motion has no measurement; None where it has. rests (r, 2): s."""
    t, valid = recording.imu.t, recording.imu.valid
    moving = np.ones(len(t), dtype=np.bool_)
    for start, end in rests:
        moving &= (t < start) | (t > end)
    share = float(np.mean(~valid[moving])) if moving.any() else 0.0
    if share < MUCH:
        return None
    return (
        f"In {100 * share:.0f}{NBSP}% of the motion a sensor was at the end of its measuring "
        "range (saturated) or not read: the motion there is a guess. Set a larger range, or move "
        "less."
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
    if mean > OVERSURE:
        return "too confident"
    return "too cautious" if mean < OVERCAUTIOUS else "consistent"


def oversure(result: Result) -> list[str]:
    """A sentence for each kind of observation of which the filter expects too little error."""
    return [
        f"The {kind_title(kind)} observations scatter {math.sqrt(i.mean_nis):.1f} times as far as "
        "the filter expects: true errors may be that much larger than the ± values."
        for kind, i in result.innovations.items()
        if i.mean_nis is not None and i.mean_nis > OVERSURE
    ]


def cautious(result: Result) -> list[str]:
    """A sentence for each kind of which it expects too much: no doubt, but the sigmas are large."""
    return [
        f"The {kind_title(kind)} observations agree {1 / math.sqrt(i.mean_nis):.1f} times better "
        "than the filter expects: the ± values are on the large side."
        for kind, i in result.innovations.items()
        if i.mean_nis is not None and i.mean_nis < OVERCAUTIOUS
    ]


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
