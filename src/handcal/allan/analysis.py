"""Noise of a recording at rest: the stretch that is used, its Allan deviation, the noise terms of
each channel, levels for the filter, and what is to be doubted."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from handcal.allan import overlapping
from handcal.allan.terms import LAWS, TERMS, Fit
from handcal.recordings.segment import rests
from handcal.types import (
    Array,
    BoolArray,
    HandcalError,
    Imu,
    InputError,
    NoiseLevel,
    Recording,
)

CHANNELS = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")
UNITS = {
    "gyro": {"Q": "rad", "N": "rad/s/sqrt(Hz)", "B": "rad/s", "K": "(rad/s)/sqrt(s)",
             "R": "rad/s^2"},
    "accel": {"Q": "m/s", "N": "m/s^2/sqrt(Hz)", "B": "m/s^2", "K": "(m/s^2)/sqrt(s)",
              "R": "m/s^3"},
}  # fmt: skip
MIN_REST_S = 60.0
LONGEST = 4  # averaging times up to this part of the record
WITHIN = 0.95  # of the bands, and of the bounds on what was not seen
FOLLOWS = 0.05  # of deviation: a fit may miss by so much, or by four sigma
START_S = 2.0  # nor is the fit begun later, for the sake of a filter in the device
TILT = math.radians(0.2)
GAP = 1.5  # of the usual interval
WHOLE = 0.75  # as much of it an interval has that is no late sample's
MOST_LOST, MOST_IN_A_ROW = 0.1, 3


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
    """The noise of six channels, or of one sensor's three, in one stretch of a recording, start and
    end in s.

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
    """Noise of the channels within span (start, end; s), else in the longest rest. Of
    lost samples up to three in a row are interpolated.

    Errors: HandcalError where nothing is long enough, InputError for a span outside.
    """
    imu, put_back = _with_lost(recording.imu)
    first, last, warnings = _stretch(replace(recording, imu=imu), span)
    t = imu.t[first:last]
    rate = (t.size - 1) / float(t[-1] - t[0])
    values = np.column_stack([imu.gyro, imu.accel])[first:last]
    factors, freedom = averaging(t.size)
    channels = []
    for name, x in zip(CHANNELS, values.T, strict=True):
        if name[:-2] not in recording.sensors:
            continue
        if not np.ptp(x) > 0:
            raise HandcalError(f"{name} reads the same number throughout: it has no noise to see.")
        channels.append(_channel(name, x, rate, factors, freedom))
    lost = int(put_back[first:last].sum())
    if lost:
        warnings.append(
            f"{lost} lost samples of {t.size} were interpolated: white noise may be off by "
            f"{75 * lost / t.size:.2g} % for it."
        )
    warnings += _doubts(channels, t, values)
    return Allan(recording, (float(t[0]), float(t[-1])), rate, tuple(channels),
                 _suggested(channels), tuple(warnings))  # fmt: skip


def _with_lost(imu: Imu) -> tuple[Imu, BoolArray]:
    """Readings with the few samples that were lost between two others, on the line between these,
    and which (n,) they are. None is put back where more than a tenth is missing."""
    step = np.diff(imu.t) / float(np.median(np.diff(imu.t)))
    beside = np.r_[1.0, step, 1.0]
    whole = (beside[:-2] > WHOLE) & (beside[2:] > WHOLE)  # (a late sample has a short one beside)
    lost = np.where((step > GAP) & whole, np.rint(step) - 1.0, 0.0).astype(int)
    lost[lost > MOST_IN_A_ROW] = 0
    if lost.sum() > MOST_LOST * len(imu.t):
        lost[:] = 0
    n = np.arange(len(imu.t)) + np.r_[0, np.cumsum(lost)]
    every = np.arange(n[-1] + 1)
    put_back = np.ones(len(every), dtype=np.bool_)
    put_back[n] = False
    line = np.column_stack([imu.t, imu.gyro, imu.accel])
    full = np.column_stack([np.interp(every, n, column) for column in line.T])
    full[n] = line
    valid = np.interp(every, n, imu.valid) == 1.0
    return Imu(full[:, 0], full[:, 1:4], full[:, 4:], valid), put_back


def _stretch(recording: Recording, span: tuple[float, float] | None) -> tuple[int, int, list[str]]:
    """The samples to analyse, half-open, and what there is to say about the choice."""
    t, warnings = recording.imu.t, []
    if span is None:
        start, end = _longest_rest(recording)
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


def _longest_rest(recording: Recording) -> tuple[float, float]:
    """Its start and end, s. Errors: HandcalError where it is too short."""
    found = rests(recording)
    longest = max(found, key=lambda r: float(r[1] - r[0]), default=np.zeros(2))
    length = float(longest[1] - longest[0])
    if length < MIN_REST_S:
        raise HandcalError(
            f"The longest rest lasts {length:.0f} s and noise analysis needs {MIN_REST_S:.0f} "
            "at least, better hours: leave the device lying still, or choose a stretch with "
            "--span FROM,TO."
        )
    return float(longest[0]), float(longest[1])


def averaging(n: int) -> tuple[Array, Array]:
    """Averaging factors (m,), octaves and one between each, and degrees of freedom (3, m).

    n: samples. The rows are for white noise, flicker and random walk of the rate.
    """
    octaves = 2 ** np.arange(int(math.log2(n // LONGEST)) + 1)
    between = 3 * octaves // 2
    factors = np.unique(np.r_[octaves, between[(between > 1) & (between <= n // LONGEST)]])
    freedom = [[overlapping.freedom(noise, m, n) for m in factors.tolist()]
               for noise in overlapping.NOISES]  # fmt: skip
    return factors.astype(float), np.array(freedom)


def _channel(name: str, x: Array, rate: float, factors: Array, freedom: Array) -> Channel:
    dev, tau = overlapping.deviation(x, rate, factors), factors / rate
    octaves = np.flatnonzero(np.isin(factors, 2.0 ** np.arange(64)))

    def begun(first: int) -> tuple[float, Fit, list[int]]:
        use = octaves[first:]
        fit = Fit(tau[use], dev[use] ** 2, freedom[:, use])
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
    whole = Fit(tau, dev**2, freedom)
    edf = whole.edf(value)
    low, high = overlapping.band(dev, edf, WITHIN)
    fitted = np.sqrt(whole.variance(value))
    return Channel(name, tau, dev, low, high, edf, fitted, tuple(seen), tuple(unseen),
                   float(fit.tau[0]), miss)  # fmt: skip


def _excess(dev: Array, fitted: Array, edf: Array) -> float:
    """How far the worst deviation is off the fit beyond what is allowed to chance."""
    off = np.abs(np.log(dev / fitted))
    bad = off > np.maximum(FOLLOWS, 4.0 * np.sqrt(0.5 / edf))
    return float(np.expm1(off[bad].max())) if bad.any() else 0.0


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
    up = force / np.maximum(np.linalg.norm(force, axis=1, keepdims=True), 1e-9)
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
