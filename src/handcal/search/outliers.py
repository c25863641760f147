"""Outliers among headings and magnetometer readings."""

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

# In robust sigmas of the residual from its usual value: suspicious, and an outlier.
FAR = 5.0
WRONG = 4.0
# Least count of suspicious readings from which outliers are removed.
FEWEST = 3
# Width of the median filter, in readings.
NEIGHBOURS = 11
# Largest count of rounds of removal and fit: each may show further outliers.
ROUNDS = 4
# Angle from body x to the vertical within which a heading is not judged, rad.
STEEP = math.radians(10.0)


@dataclass(frozen=True)
class Wrong:
    """Outliers found: gain in nats, posterior probability, share of readings.

    burst: start and end, s, if they are consecutive, so that one event is their cause.
    """

    gain: float
    probability: float
    parameter: Parameter
    burst: tuple[float, float] | None = None


def cleaned(base: Model) -> tuple[Model, Wrong | None]:
    """The baseline without outlying headings, if that raises the score, and what was left out.

    Each outlier has a uniform density. Their count has a binomial density with a uniform prior of
    the share.
    """
    effect = catalogue()["heading_outliers"]
    parts = [f for f in base.parts if set(effect.outliers) & set(f.case.kinds)]
    fits = math.isfinite(base.log_evidence)  # (a diverged fit cannot show outliers)
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
    """The model fitted to all readings of the baseline, outliers included: physics that the
    baseline lacked may account for them."""
    begin = []
    for original, f in zip(base.parts, model.parts, strict=True):
        rows = {o.kind: r for o, r, _ in original.case.observed}
        observed = tuple((o, rows[o.kind], constants) for o, _, constants in f.case.observed)
        own = original.case
        case = replace(f.case, observed=observed, constant=own.constant, edits=own.edits)
        begin.append(replace(f, case=case))
    return fitted(begin, model.effects)


def share(model: Model, masks: Sequence[BoolArray | None], gain: float) -> Wrong:
    """The share of readings that were left out of a model, with its gain."""
    effect = catalogue()["heading_outliers"]
    bad = sum(int(m.sum()) for m in masks if m is not None)
    total = sum(len(m) for m in masks if m is not None)
    mean = (bad + 1.0) / (total + 2.0)
    sigma = math.sqrt(mean * (1.0 - mean) / (total + 3.0))
    # (outliers that agree with the attitude by chance are missed)
    seen = 1.0 - min(0.9, _unseen(model))
    mean, sigma = min(1.0, mean / seen), sigma / seen
    p = effect.parameters[0]
    parameter = Parameter(effect.id, p.name, mean, sigma, p.unit, p.prior_sigma, None)
    return Wrong(gain, probability(gain), parameter)


def standing_out(base: Model) -> list[BoolArray | None] | None:
    """Masks (m,) of headings far from their neighbours, relative to the trajectory, one for each
    recording (None without outliers). None if no recording has any. Slow errors of the trajectory
    cancel."""
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
    """The recordings of a model without the masked headings, as the start of a fit."""
    return [_without(f, f, m) for f, m in zip(base.parts, masks, strict=True)]


def _unseen(model: Model) -> float:
    """Share of wrong headings, uniform on the circle, that are as close as a good one; zero for
    fields."""
    widths = [0.0]
    for f in model.parts:
        k = heading_kind(f.case)
        if k is not None and f.case.observed[k][0].dim == 1:
            widths.append(WRONG * _scale(residual(f, k)[1][:, 0]))
    return max(widths) / math.pi


def _scale(r: Array) -> float:
    """Robust standard deviation of residuals (m,), from their median absolute deviation."""
    return 1.4826 * float(np.median(np.abs(r - np.median(r))))


def _turned_back(original: Fitted, f: Fitted, span: tuple[float, float]) -> Fitted:
    """The fit with the headings of a burst restored and turned back by their mean error, as if one
    constant caused them. The cost is that of its two times and its size."""
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
    """Start and end of the outliers, s, if most are consecutive; None otherwise."""
    for f, mask in zip(base.parts, masks, strict=True):
        k = heading_kind(f.case)
        if mask is None or k is None or mask.sum() < FEWEST:
            continue
        if f.case.observed[k][0].dim != 1:
            continue  # (a passing magnet adds a field that changes, no constant turn)
        rows = f.case.observed[k][1]
        told = _told(f, rows) | mask
        t, mask = rows.t[told], mask[told]
        beside = np.r_[False, mask[:-1]] | np.r_[mask[1:], False]
        # (of random outliers, a share of twice their frequency has an outlier as a neighbour)
        if (mask & beside).sum() > mask.sum() * (2.0 * mask.mean() + 0.4):
            return float(t[mask & beside][0]), float(t[mask & beside][-1])
    return None


def heading_kind(case: Case) -> int | None:
    """Index of the kind of observation that has the heading, measured or magnetic; None without
    one."""
    kinds = [o.kind for o, _, _ in case.observed]
    return next((k for k, name in enumerate(kinds) if name in ("heading", "magnetometer")), None)


def residual(f: Fitted, k: int) -> tuple[Array, Array]:
    """Times (m,) s and residuals (m, d) of the used observations of the k-th kind."""
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
    """Mask (m,) of the original rows that are outliers about the fit's trajectory."""
    k = heading_kind(original.case)
    if k is None:
        return None
    t, r = residual(f, k)
    rows = original.case.observed[k][1]
    # (rows that were left out have no residual in the fit: compared with its attitude instead)
    observation = original.case.observed[k][0]
    if observation.dim == 1 and f.case.constant == 0.0:
        full = np.interp(rows.t, t, r[:, 0])[:, None]
    else:
        full = _off(f, rows)
    least = observation.levels[0].lower
    away = (_away(full) > WRONG * np.maximum(_scales(full), least)).any(axis=1)
    return np.asarray(away & _told(f, rows))


def _away(r: Array) -> Array:
    """Distance of residuals (m, d) from their usual value: for a heading the median of all, for a
    field, which is disturbed for seconds, the median of neighbours."""
    usual = np.median(r, axis=0) if r.shape[1] == 1 else median_filter(r, (NEIGHBOURS, 1))
    return np.asarray(np.abs(r - usual))


def _scales(r: Array) -> Array:
    """Robust standard deviation (d,) of each channel of residuals (m, d)."""
    return np.asarray(1.4826 * np.median(_away(r), axis=0))


def _off(f: Fitted, rows: Rows) -> Array:
    """Reading minus prediction from the attitude: of a heading (m, 1), rad, or of a magnetic field
    (m, 3), tesla."""
    if rows.z.shape[1] == 1:
        yaw = np.interp(rows.t, f.t, np.unwrap(_yaw(f)))
        return np.asarray(so3.wrap(rows.z[:, 0] - yaw))[:, None]
    problem, constants = f.problem, f.trajectory.constants
    C_nb = so3.between(f.t, f.trajectory.C, rows.t)
    strengths = constants_of(problem, constants, "magnetometer") + rows.z[0, 3:5]
    iron = constants_of(problem, constants, "mag_hard_iron")
    return np.asarray(rows.z[:, :3] - C_nb[:, 1:].transpose(0, 2, 1) @ strengths - iron)


def _told(f: Fitted, rows: Rows) -> BoolArray:
    """Mask (m,) of readings at attitudes with a defined heading; all readings of a field. The limit
    ``STEEP`` is narrower than that of the filter, which may use a reading in some rounds only."""
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
