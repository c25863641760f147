"""What earlier sessions tell of a device today: a Kalman filter whose steps are sessions.

Each session says what it says (its posterior without the prior that it was made with); what
persists is the product of all of them, and a bias is forgotten: it wanders between sessions, and
after long it is what a bias of any such device may be.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import combinations

import numpy as np

from handcal.device.file import Device, Name, Session, usual_of
from handcal.effects import catalogue
from handcal.estimate.start import BIASES
from handcal.types import Array, Parameter, Prior

DAY_S = 86400.0
# How long biases are remembered, s: the correlation time of a walk that stays within the
# catalogue's prior. Over days it is a random walk of prior * sqrt(2 / MEMORY_S), 0.18 deg/s and
# 11 mg in a day: what data sheets of consumer sensors allow from one switching on to the next. A
# year is six times as long, and e^-6 of the old bias is left.
MEMORY_S = 60.0 * DAY_S
# By how much two sessions differ in temperature where they do not say theirs, K; what that does to
# a bias is the prior of the temperature effects.
USUAL_KELVIN = 5.0
# The chance of an alarm, over all comparisons of a device file, where nothing has changed.
ALARM = 1e-3
# What nothing was known of, in usual sizes, where sessions are compared without any prior.
UNKNOWN = 100.0
# Information below this, in usual sizes, is rounding.
ROUNDING = 1e-6


@dataclass(frozen=True)
class Differs:
    """Two sessions that disagree about an effect (numbers from 1 in the order of their dates):
    chi-square of the difference, its degrees of freedom, the probability of as much by chance; the
    parameter that changed most: from, to (SI), and by how many sigma."""

    first: int
    second: int
    effect: str
    chi2: float
    dof: int
    chance: float
    name: str
    before: float
    after: float
    sigmas: float


@dataclass(frozen=True)
class State:
    """What is known at a moment: names (k,), mean (k,) and covariance (k, k) in SI."""

    names: tuple[Name, ...]
    mean: Array
    covariance: Array

    @property
    def sigma(self) -> Array:
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def names_of(sessions: Sequence[Session]) -> tuple[Name, ...]:
    """Every parameter that some session tells, biases first, then in the catalogue's order."""
    have = {n for s in sessions for n in s.names}
    ordered = [(e.id, p.name) for e in catalogue().values() for p in e.parameters]
    return (*(b for b in BIASES if b in have),
            *(n for n in ordered if n in have and n not in BIASES))  # fmt: skip


def alone(session: Session, names: Sequence[Name]) -> tuple[Array, Array]:
    """Information (k, k) and information times mean (k,) of a session without its prior, in units
    of the catalogue's priors; zero for what it does not tell."""
    usual = usual_of(session.names)
    units = np.outer(usual, usual)
    at = [names.index(n) for n in session.names]
    L, h = np.zeros((len(names), len(names))), np.zeros(len(names))
    if session.likelihood is not None:
        information, vector = session.likelihood
        L[np.ix_(at, at)], h[at] = information * units, vector * usual
        return L, h
    after, before = (_inverse(C / units) for C in (session.covariance, session.prior_covariance))
    d, V = np.linalg.eigh(after - before)
    some = V[:, d > ROUNDING]
    told = after @ (session.mean / usual) - before @ (session.prior_mean / usual)
    L[np.ix_(at, at)] = (some * d[d > ROUNDING]) @ some.T
    h[at] = some @ (some.T @ told)
    return L, h


def _inverse(C: Array) -> Array:
    """Of a covariance (k, k) its information, and the other way round; no direction is known
    better than rounding lets it be."""
    size = np.sqrt(np.diag(C))
    d, V = np.linalg.eigh(C / np.outer(size, size))
    half = V / np.sqrt(np.maximum(d, 1e-14)) / size[:, None]
    return np.asarray(half @ half.T)


def remembered(names: Sequence[Name], seconds: float, kelvin: float | None) -> Array:
    """The part (k,) of each parameter that is left after so long and at another temperature: 1 for
    what persists."""
    out = np.ones(len(names))
    apart = USUAL_KELVIN if kelvin is None else abs(kelvin)
    for i, (effect, _) in enumerate(names):
        if (effect, names[i][1]) in BIASES:
            sensor = effect.partition("_")[0]
            per_kelvin = catalogue()[f"{sensor}_temperature"].parameters[0].prior_sigma
            moved = apart * per_kelvin / catalogue()[effect].parameters[0].prior_sigma
            warm = math.sqrt(max(0.0, 1.0 - moved**2))
            out[i] = warm * math.exp(-abs(seconds) / MEMORY_S)
    return out


def _later(m: Array, P: Array, part: Array) -> tuple[Array, Array]:
    """Mean and covariance, in units of the usual sizes, of which only a part is remembered."""
    P = P * np.outer(part, part)
    return m * part, P + np.diag(1.0 - part**2)


