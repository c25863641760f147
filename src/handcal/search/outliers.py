"""Readings that are merely wrong: a heading that points anywhere now and then."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter
from scipy.special import betaln

from handcal.compiled import so3
from handcal.effects import catalogue
from handcal.estimate.case import Case, Edit, edited
from handcal.estimate.fit import fitted
from handcal.estimate.model import Fitted, Model
from handcal.estimate.problem import constants_of
from handcal.model_score import PRIOR, probability
from handcal.observations import Rows
from handcal.types import Array, BoolArray, Parameter

# In robust sigmas of the smoothed residual: worth a look, and held to be wrong.
FAR = 5.0
WRONG = 4.0
# Headings that must stand out for any to be left out.
FEWEST = 3
# Readings of a heading among which one stands out.
NEIGHBOURS = 11
# Fits without what stands out, at the most: each may show others that do.
ROUNDS = 4
# From body x to the vertical; within 15 deg no heading counts (contract).
STEEP = math.radians(10.0)


@dataclass(frozen=True)
class Wrong:
    """Outliers found: nats gained, posterior probability, share of readings.

    burst: from and to, s, if they come one after the other: that is no share of the readings
    at random, but something that happened there.
    """

    gain: float
    probability: float
    parameter: Parameter
    burst: tuple[float, float] | None = None


def cleaned(base: Model) -> tuple[Model, Wrong | None]:
    """The baseline without outlying headings, if the evidence is for a share of them.

    Each left-out reading costs the logarithm of a uniform density, and how many there are
    that of a share about which nothing is known.
    """
    effect = catalogue()["heading_outliers"]
    parts = [f for f in base.parts if set(effect.outliers) & set(f.case.kinds)]
    fits = math.isfinite(base.log_evidence)  # (of none at all, no reading can be told to be wrong)
    if not fits or not parts or not any(_suspicious(f) for f in parts):
        return base, None
    model, bad = base, 0
    masks: list[BoolArray | None] = []
    for _ in range(ROUNDS):
        masks = [_mask(o, f) for o, f in zip(base.parts, model.parts, strict=True)]
        begin = [_without(*x) for x in zip(base.parts, model.parts, masks, strict=True)]
        model = fitted(begin, base.effects, noise_rounds=1)
        now = sum(int(m.sum()) for m in masks if m is not None)
        if now == bad:
            break
        bad = now
    gain = model.log_evidence - base.log_evidence
    if gain + PRIOR < 0.0 or not bad:
        return base, None
    wrong = share(model, masks, gain)
    span = _burst(base, masks)
    if span is not None:
        steady = fitted(
            [_turned_back(b, f, span) for b, f in zip(base.parts, model.parts, strict=True)],
            base.effects,
            noise_rounds=1,
        )
        if steady.log_evidence > model.log_evidence:
            model, gain = steady, steady.log_evidence - base.log_evidence
    return model, replace(wrong, gain=gain, probability=probability(gain), burst=span)


def put_back(base: Model, model: Model) -> Model:
    """The model fitted to the readings of the baseline, those left out among them: what missing
    physics did to a reading looks like a mistake until that physics is there."""
    begin = []
    for original, f in zip(base.parts, model.parts, strict=True):
        rows = {o.kind: r for o, r, _ in original.case.observed}
        observed = tuple((o, rows[o.kind], constants) for o, _, constants in f.case.observed)
        own = original.case
        case = replace(f.case, observed=observed, constant=own.constant, edits=own.edits)
        begin.append(replace(f, case=case))
    return fitted(begin, model.effects)


def share(model: Model, masks: Sequence[BoolArray | None], gain: float) -> Wrong:
    """The share of headings that were left out of a model, and what that gained."""
    effect = catalogue()["heading_outliers"]
    bad = sum(int(m.sum()) for m in masks if m is not None)
    total = sum(len(m) for m in masks if m is not None)
    mean = (bad + 1.0) / (total + 2.0)
    sigma = math.sqrt(mean * (1.0 - mean) / (total + 3.0))
    # those that point the right way by chance are not seen
    seen = 1.0 - min(0.9, _unseen(model))
    mean, sigma = min(1.0, mean / seen), sigma / seen
    p = effect.parameters[0]
    parameter = Parameter(effect.id, p.name, mean, sigma, p.unit, p.prior_sigma, None)
    return Wrong(gain, probability(gain), parameter)


def standing_out(base: Model) -> list[BoolArray | None] | None:
    """Which headings of each recording are far from what those before and after them say; None
    if none are. The trajectory may err, if only slowly."""
    masks: list[BoolArray | None] = []
    for f in base.parts:
        k = heading_kind(f.case)
        if k is None or f.case.observed[k][0].dim != 1:
            masks.append(None)
            continue
        rows = f.case.observed[k][1]
        told = _told(f, rows)
        if told.sum() < NEIGHBOURS:
            masks.append(None)
            continue
        r = np.exp(1j * _off(f, rows)[told, 0])
        usual = median_filter(r.real, NEIGHBOURS) + 1j * median_filter(r.imag, NEIGHBOURS)
        away = np.abs(np.angle(r / np.where(usual == 0.0, 1.0, usual)))
        scale = max(1.4826 * float(np.median(away)), 1e-4)
        far = (away > FAR * scale).sum() >= FEWEST
        mask = np.zeros(len(told), dtype=bool)
        mask[told] = away > WRONG * scale
        masks.append(mask if far else None)
    return masks if any(m is not None for m in masks) else None


def without(base: Model, masks: Sequence[BoolArray | None]) -> list[Fitted]:
    """The recordings of a model without these headings, to begin a fit from."""
    return [_without(f, f, m) for f, m in zip(base.parts, masks, strict=True)]


def _unseen(model: Model) -> float:
    """Share of wrong headings, anywhere on the circle, that are no further off than a good one;
    of wrong fields, none."""
    widths = [0.0]
    for f in model.parts:
        k = heading_kind(f.case)
        if k is not None and f.case.observed[k][0].dim == 1:
            widths.append(WRONG * _scale(residual(f, k)[1][:, 0]))
    return max(widths) / math.pi


def _scale(r: Array) -> float:
    """Standard deviation of residuals (m,), by their median distance."""
    return 1.4826 * float(np.median(np.abs(r - np.median(r))))


def _turned_back(original: Fitted, f: Fitted, span: tuple[float, float]) -> Fitted:
    """The fit without outliers, with the readings of the burst back in, less what they are off
    by in the median: as if all erred alike. That costs what its moment and its size are worth."""
    k = heading_kind(original.case)
    if k is None:
        return f
    observation, rows, _ = original.case.observed[k]
    there = (rows.t >= span[0]) & (rows.t <= span[1])
    if observation.dim != 1 or not there.any():
        return f
    off = _off(f, rows)[:, 0]
    centre = float(np.median(off[~there]))
    away = so3.wrap(off[there] - centre)
    size = float(np.angle(np.mean(np.exp(1j * away))))
    spread = max(float(np.std(so3.wrap(away - size))), 1e-4) / math.sqrt(there.sum())
    cost = 2.0 * math.log(len(rows.t)) + max(0.0, math.log(math.sqrt(2.0 * math.pi) / spread))
    edit = Edit(observation.kind, (), (span[0], span[1], size), -cost)
    return replace(f, case=edited(original.case, edit))


def _burst(base: Model, masks: Sequence[BoolArray | None]) -> tuple[float, float] | None:
    """When the outliers were, if most of them have an outlier for a neighbour."""
    for f, mask in zip(base.parts, masks, strict=True):
        k = heading_kind(f.case)
        if mask is None or k is None or mask.sum() < FEWEST:
            continue
        if f.case.observed[k][0].dim != 1:
            continue  # (what a magnet that passes does is no turn of north)
        rows = f.case.observed[k][1]
        told = _told(f, rows) | mask
        t, mask = rows.t[told], mask[told]
        beside = np.r_[False, mask[:-1]] | np.r_[mask[1:], False]
        # of outliers at random, one in 1 / (2 share) has an outlying neighbour
        if (mask & beside).sum() > mask.sum() * (2.0 * mask.mean() + 0.4):
            return float(t[mask & beside][0]), float(t[mask & beside][-1])
    return None


def heading_kind(case: Case) -> int | None:
    """Number of the kind that tells a heading, measured or magnetic."""
    kinds = [o.kind for o, _, _ in case.observed]
    return next((k for k, name in enumerate(kinds) if name in ("heading", "magnetometer")), None)


def residual(f: Fitted, k: int) -> tuple[Array, Array]:
    """Times (m,) s and residuals (m, d) of the k-th kind, as they are used."""
    mine = (f.linear.kind == k) & f.linear.used
    t = np.repeat(f.linear.t, np.diff(f.linear.first))
    return t[mine], f.linear.r[mine, : f.problem.observations[k].dim]


def _suspicious(f: Fitted) -> bool:
    k = heading_kind(f.case)
    if k is None:
        return False
    observation, rows, _ = f.case.observed[k]
    r = residual(f, k)[1] if observation.dim == 1 else _off(f, rows)
    return int((_away(r) > FAR * np.maximum(_scales(r), 1e-12)).any(axis=1).sum()) >= FEWEST


def _mask(original: Fitted, f: Fitted) -> BoolArray | None:
    """Which of the original rows are outlying, seen from the fit's trajectory."""
    k = heading_kind(original.case)
    if k is None:
        return None
    t, r = residual(f, k)
    rows = original.case.observed[k][1]
    # (rows that were left out are judged by the trajectory that the others make)
    observation = original.case.observed[k][0]
    if observation.dim == 1 and f.case.constant == 0.0:
        full = np.interp(rows.t, t, r[:, 0])[:, None]
    else:
        full = _off(f, rows)
    least = observation.levels[0].lower
    away = (_away(full) > WRONG * np.maximum(_scales(full), least)).any(axis=1)
    return np.asarray(away & _told(f, rows))


