"""Named effects and their ambiguity sets, terms without a name, and all hypotheses on trial."""

from __future__ import annotations

import math
from collections.abc import Container, Iterator, Mapping, Sequence, Set
from dataclasses import replace

import numpy as np

from handcal.effects import Effect, catalogue
from handcal.estimate.case import Case, name_of
from handcal.estimate.model import Model
from handcal.estimate.process import process_parameters
from handcal.explain import importance
from handcal.explanation import Curve, Hypothesis, Missing, Unnamed, is_curve
from handcal.laws import with_motion
from handcal.laws.curve import drawn, drivers_of
from handcal.laws.law_effect import channels_of
from handcal.model_score import CERTAIN, NAMED, probability
from handcal.search import outliers
from handcal.search.beyond_columns import ALIKE, akin
from handcal.search.common_found import Shown, parameters_in, shown, stands_out
from handcal.search.multistart import Found
from handcal.search.space import Space, expected_gain, gains, probabilities, rivals
from handcal.types import Parameter

# Probability from which an effect is reported, and share of its set from which a rival is listed.
LIKELY = 0.5
RIVAL = 0.05
# Relative accuracy of a named formula, in power (a twentieth in size). A law below it, beside names
# on the same channels, may be the error of the formula.
LEFT = 0.0025
# Largest gain of a motion-dependent accelerometer error that the hand may have caused, nats. Among
# 28 simulated people without any error two, both in a lift, had 12 to 35 although drifting and
# moving hands were on trial. (To others the lift gave 93 and 551, beyond this limit.)
LENT = 40.0


def entries_of(
    found: Found,
    chosen: frozenset[str],
    learnt: Mapping[str, tuple[Parameter, ...]],
    wrong: outliers.Wrong | None,
) -> tuple[list[Missing], bool]:
    """The model's effects as reported, and whether one of them has a rival of similar odds."""
    where, model = found.space, found.model
    probable, gained = _probable(where, chosen), gains(where, chosen)
    common = shown(where, chosen)
    out, unsure = [], False
    for effect in model.effects:
        if "+=" in effect.id:
            continue
        if effect.process is not None:
            gain = found.noise[effect.id]
            own = process_parameters(model, effect)
            out.append(_entry(effect, probability(gain), gain, (), own))
            continue
        if effect.common:
            if effect.id in common:
                entry, doubt = _of_common(where, effect, common[effect.id], learnt[effect.id])
                out.append(entry)
                unsure |= doubt
            continue
        if not stands_out(learnt[effect.id]):
            continue
        set_, share = _set(found, chosen, effect.id)
        members = {name_of(i) for i in set_}
        p = min(CERTAIN, sum(v for i, v in probable.items() if name_of(i) in members))
        gain = gained[effect.id]
        unsure |= share < NAMED and p > LIKELY
        names = dict.fromkeys(name_of(i) for i in set_ if name_of(i) != name_of(effect.id))
        out.append(_entry(effect, p, gain, tuple(names), learnt[effect.id]))
    if wrong is not None:
        out.append(
            _entry(catalogue()["heading_outliers"], wrong.probability, wrong.gain, (),
                   (wrong.parameter,))
        )  # fmt: skip
    return out, unsure


def _of_common(
    where: Space, effect: Effect, found: Shown, own: tuple[Parameter, ...]
) -> tuple[Missing, bool]:
    """A common effect that was found, under the name of the likeliest effect in its place, and
    whether another is about as likely."""
    odds = {effect.id: 0.0, **found.rivals}
    top = max(odds.values())
    total = sum(math.exp(v - top) for v in odds.values())
    share = {i: math.exp(v - top) / total for i, v in odds.items()}
    order = sorted(odds, key=lambda i: -share[i])
    first = where.effects[order[0]]
    if first.id != effect.id:
        own = parameters_in(where, first, (found.others - {effect.id}) | {first.id})
    members = [i for i in order if i == effect.id or share[i] >= RIVAL]
    names = dict.fromkeys(map(name_of, (*members, *found.beside)))
    others = tuple(i for i in names if i != name_of(first.id))
    entry = _entry(first, probability(found.gain), found.gain, others, own)
    return entry, share[first.id] < NAMED or bool(found.beside)


def _probable(where: Space, chosen: frozenset[str]) -> dict[str, float]:
    """Probability of each effect at the end of a search with the chosen ones."""
    return probabilities(where, chosen, most=where.score(chosen))


def likely(entries: Sequence[Missing], alone: Mapping[str, float]) -> list[Missing]:
    """Entries that are likelier than not; alone: see ``standing_out``."""
    out = [replace(m, probability=m.probability * alone.get(m.effect, 1.0)) for m in entries]
    return [m for m in out if m.probability > LIKELY]


def standing_out(model: Model) -> dict[str, float]:
    """Probability of each name of the model that it is a separate error, not part of an error
    without a known law. Empty if the model has no law and no such error."""
    if all("+=" not in e.id for e in model.effects):
        return {}
    return {name_of(e.id): _own(model, e) for e in model.effects}