def courses(device: Device, when: datetime, temperature: float | None = None) -> list[State]:
    """What was known after each session, and last what is known at ``when`` (UTC), degC."""
    names = names_of(device.sessions)
    usual = usual_of(names)
    m, P = np.zeros(len(names)), np.eye(len(names))
    out = []
    for k, s in enumerate(device.sessions):
        if k:
            m, P = _later(m, P, _between(names, device.sessions[k - 1], s.recorded, s.temperature))
        L, h = alone(s, names)
        after = np.linalg.solve(np.eye(len(names)) + P @ L, P)
        P = np.asarray(0.5 * (after + after.T))
        m = m + P @ (h - L @ m)
        out.append(State(names, m * usual, P * np.outer(usual, usual)))
    if device.sessions:
        m, P = _later(m, P, _between(names, device.sessions[-1], when, temperature))
    out.append(State(names, m * usual, P * np.outer(usual, usual)))
    return out


def _between(
    names: Sequence[Name], old: Session, when: datetime, temperature: float | None
) -> Array:
    apart = None
    if temperature is not None and old.temperature is not None:
        apart = temperature - old.temperature
    return remembered(names, (when - old.recorded).total_seconds(), apart)


def plain(session: Session, names: Sequence[Name]) -> State:
    """A session without any prior: what it does not tell is a hundred times as uncertain as is
    usual."""
    usual = usual_of(names)
    L, h = alone(session, names)
    P = _inverse(L + np.eye(len(names)) / UNKNOWN**2)
    return State(tuple(names), (P @ h) * usual, P * np.outer(usual, usual))


def disagreements(device: Device) -> list[Differs]:
    """Pairs of sessions that tell different things of what should persist."""
    names = names_of(device.sessions)
    told = [plain(s, names) for s in device.sessions]
    found = []
    for i, j in combinations(range(len(told)), 2):
        both = set(device.sessions[i].names) & set(device.sessions[j].names)
        for effect in dict.fromkeys(e for e, n in names if (e, n) in both):
            at = [k for k, n in enumerate(names) if n[0] == effect and n in both]
            if names[at[0]] not in BIASES:
                found.append(_differs(i, j, told[i], told[j], at))
    return [d for d in found if d.chance * len(found) < ALARM]


def _differs(i: int, j: int, a: State, b: State, at: Sequence[int]) -> Differs:
    C = (a.covariance + b.covariance)[np.ix_(at, at)]
    d = (b.mean - a.mean)[list(at)]
    chi2 = float(d @ np.linalg.solve(C, d))
    away = np.abs(d) / np.sqrt(np.diag(C))
    k = int(np.argmax(away))
    effect, name = a.names[at[k]]
    return Differs(
        i + 1, j + 1, effect, chi2, len(at), chance_of(chi2, len(at)), name,
        float(a.mean[at[k]]), float(b.mean[at[k]]), float(away[k]),
    )  # fmt: skip


def chance_of(chi2: float, dof: int) -> float:
    """Probability of so large a chi-square or a larger one."""
    from scipy.special import gammaincc

    return float(gammaincc(dof / 2.0, max(chi2, 0.0) / 2.0))


def prior(device: Device, when: datetime, temperature: float | None, path: str) -> Prior:
    """What the device file says before a recording at ``when`` (UTC), degC.

    An effect about which sessions disagree is as uncertain as they are apart: its sigmas are
    multiplied by as many sigma as its parameter that changed most did (of two sessions that know
    it equally well, that is half of the change).
    """
    now = courses(device, when, temperature)[-1]
    wider = np.ones(len(now.names))
    for d in disagreements(device):
        mine = np.array([n[0] == d.effect for n in now.names])
        wider = np.where(mine, np.maximum(wider, d.sigmas), wider)
    source = {"path": path, "name": device.name, "sha256": device.sha256}
    return Prior(now.names, now.mean, now.covariance * np.outer(wider, wider), source)


def surprises(
    before: Prior, parameters: Sequence[Parameter], covariance: Array
) -> list[tuple[str, float, int]]:
    """Effects of which a recording says something else than was known: id, chi-square of the
    difference between what is known after and before, degrees of freedom.

    (After a Gaussian update that difference has the covariance before less the one after.)
    """
    at = {(p.effect, p.name): k for k, p in enumerate(parameters)}
    found = []
    for effect in dict.fromkeys(e for e, _ in before.names):
        rows = [i for i, n in enumerate(before.names) if n[0] == effect and n in at]
        if not rows:
            continue
        mine = [at[before.names[i]] for i in rows]
        sigma = np.sqrt(np.diag(before.covariance)[rows])
        change = np.array([parameters[k].value for k in mine]) - before.mean[rows]
        less = before.covariance[np.ix_(rows, rows)] - covariance[np.ix_(mine, mine)]
        values, V = np.linalg.eigh(less / np.outer(sigma, sigma))
        told = values > 1e-3
        dof = int(told.sum())
        if dof:
            z = (V.T @ (change / sigma))[told]
            found.append((effect, float((z**2 / values[told]).sum()), dof))
    return [(e, c, n) for e, c, n in found if chance_of(c, n) * len(found) < ALARM]