def _away(r: Array) -> Array:
    """How far residuals (m, d) are from the usual: of a heading from all of them; of a field, which
    is bent for seconds at a time, from those before and after."""
    usual = np.median(r, axis=0) if r.shape[1] == 1 else median_filter(r, (NEIGHBOURS, 1))
    return np.asarray(np.abs(r - usual))


def _scales(r: Array) -> Array:
    """Standard deviation of each channel of residuals (m, d), by their median distance (d,)."""
    return np.asarray(1.4826 * np.median(_away(r), axis=0))


def _off(f: Fitted, rows: Rows) -> Array:
    """How far each reading of a heading (m, 1), rad, or of a magnetic field (m, 3), tesla, is from
    what it would be at the attitude of its moment."""
    if rows.z.shape[1] == 1:
        yaw = np.interp(rows.t, f.t, np.unwrap(_yaw(f)))
        return np.asarray(so3.wrap(rows.z[:, 0] - yaw))[:, None]
    problem, constants = f.problem, f.trajectory.constants
    C_nb = so3.between(f.t, f.trajectory.C, rows.t)
    strengths = constants_of(problem, constants, "magnetometer") + rows.z[0, 3:5]
    iron = constants_of(problem, constants, "mag_hard_iron")
    return np.asarray(rows.z[:, :3] - C_nb[:, 1:].transpose(0, 2, 1) @ strengths - iron)


