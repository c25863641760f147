"""The words in which an explanation is told, the same in terminal, report and dashboard.

Everything is a sentence or a short phrase and a function of an ``Explanation``; units
and digits come from ``words``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from handcal.explain.explanation import (
    Explained,
    Explanation,
    Fit,
    Hypothesis,
    Mismatch,
    Missing,
    NextMotion,
    Unnamed,
    is_curve,
)
from handcal.show import words
from handcal.show.words import NBSP, Verdict, effect_title, listed
from handcal.types import Parameter
from handcal.units import Shown, shown

SEEN = 3.0  # nats, odds of twenty to one: what an effect must promise to be looked for
MANY = 5  # names in a row
MATTERS = 0.05  # share of the mismatch from which a cause is one that matters
OVERSURE = 1.6  # mean NIS above which errors are clearly larger than the model allows

SHARED = 3  # named effects from which a probability that all share is said once
_SENSORS = {"accel": "accelerometer", "mag": "magnetometer"}
_UNITS = {
    "gyro": Shown("deg/s", 180.0 / math.pi), "accel": Shown("m/s²", 1.0),
    "heading": Shown("deg", 180.0 / math.pi), "attitude": Shown("deg", 180.0 / math.pi),
    "mag": Shown("µT", 1e6),
}  # fmt: skip
_SMALL = {"accel": "m/s^2", "position": "m", "velocity": "m/s"}
# A law in one line of the terminal: so many signs, of these heights.
SPARKS, BLOCKS = 32, "▁▂▃▄▅▆▇█"
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


def counted_word(n: int) -> str:
    """ "three"; figures beyond ten."""
    return _NUMBERS[n] if n < len(_NUMBERS) else str(n)


def percent(share: float) -> str:
    """A share or probability; never a certainty that nobody has."""
    p = 100 * share
    if not math.isfinite(p):
        return "–"
    if p > 99.9:
        return f"over 99.9{NBSP}%"
    if p < 0.1:
        return f"under 0.1{NBSP}%"
    tenths = p > 99 or p < 1
    return f"{p:.1f}{NBSP}%" if tenths else f"{p:.0f}{NBSP}%"


def whole_percent(share: float) -> str:
    """A share of a total, to a whole percent."""
    return f"{100 * share:.0f}{NBSP}%" if math.isfinite(share) else "–"


def number(value: float) -> str:
    """ "1,240", "−3.1", "0.4"."""
    if not math.isfinite(value):
        return "–"
    text = f"{value:,.0f}" if abs(value) >= 10 else f"{value:.1f}"
    return text.replace("-", "−") if float(text.replace(",", "")) else text.replace("-", "")


def promised(hypothesis: Hypothesis) -> str:
    """What an effect of the usual size would gain; less than nothing is nothing."""
    return number(max(hypothesis.expected, 0.0))


def assumptions(explanation: Explanation) -> list[str]:
    """What was taken for granted, each sentence once."""
    own = (
        words.assume_sentence(r.assume, r.recording.streams, drifts=r.drifts, moves=r.moves)
        for r in explanation.recordings
    )
    return list(dict.fromkeys(own))


def rate(explained: Explained) -> str:
    """ "100 Hz", "400 Hz (averaged to 100)"."""
    used = explained.recording.rate_hz
    if explained.read_hz <= 1.2 * used:
        return f"{used:.0f} Hz"
    return f"{explained.read_hz:.0f} Hz (averaged to {used:.0f})"


def change(before: float, after: float) -> str:
    """ "−44 %"; nothing to say where there is no before."""
    if not (math.isfinite(before) and math.isfinite(after) and before > 0):
        return "–"
    by = round(100 * (after / before - 1))
    return f"{by:+d}{NBSP}%".replace("-", "−") if by else f"0{NBSP}%"


def nats(value: float) -> str:
    """The number with its unit."""
    return f"{number(value)}{NBSP}nats"


def the(title: str) -> str:
    """A title within a sentence: "the gyro scale error"; capitals of names are kept."""
    first = title.split(" ", 1)[0]
    if title == "Gravity":
        return "gravity"
    keep = first in ("Earth", "Coriolis") or first[1:] != first[1:].lower() or len(first) == 1
    return "the " + (title if keep else title[:1].lower() + title[1:])


def channel_title(channel: str) -> str:
    """ "accelerometer y", "heading"."""
    sensor, _, axis = channel.rpartition("_") if channel[-2:-1] == "_" else (channel, "", "")
    return f"{_SENSORS.get(sensor, sensor.replace('_', ' '))} {axis}".rstrip()


def channel_shown(channel: str, values: Sequence[float], small: bool = False) -> Shown:
    """The friendly unit of a channel's readings; small: of its residuals."""
    sensor = channel.rpartition("_")[0] if channel[-2:-1] == "_" else channel
    if sensor in _SMALL and (small or sensor not in _UNITS):
        return shown(_SMALL[sensor], values)
    return _UNITS.get(sensor, Shown("", 1.0))


