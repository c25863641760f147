"""Noise of a device at rest: overlapping Allan deviation, and the noise terms that make it up.

The estimator, its equivalent degrees of freedom and its confidence bands are allantools'.
The terms are those of IEEE Std 952 (annex C) and 647: the Allan variance of a rate is

    3 Q^2 / tau^2 + N^2 / tau + (2 ln 2 / pi) B^2 + K^2 tau / 3 + R^2 tau^2 / 2

Q quantisation, N white noise (random walk of angle or velocity), B bias instability,
K random walk of the rate, R ramp. They are found by maximum likelihood: an estimate of
variance is a scaled chi-square with its degrees of freedom, scale by octave of tau.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handcal.recordings.segment import rests
from handcal.types import Array, HandcalError, InputError, NoiseLevel, Recording

CHANNELS = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
TERMS = ("Q", "N", "B", "K", "R")
UNITS = {
    "gyro": {"Q": "rad", "N": "rad/s/sqrt(Hz)", "B": "rad/s", "K": "(rad/s)/sqrt(s)",
             "R": "rad/s^2"},
    "accel": {"Q": "m/s", "N": "m/s^2/sqrt(Hz)", "B": "m/s^2", "K": "(m/s^2)/sqrt(s)",
              "R": "m/s^3"},
}  # fmt: skip
# (factor, power of tau) of the square of each coefficient
LAWS = {"Q": (3.0, -2), "N": (1.0, -1), "B": (2 * math.log(2) / math.pi, 0), "K": (1 / 3, 1),
        "R": (0.5, 2)}  # fmt: skip

MIN_REST_S = 60.0
LONGEST = 4  # averaging times up to this part of the record
WITHIN = 0.95  # of the bands, and of the bounds on what was not seen
MATTERS = 9.0  # twice the log likelihood that a term has to gain: three sigma
BOUND = 2.706  # the same for a bound from one side at 95 %
FOLLOWS = 0.05  # of deviation: a fit may miss by so much, or by four sigma
START_S = 2.0  # nor is the fit begun later, for the sake of a filter in the device
TILT = math.radians(0.2)
GAP = 1.5  # of the usual interval


@dataclass(frozen=True)
class Term:
    """A noise coefficient, its standard deviation and unit (handcal's SI)."""

    name: str
    value: float
    sigma: float
    unit: str


@dataclass(frozen=True)
class Bound:
    """A coefficient that was not seen, and what it would at most be (95 %)."""

    name: str
    at_most: float
    unit: str


@dataclass(frozen=True)
class Channel:
    """Allan deviation of one channel at m averaging times.

    tau (m,) s; deviation, low, high (m,) rad/s or m/s^2, the band holding 95 %; edf (m,)
    degrees of freedom; fitted (m,) deviation of the terms found. fit_from_s: shorter averaging
    times were left out of the fit. miss: the largest ratio of deviation to fit, less 1, that
    chance does not explain; 0 for none.
    """

    name: str
    tau: Array
    deviation: Array
    low: Array
    high: Array
    edf: Array
    fitted: Array
    terms: tuple[Term, ...]
    unseen: tuple[Bound, ...]
    fit_from_s: float
    miss: float

    @property
    def sensor(self) -> str:
        """gyro or accel."""
        return self.name[:-2]

    def term(self, name: str) -> Term | None:
        """The coefficient of that name if it was seen."""
        return next((t for t in self.terms if t.name == name), None)


@dataclass(frozen=True)
class Allan:
    """The noise of all six channels in one stretch of a recording, start and end in s.

    suggested: levels for the filter, in handcal's own names and units.
    """

    recording: Recording
    span: tuple[float, float]
    rate_hz: float
    channels: tuple[Channel, ...]
    suggested: tuple[NoiseLevel, ...]
    warnings: tuple[str, ...]

    @property
    def longest_s(self) -> float:
        """The longest averaging time."""
        return float(self.channels[0].tau[-1])


def analyse(recording: Recording, span: tuple[float, float] | None = None) -> Allan:
    """Noise of the six channels within span (start, end; s), else in the longest rest.

    Errors: HandcalError where nothing is long enough, InputError for a span outside.
    """
    first, last, warnings = _stretch(recording, span)
    imu = recording.imu
    t = imu.t[first:last]
    rate = (t.size - 1) / float(t[-1] - t[0])
    values = np.column_stack([imu.gyro, imu.accel])[first:last]
    factors, freedom = averaging(t.size)
    channels = []
    for name, x in zip(CHANNELS, values.T, strict=True):
        if not np.ptp(x) > 0:
            raise HandcalError(f"{name} reads the same number throughout: it has no noise to see.")
        channels.append(_channel(name, x, rate, factors, freedom))
    warnings += _doubts(channels, t, values)
    return Allan(recording, (float(t[0]), float(t[-1])), rate, tuple(channels),
                 _suggested(channels), tuple(warnings))  # fmt: skip


def _stretch(recording: Recording, span: tuple[float, float] | None) -> tuple[int, int, list[str]]:
    """The samples to analyse, half-open, and what there is to say about the choice."""
    t, warnings = recording.imu.t, []
    if span is None:
        found = rests(recording)
        longest = max(found, key=lambda r: float(r[1] - r[0]), default=np.zeros(2))
        length = float(longest[1] - longest[0])
        if length < MIN_REST_S:
            raise HandcalError(
                f"The longest rest lasts {length:.0f} s and noise analysis needs {MIN_REST_S:.0f} "
                "at least, better hours: leave the device lying still, or choose a stretch with "
                "--span FROM,TO."
            )
        start, end = float(longest[0]), float(longest[1])
    else:
        start, end = span
        if not (start < end and start < t[-1] and end > t[0]):
            raise InputError(
                f"--span {start:g},{end:g}: expected FROM before TO, within {t[0]:.1f} "
                f"to {t[-1]:.1f} s."
            )
    inside = (t >= start) & (t <= end) & recording.imu.valid
    step = np.diff(t, prepend=t[0])
    cut = ~inside | (step > GAP * float(np.median(step[1:])))
    # a sample after a gap begins a run; one that is not inside belongs to none
    edges = np.r_[np.flatnonzero(cut), t.size]
    begins = np.r_[0, edges[:-1] + ~inside[edges[:-1]]]
    best = int(np.argmax(edges - begins))
    first, last = int(begins[best]), int(edges[best])
    length = float(t[last - 1] - t[first]) if last > first else 0.0
    # (so many samples last a little less than what was asked for)
    if length < MIN_REST_S - 1.5 * float(np.median(step[1:])):
        raise HandcalError(
            f"Only {length:.0f} s between {start:.1f} and {end:.1f} s are without gaps or "
            f"invalid samples; noise analysis needs {MIN_REST_S:.0f} at least."
        )
    if length < 0.99 * (end - start):
        warnings.append(
            f"Gaps or invalid samples: only {t[first]:.1f} to {t[last - 1]:.1f} s were used."
        )
    return first, last, warnings


def averaging(n: int) -> tuple[Array, Array]:
    """Averaging factors (m,), octaves and one between each, and degrees of freedom (3, m).

    n: samples. The rows are for white noise, flicker and random walk of the rate.
    """
    import allantools

    octaves = 2 ** np.arange(int(math.log2(n // LONGEST)) + 1)
    between = 3 * octaves // 2
    factors = np.unique(np.r_[octaves, between[(between > 1) & (between <= n // LONGEST)]])
    freedom = [[allantools.edf_greenhall(alpha, 2, m, n + 1, overlapping=True)
                for m in factors.tolist()] for alpha in (0, -1, -2)]  # fmt: skip
    out = np.array(freedom, dtype=float)
    for k in np.flatnonzero(factors <= 32):  # there the formula is some 17 % off
        m = int(factors[k])
        r = np.correlate(_haar(m), _haar(m), "full") / (2 * m)
        out[0, k] = (n - 2 * m + 1) / float(r @ r)
    return factors.astype(float), out


def deviation(x: Array, rate_hz: float, factors: Array) -> Array:
    """Overlapping Allan deviation (m,) of readings x (n,) at averaging factors (m,)."""
    import allantools

    tau, out, _, _ = allantools.oadev(x, rate=rate_hz, data_type="freq", taus=factors / rate_hz)
    if tau.size != factors.size:
        raise HandcalError("The record is too short for these averaging times.")
    return np.asarray(out, dtype=float)


def _channel(name: str, x: Array, rate: float, factors: Array, freedom: Array) -> Channel:
    import allantools

    dev, tau = deviation(x, rate, factors), factors / rate
    octaves = np.flatnonzero(np.isin(factors, 2.0 ** np.arange(64)))

    def begun(first: int) -> tuple[float, _Fit, list[int]]:
        use = octaves[first:]
        fit = _Fit(tau[use], dev[use] ** 2, freedom[:, use])
        terms = fit.select()
        value = fit.solve(terms)
        miss = _excess(dev[use], np.sqrt(fit.variance(value)), fit.edf(value))
        return miss, fit, terms

    tried = []
    for s in range(max(1, int((tau[octaves] <= min(START_S, tau[-1] / 100)).sum()))):
        tried.append(begun(s))
        if tried[-1][0] == 0.0:
            break
    least = min(found[0] for found in tried)
    # a later start has to help, by half at least
    start = next(s for s, found in enumerate(tried) if found[0] <= 2 * least)
    miss, fit, terms = tried[start]
    if start and miss == 0.0:
        # what a filter takes falls with tau, and is too little to be noticed before it is nothing
        miss, fit, terms = begun(min(start + 2, octaves.size - len(TERMS)))
    value = fit.solve(terms)
    units = UNITS[name[:-2]]
    seen = []
    for k, sigma in zip(terms, fit.sigma(value, terms), strict=True):
        c = math.sqrt(value[k] / LAWS[TERMS[k]][0])
        if c > 0:
            seen.append(Term(TERMS[k], c, c * sigma / (2 * value[k]), units[TERMS[k]]))
    unseen = [Bound(TERMS[k], math.sqrt(fit.bound(k, terms) / LAWS[TERMS[k]][0]), units[TERMS[k]])
              for k in range(len(TERMS)) if value[k] == 0]  # fmt: skip
    whole = _Fit(tau, dev**2, freedom)
    edf = whole.edf(value)
    band = [allantools.confidence_interval(d, e, ci=WITHIN) for d, e in zip(dev, edf, strict=True)]
    low, high = np.array(band, dtype=float).T
    fitted = np.sqrt(whole.variance(value))
    return Channel(name, tau, dev, low, high, edf, fitted, tuple(seen), tuple(unseen),
                   float(fit.tau[0]), miss)  # fmt: skip


def _excess(dev: Array, fitted: Array, edf: Array) -> float:
    """How far the worst deviation is off the fit beyond what is allowed to chance."""
    off = np.abs(np.log(dev / fitted))
    bad = off > np.maximum(FOLLOWS, 4.0 * np.sqrt(0.5 / edf))
    return float(np.expm1(off[bad].max())) if bad.any() else 0.0


def _haar(m: int) -> Array:
    return np.repeat([1.0, -1.0], m)


def _likeness(n: int, red: bool) -> Array:
    """Correlation (n, n) of the variances of n octaves: of white noise, or of its sum."""
    size = 4
    rows = np.empty(min(n, 8))  # further apart it is 0, or taken for that
    for d in range(rows.size):
        a, b = _haar(size), _haar(size * 2**d)
        if red:
            a, b = np.cumsum(a), np.cumsum(b)
        power = [
            float((np.correlate(p, q, "full") ** 2).sum()) for p, q in ((a, b), (a, a), (b, b))
        ]
        rows[d] = power[0] / math.sqrt(power[1] * power[2])
    apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    return np.where(apart < rows.size, rows[np.minimum(apart, rows.size - 1)], 0.0)


class _Fit:
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


def _suggested(channels: Sequence[Channel]) -> tuple[NoiseLevel, ...]:
    """One level for the three axes of a sensor, as the filter has it: their root mean square."""
    out = []
    for name, sensor, term in (
        ("gyro_noise", "gyro", "N"), ("accel_noise", "accel", "N"),
        ("gyro_bias_walk", "gyro", "K"), ("accel_bias_walk", "accel", "K"),
    ):  # fmt: skip
        seen = [found.value for c in channels
                if c.sensor == sensor and (found := c.term(term))]  # fmt: skip
        if seen:
            value = math.sqrt(sum(v * v for v in seen) / len(seen))
            out.append(NoiseLevel(name, value, UNITS[sensor][term], True))
    return tuple(out)


def _doubts(channels: Sequence[Channel], t: Array, values: Array) -> list[str]:
    """What in the stretch is not the sensor's noise, in sentences."""
    out = []
    blocks = min(20, max(2, int((t[-1] - t[0]) // 10)))
    force = np.array([part.mean(axis=0) for part in np.array_split(values[:, 3:], blocks)])
    up = force / np.linalg.norm(force, axis=1, keepdims=True)
    tilt = 2 * math.asin(min(1.0, 0.5 * float(
        np.linalg.norm(up[:, None] - up[None], axis=2).max())))  # fmt: skip
    if tilt > TILT:
        out.append(
            f"Slow motion: the direction of gravity moved by {math.degrees(tilt):.1f} deg, so the "
            "long averaging times (B, K, R) show the device's motion, or a strong drift, and not "
            "the noise alone. Choose a stiller stretch with --span FROM,TO."
        )
    late = [c for c in channels if c.fit_from_s > 1.5 * c.tau[0] and c.miss == 0]
    if late:
        names = ", ".join(c.name for c in late)
        out.append(
            f"{names}: averaging times below {max(c.fit_from_s for c in late):.2g} s do not follow "
            "white noise (a low-pass filter in the device, or vibration) and were left out of "
            "the fit."
        )
    for c in channels:
        if c.miss:
            out.append(
                f"{c.name}: no sum of the five noise terms follows the curve, it is off by up to "
                f"{100 * c.miss:.0f} %; vibration or motion does that. Take the numbers for rough."
            )
    return out
