"""The noise terms that an Allan variance is made up of, by maximum likelihood."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from handcal.types import Array

TERMS = ("Q", "N", "B", "K", "R")
# (factor, power of tau) of the square of each coefficient
LAWS = {"Q": (3.0, -2), "N": (1.0, -1), "B": (2 * math.log(2) / math.pi, 0), "K": (1 / 3, 1),
        "R": (0.5, 2)}  # fmt: skip
MATTERS = 9.0  # twice the log likelihood that a term has to gain: three sigma
BOUND = 2.706  # the same for a bound from one side at 95 %


def haar(m: int) -> Array:
    """Haar's wavelet (2 m,), whose mean square over samples is the Allan variance of m of them, but
    for a factor."""
    return np.repeat([1.0, -1.0], m)


def _likeness(n: int, red: bool) -> Array:
    """Correlation (n, n) of the variances of n octaves: of white noise, or of its sum."""
    size = 4
    rows = np.empty(min(n, 8))  # further apart it is 0, or taken for that
    for d in range(rows.size):
        a, b = haar(size), haar(size * 2**d)
        if red:
            a, b = np.cumsum(a), np.cumsum(b)
        power = [
            float((np.correlate(p, q, "full") ** 2).sum()) for p, q in ((a, b), (a, a), (b, b))
        ]
        rows[d] = power[0] / math.sqrt(power[1] * power[2])
    apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    return np.where(apart < rows.size, rows[np.minimum(apart, rows.size - 1)], 0.0)


class Fit:
    """Terms of the Allan variance (m,) at tau (m,) by maximum likelihood."""

    def __init__(self, tau: Array, variance: Array, freedom: Array) -> None:
        self.tau, self.observed, self.freedom = tau, variance, freedom
        self.curves = np.column_stack([tau ** LAWS[n][1] for n in TERMS])
        self.likeness = [_likeness(tau.size, red) for red in (False, True)]

    def variance(self, value: Array) -> Array:
        """What the terms add up to, (m,)."""
        out: Array = np.maximum(self.curves @ value, 1e-12 * self.observed)
        return out

    def edf(self, value: Array) -> Array:
        """Degrees of freedom (m,), of each term according to its share."""
        q, n, b, k, r = (self.curves * value).T
        share = np.stack([q + n, b, k + r])
        total = share.sum(axis=0)
        share = np.where(total > 0, share / np.where(total > 0, total, 1.0), [[1.0], [0.0], [0.0]])
        out: Array = 1.0 / (share / self.freedom).sum(axis=0)
        return out

    def solve(self, terms: Sequence[int], held: tuple[int, float] | None = None) -> Array:
        """Values (5,), 0 for other terms; ``held``: one more term, at a given value."""
        from scipy.optimize import nnls

        value = np.zeros(len(TERMS))
        fixed = np.zeros(self.tau.size)
        if held:
            value[held[0]] = held[1]
            fixed = self.curves[:, held[0]] * held[1]
        columns = list(terms)
        model, edf = self.observed + fixed, self.freedom[0]
        for step in range(60):
            weight = np.sqrt(edf / 2) / model
            a = self.curves[:, columns] * weight[:, None]
            size = np.linalg.norm(a, axis=0)
            x, _ = nnls(a / size, (self.observed - fixed) * weight)
            value[columns] = x / size
            new = self.variance(value)
            near = float(np.abs(np.log(new / model)).max())
            # from the second half on halfway, where two solutions take turns
            model = new if step < 30 else np.sqrt(new * model)
            edf = self.edf(value)
            if near < 1e-10:
                break
        return value

    def deviance(self, value: Array) -> float:
        """Twice the log likelihood that is missing to a perfect fit, were octaves independent."""
        ratio = self.observed / self.variance(value)
        return float((self.edf(value) * (ratio - 1 - np.log(ratio))).sum())

    def _covariances(self, value: Array, terms: Sequence[int]) -> tuple[Array, Array]:
        """Of the terms: as if octaves were independent, and with their correlation."""
        model, edf = self.variance(value), self.edf(value)
        part = self.curves * value / model[:, None]
        red = np.clip(part[:, 3:].sum(axis=1) + 0.5 * part[:, 2], 0.0, 1.0)
        one, two = np.sqrt(1 - red), np.sqrt(red)
        like = self.likeness[0] * np.outer(one, one) + self.likeness[1] * np.outer(two, two)
        slope = self.curves[:, list(terms)] / model[:, None] * np.sqrt(edf / 2)[:, None]
        size = np.linalg.norm(slope, axis=0)
        slope = slope / size
        inverse: Array = np.linalg.pinv(slope.T @ slope)
        scale = np.outer(size, size)
        true: Array = inverse @ slope.T @ like @ slope @ inverse
        return inverse / scale, true / scale

    def sigma(self, value: Array, terms: Sequence[int]) -> Array:
        """Standard deviation of each term's value; wider where the fit misses."""
        inside = [k for k in terms if value[k] > 0]
        plain = self._covariances(value, inside)[1].diagonal()
        scatter = self.deviance(value) / max(self.tau.size - len(inside), 1)
        out = np.zeros(len(terms))
        out[[k in inside for k in terms]] = np.sqrt(plain * max(1.0, scatter))
        return out

    def _correlated(self, value: Array, k: int, terms: Sequence[int]) -> float:
        """By how much correlation widens the variance of term k: its gain counts less."""
        inside = sorted({k, *(j for j in terms if value[j] > 0)})
        plain, true = self._covariances(value, inside)
        at = inside.index(k)
        return max(1.0, float(true[at, at] / plain[at, at]))

    def gain(self, k: int, others: Sequence[int]) -> float:
        """What term k adds in twice the log likelihood to others."""
        value = self.solve([*others, k])
        if value[k] == 0:
            return 0.0
        gained = self.deviance(self.solve(others)) - self.deviance(value)
        return gained / self._correlated(value, k, others)

    def select(self) -> list[int]:
        """The terms whose curves matter; white noise is always asked.

        A ramp comes last: over few independent averages a random walk looks like one.
        """
        white, ramp = TERMS.index("N"), TERMS.index("R")
        chosen = [white]
        for batch in ([k for k in range(len(TERMS)) if k not in (white, ramp)], [ramp]):
            rest = [k for k in batch if self.gain(k, chosen) > 0]
            while rest:
                misfit = [self.deviance(self.solve([*chosen, k])) for k in rest]
                best = rest.pop(int(np.argmin(misfit)))
                if self.gain(best, chosen) >= MATTERS:
                    chosen.append(best)
        for k in [k for k in chosen if k != white]:
            others = [j for j in chosen if j != k]
            if self.gain(k, others) < MATTERS:
                chosen = others
        return sorted(chosen)

    def bound(self, k: int, terms: Sequence[int]) -> float:
        """Largest value of term k that the record does not contradict (95 %)."""
        others = [j for j in terms if j != k]
        free = self.solve([*others, k])
        least = self.deviance(free)
        probe = free.copy()
        probe[k] = max(probe[k], float((self.observed / self.curves[:, k]).min()) * 0.1)
        allowed = BOUND * self._correlated(probe, k, others)
        low = free[k]
        high = max(low, float((self.observed / self.curves[:, k]).min()))
        while self.deviance(self.solve(others, (k, high))) - least < allowed:
            low, high = high, 2 * high
        for _ in range(12):
            middle = 0.5 * (low + high)
            inside = self.deviance(self.solve(others, (k, middle))) - least < allowed
            low, high = (middle, high) if inside else (low, middle)
        return float(high)