def channels(*each: Mapping[str, float]) -> list[str]:
    """All channels of several mappings, sensors first, in the order of the contract."""
    order = ("gyro", "accel", "heading", "mag", "position", "velocity", "attitude")
    found = dict.fromkeys(c for m in each for c in m)

    def rank(channel: str) -> tuple[int, str]:
        sensor = channel.rpartition("_")[0] if channel[-2:-1] == "_" else channel
        return (order.index(sensor) if sensor in order else len(order), channel)

    return sorted(found, key=rank)


def title_of(effect: str, explanation: Explanation) -> str:
    """The title of an effect that may be on trial, or else of the catalogue."""
    known = {h.effect: h.title for h in explanation.hypotheses}
    known |= {m.effect: m.title for m in explanation.missing}
    return known.get(effect) or effect_title(effect)


def members(missing: Missing, explanation: Explanation) -> list[str]:
    """Titles of an effect and of those it cannot be told from."""
    others = [title_of(e, explanation) for e in missing.indistinguishable_from]
    return [missing.title, *others]


def either(titles: Sequence[str]) -> str:
    """ "the gravity, the lever arm or the accelerometer scale error"."""
    return listed([the(t) for t in titles], "or")


def one_model(explanation: Explanation) -> bool:
    """Whether nothing was added, so that plain and final model are the same."""
    return not (explanation.missing or explanation.unnamed)


def gain(explanation: Explanation) -> float:
    """Nats that the final model gains over the baseline."""
    return explanation.after.log_evidence - explanation.before.log_evidence


def recording_names(explanation: Explanation) -> list[str]:
    """File names without folders."""
    return [Path(r.recording.path).name for r in explanation.recordings]


def of_recording(index: int, explanation: Explanation) -> str:
    """ " of walk.mcap" where there are several recordings."""
    names = recording_names(explanation)
    return f" of {names[index]}" if len(names) > 1 and 0 <= index < len(names) else ""


def _what(explanation: Explanation) -> str:
    return "the recording" if len(explanation.recordings) == 1 else "the recordings"


def _named(m: Missing, explanation: Explanation) -> str:
    names = members(m, explanation)
    return the(names[0]) + (f" or, less probably, {either(names[1:])}" if len(names) > 1 else "")


def _present(m: Missing, explanation: Explanation) -> str:
    return f"{_named(m, explanation)} (probability {percent(m.probability)})"


def _all_present(explanation: Explanation) -> str:
    """Everything that is named; a probability that all share is said once."""
    missing = explanation.missing
    likely = {percent(m.probability) for m in missing}
    if len(likely) > 1 or len(missing) < SHARED:
        return listed([_present(m, explanation) for m in missing])
    return (
        f"{listed([_named(m, explanation) for m in missing])} (each with probability {min(likely)})"
    )


def matters(explanation: Explanation) -> str | None:
    """Which of many named effects hold most of the mismatch; None where there are few."""
    first = [m for m in explanation.missing if m.share >= MATTERS]
    rest = len(explanation.missing) - len(first)
    if not first or not rest or len(explanation.missing) <= SHARED:
        return None
    names = listed([f"{the(m.title)} ({whole_percent(m.share)} of the mismatch)" for m in first])
    many = "one matters" if len(first) == 1 else f"{counted_word(len(first))} matter"
    others = "other holds" if rest == 1 else "others hold"
    return (
        f"Of these {many}: {names}. The {counted_word(rest)} {others} less than "
        f"{whole_percent(MATTERS)} each."
    )