def _own(model: Model, effect: Effect) -> float:
    """Probability that an effect of the model is separate from the errors without a known law on
    its channels.

    It rises with the ratio of the effect's power to that of the laws and motion-dependent errors,
    on all channels together or on the best one. It is 1 unless one of these is a curve or a
    motion-dependent error. (For noise any law counts, since its residual looks like noise.)
    """
    if effect.id not in model.ids or "+=" in effect.id:
        return 1.0
    size = _squares(model, effect)
    beside = {e.id: _squares(model, e, size) for e in model.effects if "+=" in e.id}
    lawless = any(v for i, v in beside.items() if with_motion.is_with_motion(i) or is_curve(i))
    if not lawless and effect.process is None:
        return 1.0
    rest = {c: sum(v.get(c, 0.0) for v in beside.values()) for c in size}
    if not any(rest.values()):
        return 1.0
    each = [size[c] / rest[c] for c in size if rest[c]]
    return probability(0.5 * max(sum(size.values()) / sum(rest.values()), *each))


def _squares(
    model: Model, effect: Effect, channels: Container[str] | None = None
) -> dict[str, float]:
    """Variance over time of an effect's error, by channel; channels: those to include (None:
    all)."""
    sizes = importance.sizes(model, effect, spread=True)
    return {c: v**2 for c, v in sizes.items() if channels is None or c in channels}


def _set(found: Found, chosen: frozenset[str], effect: str) -> tuple[list[str], float]:
    """The effect and its rivals of sufficient share, the effect first, and its share of the set."""
    scores = rivals(found.space, chosen, effect)
    scores = {i: s for i, s in scores.items() if "+=" not in i}
    swaps = found.swaps.items()
    scores |= {r: -worse for (e, r), worse in swaps if e == effect and r not in chosen}
    scores |= {r: s / ALIKE for r, s in scores.items() if akin(effect, r)}
    total = sum(math.exp(min(s, 50.0)) for s in scores.values())
    shares = {i: math.exp(min(s, 50.0)) / total for i, s in scores.items()}
    by_name: dict[str, float] = {}
    for i, s in shares.items():
        by_name[name_of(i)] = by_name.get(name_of(i), 0.0) + s
    own = name_of(effect)
    members = [effect]
    for i in sorted(shares, key=lambda i: -shares[i]):
        name = name_of(i)
        if name != own and by_name[name] >= RIVAL and all(name_of(m) != name for m in members):
            members.append(i)
    return members, by_name[own]


def _entry(
    effect: Effect,
    probability: float,
    gain: float,
    others: tuple[str, ...],
    parameters: tuple[Parameter, ...],
) -> Missing:
    return Missing(
        name_of(effect.id),
        effect.title,
        min(CERTAIN, probability),
        gain,
        others,
        parameters,
        effect.story,
        effect.motion,
    )


def unnamed_of(
    found: Found, chosen: frozenset[str], learnt: Mapping[str, tuple[Parameter, ...]]
) -> list[Unnamed]:
    """The model's terms without a name, most evidence first."""
    gained = gains(found.space, chosen)
    out = []
    for effect in found.model.effects:
        if with_motion.is_with_motion(effect.id):
            out.append(_with_motion(found.model, effect, found.noise[effect.id]))
        elif "+=" in effect.id:
            out.append(_unnamed(found.model, effect, learnt[effect.id], gained[effect.id]))
    return sorted(out, key=lambda u: -u.log_evidence_gain)


def _with_motion(model: Model, effect: Effect, gain: float) -> Unnamed:
    """A motion-dependent error without a law, as an entry of the result."""
    own = process_parameters(model, effect)
    curve, size = with_motion.course(model.parts[0], effect)
    return Unnamed(
        effect.id, size, size * own[0].sigma / max(own[0].value, 1e-300), curve.y_unit, gain,
        effect.story, with_motion.channels(effect), with_motion.drivers(effect), curve,
    )  # fmt: skip


def _unnamed(model: Model, effect: Effect, own: tuple[Parameter, ...], gain: float) -> Unnamed:
    mine = np.array([n[0] == effect.id for n in model.quadratic.names])
    scale = effect.prior_sigma
    C = model.covariance[np.ix_(mine, mine)] * np.outer(scale, scale)
    values = np.array([p.value for p in own])
    shown = drawn(model.parts[0], effect, values, C)
    channels = channels_of(effect)
    drivers = drivers_of(effect.id)
    size, sigma, unit = shown.size, shown.sigma, shown.curve.y_unit
    smooth = effect.together is not None
    constants = () if smooth else own
    if len(constants) == 1:
        size, sigma, unit = own[0].value, own[0].sigma, own[0].unit
    return Unnamed(
        effect.id, size, sigma, unit, gain, effect.story, channels, drivers, shown.curve,
        constants, effect.made, tuple(values.tolist()) if smooth else (),
    )  # fmt: skip