def _told(f: Fitted, rows: Rows) -> BoolArray:
    """Which readings (m,) are of an attitude that has a heading, a field always; where it hardly
    has one, the reading counts in one round and not in the next, so it is judged."""
    if rows.z.shape[1] != 1:
        return np.ones(len(rows.t), dtype=bool)
    up = np.interp(rows.t, f.t, f.trajectory.C[:, 2, 0])
    return np.asarray(np.abs(up) < math.cos(STEEP))


def _yaw(f: Fitted) -> Array:
    C = f.trajectory.C
    return np.asarray(np.arctan2(C[:, 1, 0], C[:, 0, 0]))


def _without(original: Fitted, f: Fitted, mask: BoolArray | None) -> Fitted:
    k = heading_kind(original.case)
    if mask is None or k is None:
        return f
    observation, _, _ = original.case.observed[k]
    effect = catalogue()["heading_outliers"]
    bad, n = int(mask.sum()), len(mask)
    density = effect.outliers[observation.kind]
    constant = bad * math.log(density) + float(betaln(bad + 1, n - bad + 1))
    edit = Edit(observation.kind, tuple(int(i) for i in np.flatnonzero(mask)), None, constant)
    name = next(lv.name for lv in observation.levels if lv.name.endswith("noise"))
    levels = dict(f.levels)
    _, r = residual(f, k)
    levels[name] = max(float(_scales(r).mean()), observation.levels[0].lower)
    return replace(f, case=edited(original.case, edit), levels=levels)