def weight(m: Missing) -> str:
    """How much of the mismatch an effect holds, what it does to the readings, and whether unseen
    data agree."""
    parts = [f"{whole_percent(m.share)} of the mismatch"]
    largest: dict[str, tuple[str, float]] = {}
    for channel, rms in m.size.items():
        sensor = channel.rpartition("_")[0] or channel
        if rms > largest.get(sensor, ("", 0.0))[1]:
            largest[sensor] = channel, rms
    if largest:
        units = [(c, v, channel_shown(c, [v], small=True)) for c, v in largest.values()]
        each = [f"{u.value(v, v)}{NBSP}{u.unit} in {channel_title(c)}" for c, v, u in units]
        parts.append(f"adds {listed(each)} (root mean square)")
    if m.held_out_gain is not None:
        agree = "agree" if m.held_out_gain > 0.0 else "do not agree"
        signed = f"{'+' if m.held_out_gain > 0 else ''}{nats(m.held_out_gain)}"
        parts.append(f"unseen data {agree} ({signed})")
    return "; ".join(parts) + "."


def verdict(explanation: Explanation) -> Verdict:
    """The headline and what stands behind it, of any of the four verdicts."""
    head = {"nothing_missing": _nothing, "explained": _explained, "unexplained": _unexplained,
            "cannot_tell": _cannot_tell}[explanation.verdict]  # fmt: skip
    level, headline, sentences = head(explanation)
    if (first := matters(explanation)) is not None:
        sentences.insert(0, first)
    if (worst := worst_mismatch(explanation)) is not None:
        sentences.append(worst)
    proof = held_out_sentence(explanation)
    if proof is not None and not one_model(explanation):
        sentences.append(proof)
    doubts = left_over(explanation.after)
    if held_out_gain(explanation) < 0 and explanation.verdict != "nothing_missing":
        level = "partly" if level == "good" else level
    if doubts and explanation.verdict != "unexplained":
        sentences += doubts
        level = "partly" if level == "good" else level
    return Verdict(level, headline, tuple(sentences))


def _nothing(e: Explanation) -> tuple[str, str, list[str]]:
    headline = "Nothing is missing that this motion would show."
    sentences = []
    if e.hypotheses:
        best = max(e.hypotheses, key=lambda h: h.alone)
        tried = words.counted(len(e.hypotheses), "effect")
        change = f"gains {nats(best.alone)}" if best.alone > 0 else f"loses {nats(-best.alone)}"
        enough = "no more than chance gives" if best.alone < SEEN else "too little to be sure"
        sentences.append(f"Of {tried} tried, the best, {the(best.title)}, {change}: {enough}.")
        if hidden := unseen(e):
            sentences.append(
                f"That is not proof of absence: {words.counted(len(hidden), 'effect')} would "
                f"hardly show in this motion even at the usual size (they are listed below)."
            )
    return "good", headline, sentences


def _explained(e: Explanation) -> tuple[str, str, list[str]]:
    if len(e.missing) == 1:
        (m,) = e.missing
        headline = (
            f"Something is missing: {_present(m, e)}, and adding it makes {_what(e)} "
            f"{nats(gain(e))} more probable."
        )
        return "good", headline, []
    headline = (
        f"{counted_word(len(e.missing)).capitalize()} things are missing: {_all_present(e)}. "
        f"Adding them makes {_what(e)} {nats(gain(e))} more probable."
    )
    return "good", headline, []


def _unexplained(e: Explanation) -> tuple[str, str, list[str]]:
    besides = ""
    if e.missing:
        besides = f", besides {listed([_present(m, e) for m in e.missing])}"
    headline = f"Something is missing that no known effect accounts for{besides}."
    if not e.unnamed:
        return "poor", headline, ["No simple term in the measured signals accounts for it either."]
    u = max(e.unnamed, key=lambda u: u.log_evidence_gain)
    found = f"What was found instead: {u.formula} with {sized(u)}, which gains"
    told = (f"{found} {nats(u.log_evidence_gain)}.", u.story, lead(u))
    return "poor", headline, [" ".join(part for part in told if part)]


def lawless(u: Unnamed) -> bool:
    """Whether it is an error that goes with the motion, and no law."""
    return u.formula.partition(" += ")[2].startswith("e(")