def burst(base: Model, wrong: outliers.Wrong, span: tuple[float, float]) -> Unnamed:
    """A burst of outliers as a term: their mean error, rad, from start to end, s."""
    k = outliers.heading_kind(base.parts[0].case)
    assert k is not None
    t, r = outliers.residual(base.parts[0], k)
    r = r[(t >= span[0]) & (t <= span[1]), 0]
    spread = float(np.std(r)) / math.sqrt(max(1, len(r)))
    formula = f"heading += k from {span[0]:.1f} s to {span[1]:.1f} s"
    story = f"Something was there from {span[0]:.0f} s to {span[1]:.0f} s, and then no more."
    value = float(np.mean(r)) if len(r) else 0.0
    drawn = Curve(np.array(span), np.full(2, value), np.full(2, spread), "s", "rad")
    return Unnamed(
        formula, value, spread, "rad", wrong.gain, story, ("heading",), ("t",), drawn,
        (), ("while", span),
    )  # fmt: skip


def hypotheses_of(
    found: Found,
    missing: Sequence[Missing],
    wrong: outliers.Wrong | None,
    alone: Mapping[str, float],
) -> tuple[Hypothesis, ...]:
    """Every effect on trial, the highest gain alone first; alone: see ``standing_out``."""
    where = found.space
    chosen = found.model.chosen
    probable, final = _probable(where, chosen), gains(where, chosen)
    named = {m.effect: m for m in missing}
    rival = {i for m in missing for i in m.indistinguishable_from}
    out: dict[str, Hypothesis] = {}
    for i in where.effects:
        name = name_of(i)
        if "+=" in i:
            continue
        gained = max((v for k, v in found.alone.items() if name_of(k) == name), default=0.0)
        ones = np.ones(len(where.where[i]))
        kept = out.get(name)
        if kept is not None and kept.final >= final[i]:
            continue
        verdict = "named" if name in named else "set" if name in rival else ""
        together = sum(p for k, p in probable.items() if name_of(k) == name)
        if where.effects[i].common:  # (every model has it, so its own gain decides)
            together = probability(final[i])
        if name in named:  # (it may be named in place of a common effect of the model)
            together = max(together, named[name].probability)
        out[name] = Hypothesis(
            name, catalogue()[name].title, gained, final[i],
            expected_gain(where, i, chosen, ones),
            min(CERTAIN, together * alone.get(name, 1.0)), verdict,
        )  # fmt: skip
    out |= {h.effect: h for h in _of_noise(found, set(named), alone)}
    if wrong is not None:
        title = catalogue()["heading_outliers"].title
        out["heading_outliers"] = Hypothesis(
            "heading_outliers", title, wrong.gain, wrong.gain, math.nan, wrong.probability, "named"
        )
    return tuple(sorted(out.values(), key=lambda h: -h.alone))


def _of_noise(found: Found, named: Set[str], alone: Mapping[str, float]) -> Iterator[Hypothesis]:
    """Hypotheses of the model's noise effects."""
    for name, gain in found.noise.items():
        if name in catalogue():
            verdict = "named" if name in named else ""
            yield Hypothesis(
                name, catalogue()[name].title, gain, gain, math.nan,
                probability(gain) * alone.get(name, 1.0), verdict,
            )  # fmt: skip


def by_the_hand(u: Unnamed, cases: Sequence[Case]) -> bool:
    """Whether a motion-dependent error may be a hand that does not hold its point: if it is on the
    accelerometer only, and gains no more than simulated hands did."""
    held = any("fixed_position" in case.kinds for case in cases)
    accel = all(channel.startswith("accel") for channel in u.channels)
    lawless = with_motion.is_with_motion(u.formula)
    return held and accel and lawless and u.log_evidence_gain < LENT


def hand_remark(u: Unnamed) -> str:
    """The sentence about an error for which ``by_the_hand`` is true."""
    return (
        f"The accelerometer seems to err with the motion ({u.formula}, "
        f"{u.log_evidence_gain:,.0f} nats); a hand that does not quite turn the device about one "
        "point looks the same. A recording with rests in many directions would tell."
    )


def next_to_nothing(model: Model, u: Unnamed) -> bool:
    """Whether a term is negligible beside the names on the same channels, whose formulas are not
    exact."""
    own = [e for e in model.effects if e.id == u.formula]
    names = [e for e in model.effects if "+=" not in e.id]
    mine = sum(v for e in own for v in _squares(model, e).values())
    return mine < LEFT * sum(v for e in names for v in _squares(model, e, u.channels).values())


def remark(u: Unnamed) -> str:
    """The sentence about a term that is negligible."""
    return (
        f"Besides, {u.formula} gains {u.log_evidence_gain:.0f} nats: it adds next to nothing to "
        "the readings beside what is named there, and is left out of the model."
    )


def parameters_of(fit: Sequence[Parameter], effect: Effect) -> tuple[Parameter, ...]:
    """The parameters of an effect among those of a fit."""
    return tuple(p for p in fit if p.effect == name_of(effect.id))
