"""The sentences in which an explanation is told, the same in terminal, report and dashboard: the
verdict, what stands behind it, and what the motion could not tell."""

from __future__ import annotations

import math
from dataclasses import replace

from handcal.explanation import (
    Explanation,
    Missing,
    NextMotion,
    Unnamed,
    broken_off,
    hardly_shown,
)
from handcal.show import doubts, words
from handcal.show.calibration import how_good
from handcal.show.calibration.shown import hardly_any
from handcal.show.calibration.verdict_text import next_first
from handcal.show.explanation.frames import told_mismatch
from handcal.show.explanation.words import (
    channel_shown,
    counted_word,
    either,
    is_always,
    lawless,
    members,
    one_model,
    percent,
    sized,
    the,
    title_of,
    whole_percent,
)
from handcal.show.words import NBSP, Verdict, listed
from handcal.trust import DOUBTFUL

MANY = 5  # names in a row
MATTERS = 0.05  # share of the mismatch from which a cause is one that matters
SURE = 0.999  # from which a probability is said to be more than that
SHARED = 3  # named effects from which a probability that all share is said once


def assumptions(explanation: Explanation) -> list[str]:
    """What was taken for granted, each sentence once."""
    own = (
        words.assume_sentence(r.assume, r.recording.streams, drifts=r.drifts, moves=r.moves)
        for r in explanation.recordings
    )
    return list(dict.fromkeys(own))


def _named(m: Missing, explanation: Explanation) -> str:
    names = members(m, explanation)
    return the(names[0]) + (f" or, less probably, {either(names[1:])}" if len(names) > 1 else "")


def _present(m: Missing, explanation: Explanation) -> str:
    return f"{_named(m, explanation)} (probability {percent(m.probability)})"


def _all_present(explanation: Explanation) -> str:
    """Everything that is named, of many the three that hold most of the mismatch; a probability
    that all share is said once."""
    missing = explanation.missing
    if len(missing) > SHARED:
        first = sorted(missing, key=lambda m: -m.share)[:SHARED]
        least = min(m.probability for m in missing)
        return (
            f"{counted_word(len(missing))} errors, above all "
            f"{listed([_named(m, explanation) for m in first])} (each with probability "
            f"{percent(least)}{'' if least > SURE else ' or more'})"
        )
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
        f"Of the errors found, {many}: {names}. The {counted_word(rest)} {others} less than "
        f"{whole_percent(MATTERS)} each."
    )


def weight(m: Missing) -> str:
    """How much of the mismatch an effect holds, what it does to the readings, and whether unseen
    data agree; of what the baseline has too, no share."""
    parts = [] if is_always(m) else [f"{whole_percent(m.share)} of the mismatch"]
    largest: dict[str, tuple[str, float]] = {}
    for channel, rms in m.size.items():
        sensor = channel.rpartition("_")[0] or channel
        if rms > largest.get(sensor, ("", 0.0))[1]:
            largest[sensor] = channel, rms
    if largest:
        units = [(c, v, channel_shown(c, [v], small=True)) for c, v in largest.values()]
        each = [f"{u.value(v, v)}{NBSP}{u.unit} in {words.channel_title(c)}" for c, v, u in units]
        parts.append(f"adds {listed(each)} (root mean square)")
    if m.held_out_gain is not None:
        parts.append(f"held-out data {'agree' if m.held_out_gain > 0.0 else 'do not agree'}")
    told = "; ".join(parts)
    return f"{told[:1].upper()}{told[1:]}." if told else ""


def shares_note(explanation: Explanation) -> str:
    """Why shares do not add up; empty where they do, or where there is but one."""
    shares = [m.share for m in explanation.missing if not is_always(m)]
    if len(shares) < 2 or round(100 * sum(shares)) == 100:
        return ""
    return (
        "A share is the part of the mismatch that returns if that effect alone is left out; "
        f"shares need not add up to 100{NBSP}%."
    )


def verdict(explanation: Explanation) -> Verdict:
    """The headline and what stands behind it, of any of the four verdicts."""
    e = explanation
    if e.untried and e.missing and e.verdict == "cannot_tell":
        # (what leaves the verdict open is that time ran out; what is named is told as it is)
        e = replace(e, verdict="explained")
    level, headline, sentences = _head(e)
    good = [] if e.impossible else how_good.sentences(e.parameters, e.covariance, e.device)
    sentences[bool(e.untried) :] = [*good, *sentences[bool(e.untried) :]]
    if (first := matters(e)) is not None:
        # (what cannot be told apart comes first: the headline is about that; and what was a
        # headline before time ran out)
        before = (2 if e.verdict == "cannot_tell" else 0) + bool(e.untried) + len(good)
        sentences.insert(before, first)
    if (worst := worst_mismatch(e)) is not None:
        sentences.append(worst)
    proof = held_out_sentence(e)
    if proof is not None and not one_model(e):
        sentences.append(proof)
    trust = doubts.of_explanation(e)
    if trust.level == DOUBTFUL and level == "good":
        level = "partly"
    # (what only the fit tells is among the warnings)
    told = {*sentences, *e.warnings, *e.doubts, broken_off(e.untried)}
    return Verdict(level, headline, (*sentences, *(r for r in trust.reasons if r not in told)))