def lead(u: Unnamed) -> str:
    """What a formula is worth."""
    return "" if lawless(u) else "A formula is a lead, not yet a cause."


def _cannot_tell(e: Explanation) -> tuple[str, str, list[str]]:
    open_, clear = ([m for m in e.missing if bool(m.indistinguishable_from) is yes]
                    for yes in (True, False))  # fmt: skip
    if not e.missing and e.untried:
        return "partly", "Nothing was found in the time that was given, which was too short.", []
    if not open_:
        return "partly", "Something is missing, but this motion cannot tell what.", []
    sets = [either(members(m, e)) for m in open_]
    likely = listed([percent(m.probability) for m in open_])
    headline = f"Something is missing, but this motion cannot tell which: {listed(sets, 'and')}."
    sentences = [
        f"One of them is present with probability {likely}; adding it makes {_what(e)} "
        f"{nats(sum(m.log_evidence_gain for m in open_))} more probable, whichever it is."
    ]
    if clear:
        sentences.append(f"Told apart clearly: {listed([_present(m, e) for m in clear])}.")
    if e.next_motion:
        sentences.append(f"What would tell: {motion_phrase(e.next_motion[0].motion)}.")
    return "partly", headline, sentences


def motion_phrase(motion: str) -> str:
    """A motion within a sentence: no capital, no full stop."""
    return motion[:1].lower() + motion[1:].rstrip(".")


def worst_mismatch(explanation: Explanation) -> str | None:
    """Where and when the baseline fits worst."""
    if not explanation.mismatch:
        return None
    m = max(explanation.mismatch, key=lambda m: m.share)
    return (
        f"The baseline fits worst in {channel_title(m.channel)}"
        f"{', ' + m.when if m.when else ''} ({whole_percent(m.share)} of the whole misfit)."
    )


def promise(n: NextMotion, explanation: Explanation) -> str:
    """What a motion would do: "sets apart gravity and the lever arm", "would show the ..."."""
    titles = [the(title_of(x, explanation)) for x in n.separates]
    if len(titles) > MANY:
        titles = [*titles[: MANY - 1], f"{counted_word(len(titles) - MANY + 1)} more"]
    alike = [{m.effect, *m.indistinguishable_from} for m in explanation.missing]
    verb = "sets apart" if any(len(titles) > 1 and set(n.separates) <= s for s in alike) else (
        "would show"
    )  # fmt: skip
    return f"{verb} {listed(titles) or 'it'}"


def interval(m: Mismatch) -> str:
    """ "12–31 s", finer where that would be nothing."""
    digits = 0 if m.to_s - m.from_s >= 2 else 1
    return f"{m.from_s:.{digits}f}–{m.to_s:.{digits}f}{NBSP}s"


def held_out_gain(explanation: Explanation) -> float:
    """Nats of the final model over the baseline on unseen data; 0 where there were none."""
    h = explanation.held_out
    return h.log_score_after - h.log_score_before if h else 0.0


def held_out_sentence(explanation: Explanation) -> str | None:
    """What data that the fit has not seen say of it; None where there were none."""
    h, difference = explanation.held_out, held_out_gain(explanation)
    if h is None or not math.isfinite(difference):
        return None
    if abs(difference) < 1.0:
        return f"On data that the fit has not seen ({h.source}) both models do equally well."
    if difference < 0:
        return (
            f"On data that the fit has not seen ({h.source}) the final model does worse, by "
            f"{nats(-difference)}: do not rely on it yet."
        )
    return (
        f"On data that the fit has not seen ({h.source}) the final model does better, by "
        f"{nats(difference)}."
    )


def left_over(fit: Fit) -> list[str]:
    """A sentence where the final model still expects too little of itself."""
    return [
        f"Even so, {channel_title(words.kind_name(kind))} scatters {math.sqrt(nis):.1f} times as "
        f"far as the final model expects: some of it is not accounted for."
        for kind, nis in fit.nis.items() if math.isfinite(nis) and nis > OVERSURE
    ]  # fmt: skip


def unseen(explanation: Explanation) -> list[Hypothesis]:
    """Effects that this motion would not have shown at their usual size."""
    return [h for h in explanation.hypotheses if not h.verdict and h.expected < SEEN]


def untold(explanation: Explanation) -> list[str]:
    """What this motion could not tell, in sentences."""
    sentences = []
    for m in explanation.missing:
        if m.indistinguishable_from:
            names = listed([the(t) for t in members(m, explanation)])
            surely = explanation.verdict == "explained"
            which = f"most probably {the(m.title)}" if surely else "but it is not clear which"
            sentences.append(
                f"{names[:1].upper()}{names[1:]} look alike in this motion: one of them is "
                f"present (probability {percent(m.probability)}), {which}."
            )
    if hidden := unseen(explanation):
        names = listed([the(h.title) for h in hidden])
        sentences.append(
            f"{names[:1].upper()}{names[1:]} would hardly show in this motion even at the usual "
            f"size, and {'is' if len(hidden) == 1 else 'are'} not ruled out."
        )
    weak = [p for m in explanation.missing for p in m.parameters if not p.observable]
    if weak:
        names = listed([words.parameter_title(p) for p in weak])
        sentences.append(
            f"{names} {'is' if len(weak) == 1 else 'are'} part of what is missing, but "
            f"{'was' if len(weak) == 1 else 'were'} not learnt from this motion."
        )
    return sentences


def in_units(parameters: Sequence[Parameter]) -> list[tuple[Parameter, Shown]]:
    """Each with its unit, which it shares with those of its effect."""
    groups = words.by_effect(parameters).values()
    return [(p, unit) for group in groups for unit in [words.shown_group(group)] for p in group]


def sized(u: Unnamed) -> str:
    """ "k = 0.012 ± 0.001 rad/s"; each constant of a formula; the size of a curve."""
    if len(u.constants) > 1:
        return ", ".join(f"{c.name} = {amount(c)}" for c in u.constants)
    if lawless(u) or is_curve(u.formula):
        return f"a size of {amount(u)} (root mean square)"
    return f"k = {amount(u)}"


def over_what(u: Unnamed) -> str:
    """Over what its curve is drawn."""
    return "t" if lawless(u) else ", ".join(u.drivers) or "driver"


def sparkline(u: Unnamed) -> str:
    """The law's curve in one line, over its driver from end to end; empty if there is none."""
    c = u.curve
    if c is None or len(c.x) < 3 or len(u.drivers) != 1:
        return ""
    x = np.linspace(c.x[0], c.x[-1], SPARKS)
    y = np.interp(x, c.x, c.y)
    low, high = float(y.min()), float(y.max())
    steps = np.rint((y - low) / max(high - low, 1e-300) * (len(BLOCKS) - 1)).astype(int)
    unit, over = shown(c.y_unit, [low, high]), shown(c.x_unit, c.x.tolist())
    ends = [f"{v * over.factor:.3g}".replace("-", "−") for v in (c.x[0], c.x[-1])]
    sizes = [f"{v * unit.factor:.2g}".replace("-", "−") for v in (low, high)]
    line = "".join(BLOCKS[k] for k in steps)
    driver = f"{over_what(u)} {over.unit}".rstrip()
    return f"{ends[0]} {line} {ends[1]} {driver}; {sizes[0]} to {sizes[1]} {unit.unit}"


def amount(u: Unnamed | Parameter) -> str:
    """A size with its uncertainty; powers of ten where it is tiny."""
    sigma = abs(u.sigma)
    if not (math.isfinite(u.value) and math.isfinite(sigma) and sigma > 0):
        return f"{u.value:.3g}".replace("-", "−") if math.isfinite(u.value) else "unknown"
    power = math.floor(math.log10(max(abs(u.value), sigma)))
    power = 0 if -3 < power < 5 else power
    digits = min(max(1 - math.floor(math.log10(sigma / 10.0**power)), 0), 7)
    value, spread = (f"{v / 10.0**power:.{digits}f}" for v in (u.value, sigma))
    text = f"{value} ± {spread}".replace("-", "−")
    if power:
        text = f"({text})·10{str(power).translate(_SUPERSCRIPT)}"
    powers = re.sub(r"\^(\d)", lambda m: m[1].translate(_SUPERSCRIPT), u.unit)
    unit = "" if u.unit == "1" else f" {powers}"
    return text + unit