def _head(e: Explanation) -> tuple[str, str, list[str]]:
    """Level, headline and first sentences; first of all that time ran out, if it did."""
    head = {"unexplained": _unexplained, "cannot_tell": _cannot_tell}.get(
        e.verdict, _explained if e.missing else _nothing
    )
    level, headline, sentences = head(e)
    if not e.untried or e.impossible:
        return level, headline, sentences
    if not e.missing and not e.unnamed:
        headline = "Nothing was found by then."
    return "partly" if level == "good" else level, ran_out(e), [headline, *sentences]


def ran_out(explanation: Explanation) -> str:
    """That the search was cut short, and what it did not come to."""
    untried = list(explanation.untried)
    if len(untried) > MANY:
        untried = [*untried[: MANY - 1], f"{counted_word(len(untried) - MANY + 1)} more"]
    return (
        f"The search ended before all was tried. Not tried, or not to the end: {listed(untried)}."
    )


def _nothing(e: Explanation) -> tuple[str, str, list[str]]:
    level, headline, sentences = "good", "Nothing was found but the biases.", []
    if hardly_any(e.parameters):
        level, headline = next_first(e.parameters)
    open_ = [h for h in e.hypotheses if not h.verdict]
    if open_ and not e.untried:
        best = max(open_, key=lambda h: h.probability)
        tried = words.counted(len(open_), "effect")
        sentences.append(
            f"Of {tried} tried, the most probable is {the(best.title)} (probability "
            f"{percent(best.probability)})."
        )
        if hidden := hardly_shown(e.hypotheses):
            sentences.append(
                f"That is not proof of absence: {words.counted(len(hidden), 'effect')} would "
                f"hardly show in this motion even at the usual size (they are listed below)."
            )
    return level, headline, sentences


def _explained(e: Explanation) -> tuple[str, str, list[str]]:
    return "good", f"Found: {_all_present(e)}.", []


def _unexplained(e: Explanation) -> tuple[str, str, list[str]]:
    besides = ""
    if e.missing:
        named = [_present(m, e) for m in e.missing[:SHARED]]
        if more := len(e.missing) - SHARED if len(e.missing) > SHARED else 0:
            named.append(f"{counted_word(more)} other{'s' * (more > 1)}")
        besides = f", besides {listed(named)}"
    if e.impossible:
        return "poor", "The final fit is physically impossible.", list(e.impossible)
    headline = f"Found: an error that no known effect accounts for{besides}."
    if not e.unnamed:
        return "poor", headline, ["No simple term in the measured signals accounts for it either."]
    u = max(e.unnamed, key=lambda u: u.log_evidence_gain)
    told = (f"As a formula, in SI units: {u.formula} with {sized(u)}.", u.story, lead(u))
    return "poor", headline, [" ".join(part for part in told if part)]


def _cannot_tell(e: Explanation) -> tuple[str, str, list[str]]:
    open_, clear = ([m for m in e.missing if bool(m.indistinguishable_from) is yes]
                    for yes in (True, False))  # fmt: skip
    if not open_:
        return "partly", "Found: an error, but this motion cannot tell which.", []
    sets = [either(members(m, e)) for m in open_]
    likely = listed([percent(m.probability) for m in open_])
    headline = f"Found: {listed(sets, 'and')}; this motion cannot tell which."
    sentences = [f"One of them is present with probability {likely}."]
    if clear:
        sentences.append(f"Clearly separated: {listed([_present(m, e) for m in clear])}.")
    if e.next_motion:
        sentences.append(
            f"Motion that would separate them: {motion_phrase(e.next_motion[0].motion)}."
        )
    return "partly", headline, sentences


def lead(u: Unnamed) -> str:
    """What a formula is worth."""
    return "" if lawless(u) else "A formula is a lead, not yet a cause."


def motion_phrase(motion: str) -> str:
    """A motion within a sentence: no capital, no full stop."""
    return motion[:1].lower() + motion[1:].rstrip(".")


def worst_mismatch(explanation: Explanation) -> str | None:
    """Where and when the baseline fits worst."""
    if not (mismatch := told_mismatch(explanation)):
        return None
    m = max(mismatch, key=lambda m: m.share)
    return (
        f"The baseline fits worst in {words.channel_title(m.channel)}"
        f"{', ' + m.when if m.when else ''} ({whole_percent(m.share)} of the mismatch)."
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


def held_out_sentence(explanation: Explanation) -> str | None:
    """What data that the fit has not seen say of it; None where there were none."""
    h, difference = explanation.held_out, doubts.held_out_gain(explanation)
    if h is None or not math.isfinite(difference):
        return None
    if (worse := doubts.worse_unseen(explanation)) is not None:
        return worse
    better = difference >= doubts.WORSE
    how = "the final model does better" if better else "both models do equally well"
    return f"On held-out data ({h.source}) {how}."


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
    if hidden := hardly_shown(explanation.hypotheses):
        names = listed([the(h.title) for h in hidden])
        sentences.append(
            f"{names[:1].upper()}{names[1:]} would hardly show in this motion even at the usual "
            f"size, and {'is' if len(hidden) == 1 else 'are'} not ruled out."
        )
    weak = [p for m in explanation.missing for p in m.parameters if not p.shown]
    if weak:
        names = listed([words.parameter_title(p) for p in weak])
        sentences.append(
            f"{names} {'is' if len(weak) == 1 else 'are'} part of what was found, but hardly shown "
            f"by this motion: a sigma is more than half of what is usual."
        )
    return sentences
