"""Explanations made up without any filter, one for each verdict, to look at and to test."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from fake_result import BASELINE, GRAVITY, HIDDEN, _imu, _parameters

from handcal.explanation import (
    Evidence,
    Explained,
    Explanation,
    Fit,
    Hand,
    HeldOut,
    Hypothesis,
    Mismatch,
    Missing,
    NextMotion,
    Trace,
    Unnamed,
)
from handcal.types import Array, NoiseLevel, Parameter, Recording

SIGMA = {"gyro": 0.006, "accel": 0.05, "heading": 0.05, "position": 0.006}
UNITS = {"gyro": "rad/s", "accel": "m/s^2", "heading": "rad", "position": "m"}
CHANNELS = (
    *(f"{sensor}_{axis}" for sensor in ("gyro", "accel", "position") for axis in "xyz"), "heading",
)  # fmt: skip
BINS_S = 2.0

# effect, title, nats promised by the usual size
TRIED = (
    ("gyro_scale", "Gyro scale error", 1850.0), ("lever_arm", "Lever arm", 620.0),
    ("gyro_misalignment", "Gyro misalignment", 940.0), ("gravity", "Gravity", 310.0),
    ("accel_scale", "Accelerometer scale error", 290.0),
    ("accel_misalignment", "Accelerometer misalignment", 270.0),
    ("size_effect", "Size effect", 41.0), ("accel_delay", "Accelerometer delay", 130.0),
    ("gyro_g_sensitivity", "Gyro g-sensitivity", 66.0),
    ("gyro_quadratic", "Gyro quadratic error", 48.0), ("heading_delay", "Compass delay", 210.0),
    ("gyro_cross_products", "Gyro cross products", 75.0),
    ("accel_asymmetry", "Accelerometer asymmetry", 120.0),
    ("gyro_bandwidth", "Gyro bandwidth", 35.0),
    ("heading_soft_iron", "Heading soft iron", 160.0), ("gyro_bias_walk", "Gyro bias walk", 22.0),
    ("clock_rate", "Clock rate", 0.4), ("earth_rate", "Earth rate", 0.9),
    ("gyro_temperature", "Gyro temperature slope", 0.1),
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """What is behind one verdict: nats gained alone and in the end, and the physics shown."""

    verdict: str
    alone: dict[str, float]
    final: dict[str, float]
    found: dict[str, str]
    error: dict[str, str]  # channel -> cause, one of _causes
    left: float = 0.0  # share of the error that the final model leaves


CASES = {
    "explained": Case(
        "explained",
        {"gyro_scale": 1012.0, "lever_arm": 431.0, "gyro_misalignment": 244.0, "size_effect": 96.0,
         "gyro_cross_products": 61.0, "heading_delay": 33.0},
        {"gyro_scale": 863.0, "lever_arm": 377.0, "gyro_misalignment": -2.1, "size_effect": -6.0,
         "heading_delay": 0.7},
        {"gyro_scale": "named", "lever_arm": "named"},
        {"gyro_x": "rate_x", "gyro_z": "rate_z", "accel_y": "swing", "position_x": "swing"},
    ),
    "nothing_missing": Case("nothing_missing", {"heading_delay": 1.3}, {}, {}, {}),
    "unexplained": Case(
        "unexplained",
        {"accel_misalignment": 148.0, "size_effect": 121.0, "accel_scale": 66.0,
         "gyro_g_sensitivity": 18.0},
        {"accel_misalignment": 14.0, "size_effect": 9.0},
        {}, {"accel_x": "rate_y", "position_z": "rate_y"}, 0.35,
    ),
    "cannot_tell": Case(
        "cannot_tell",
        {"gravity": 212.0, "accel_scale": 210.4, "accel_asymmetry": 203.8, "lever_arm": 88.0},
        {"gravity": 209.0, "accel_scale": 207.1, "accel_asymmetry": 201.0, "lever_arm": 1.0},
        {"gravity": "set", "accel_scale": "set", "accel_asymmetry": "set"},
        {"accel_z": "upright", "position_z": "upright"},
    ),
}  # fmt: skip


def _causes(gyro: Array, accel: Array) -> dict[str, Array]:
    return {
        "rate_x": gyro[:, 0] / 90.0, "rate_z": gyro[:, 2] / 60.0,
        "rate_y": 0.12 * gyro[:, 1] * np.abs(gyro[:, 1]),
        "swing": 0.11 * (gyro**2).sum(1), "upright": 0.008 * (np.abs(accel[:, 2]) + GRAVITY),
    }  # fmt: skip


def _smooth(a: Array, width: int = 10) -> Array:
    return a[: a.shape[0] // width * width].reshape(-1, width, *a.shape[1:]).mean(1)


def _traces(case: Case, recording: Recording, rng: np.random.Generator) -> tuple[Trace, ...]:
    imu = recording.imu
    t, gyro, accel = (_smooth(a) for a in (imu.t, imu.gyro, imu.accel))
    causes, traces = _causes(gyro, accel), []
    for channel in CHANNELS:
        sensor, axis = channel.partition("_")[0], "xyz".find(channel[-1])
        heading = 2.4 * np.sin(0.35 * t) + 0.05 * t
        clean = {"gyro": gyro[:, axis], "accel": accel[:, axis], "position": 0 * t,
                 "heading": heading}[sensor]  # fmt: skip
        sigma = SIGMA[sensor]
        error = 0 * t
        if cause := case.error.get(channel):
            error = causes[cause] * (0.05 if sensor == "position" else 1.0)
        wander = np.convolve(rng.normal(0, 1, t.size), np.ones(4) / 2, "same")
        recorded = clean + error + 0.8 * sigma * wander
        after = clean + (1 - case.left) * error
        before, recorded, after = (
            np.angle(np.exp(1j * a)) if sensor == "heading" else a for a in (clean, recorded, after)
        )
        traces.append(Trace(channel, t, recorded, before, after, sigma, UNITS[sensor]))
    return tuple(traces)


def _explained(case: Case, name: str, seconds: float, seed: int) -> Explained:
    rng = np.random.default_rng(seed)
    t = np.arange(0, seconds, 0.01)
    recording = Recording(name, _imu(t, rng), {})
    traces = _traces(case, recording, rng)
    bins = np.arange(0, seconds + 1e-9, BINS_S)
    shortfall = {}
    for trace in traces:
        miss = trace.recorded - trace.before
        miss = np.angle(np.exp(1j * miss)) if trace.unit == "rad" else miss
        z = (miss / trace.sigma) ** 2 - 0.64
        where = np.digitize(trace.t, bins) - 1
        shortfall[trace.channel] = np.array(
            [0.5 * z[where == b].sum() / 3 for b in range(bins.size - 1)]
        ) * (1.0 if trace.channel in case.error else 0.1)
    when = bins[1:]
    moving = np.clip((when - 8.0) / (seconds - 8.0), 0, 1)
    gain = {}
    for effect, total in case.alone.items():
        steps = np.cumsum(np.clip(rng.normal(1.0, 0.7, when.size), 0, None) * (moving > 0))
        gain[effect] = total * steps / steps[-1] + rng.normal(0, 0.5, when.size)
    own = _parameters(BASELINE)
    noise = (
        NoiseLevel("gyro_noise", 2.1e-4, "rad/s/sqrt(Hz)", True),
        NoiseLevel("accel_noise", 1.9e-3, "m/s^2/sqrt(Hz)", True),
        NoiseLevel("sway", 0.006, "m", True),
    )
    rests = np.array([[0.4, 7.6], [seconds - 3.5, seconds - 0.5]])
    return Explained(
        recording, "fixed-point", own, noise, traces, Evidence(when, gain), bins, shortfall, rests
    )


def _rows(effect: str, unit: str, prior: float, **values: tuple[float, float]):
    return tuple(
        Parameter(effect, n, v, s, unit, prior, None if s > prior / 2 else 40.0)
        for n, (v, s) in values.items()
    )


PARAMETERS = {
    "gyro_scale": _rows("gyro_scale", "1", 0.01, x=(0.0112, 4e-4), y=(-0.0031, 6e-4),
                        z=(0.0168, 3e-4)),
    "lever_arm": _rows("lever_arm", "m", 0.1, x=(0.031, 2.1e-3), y=(0.108, 2.4e-3),
                       z=(-0.012, 0.056)),
    "gravity": _rows("gravity", "m/s^2", 0.02, delta=(0.0241, 1.1e-3)),
}  # fmt: skip
SIZES = {
    "gyro_scale": {"gyro_x": 9.1e-3, "gyro_y": 3.2e-3, "gyro_z": 0.012},
    "lever_arm": {"accel_x": 0.11, "accel_y": 0.2, "accel_z": 0.06},
    "gravity": {"accel_x": 0.011, "accel_y": 9e-3, "accel_z": 0.021},
}
STORIES = {
    "gyro_scale": ("The gyro reports every turn a fixed fraction too large or too small.",
                   "At least one full turn about each axis, or a turn and its reverse."),
    "lever_arm": ("The sensor sits beside the point about which the device turns, and swings "
                  "around it.", "Turns about at least two axes; the faster, the sharper."),
    "gravity": ("Gravity at this place is not the one that was assumed.",
                "Rests in many poses, or the site's own latitude."),
}  # fmt: skip


def _missing(case: Case) -> tuple[Missing, ...]:
    found = [e for e in case.found if e in PARAMETERS]
    others = tuple(e for e, v in case.found.items() if v == "set" and e not in found)
    likely = {"gyro_scale": 0.9999, "lever_arm": 0.994, "gravity": 0.987}
    titles = {e: t for e, t, _ in TRIED}
    whole = sum(case.final[e] for e in found)
    return tuple(
        Missing(e, titles[e], likely[e], case.final[e], others if case.found[e] == "set" else (),
                PARAMETERS[e], *STORIES[e], SIZES[e], case.final[e] / whole, 0.3 * case.final[e])
        for e in found
    )  # fmt: skip


def _hypotheses(case: Case, rng: np.random.Generator) -> tuple[Hypothesis, ...]:
    likely = {"gravity": 0.64, "accel_scale": 0.31, "accel_asymmetry": 0.04}
    all_of = []
    for effect, title, expected in TRIED:
        alone = case.alone.get(effect, float(rng.normal(-2.5, 1.5)))
        final = case.final.get(effect, float(rng.normal(-2.5, 1.5)))
        verdict = case.found.get(effect, "")
        sure = 0.999 if verdict else 0.05 / (1 + math.exp(2 - final))
        sure = likely.get(effect, sure) if verdict else sure
        all_of.append(Hypothesis(effect, title, alone, final, expected, sure, verdict))
    return tuple(sorted(all_of, key=lambda h: -h.alone))


def _fits(case: Case, recordings: tuple[Explained, ...]) -> tuple[Fit, Fit]:
    rms: list[dict[str, float]] = [{}, {}]
    for c in CHANNELS:
        traces = [t for r in recordings for t in r.traces if t.channel == c]
        for into, name in zip(rms, ("before", "after"), strict=True):
            miss = np.concatenate([t.recorded - getattr(t, name) for t in traces])
            miss = np.angle(np.exp(1j * miss)) if c == "heading" else miss
            into[c] = float(np.sqrt((miss**2).mean()))
    gained = sum(case.final[e] for e in case.found if e in PARAMETERS)
    gained += 95.0 if case.verdict == "unexplained" else 0.0
    wrong = case.verdict != "nothing_missing"
    kinds = ("fixed_position", "zero_velocity", "heading")
    off = (
        ((2.9, 2.2, 1.12), (0.61, 0.48, 0.11)) if wrong else ((1.02, 0.97, 1.04), (0.03, 0.0, 0.05))
    )
    nis = [dict(zip(kinds, v, strict=True)) for v in (off[0], (1.04, 0.98, 1.03))]
    white = [dict(zip(kinds, v, strict=True)) for v in (off[1], (0.04, -0.02, 0.05))]
    if case.left:
        nis[1]["fixed_position"], white[1]["fixed_position"] = 1.9, 0.37
    before = Fit(18321.4, rms[0], nis[0], white[0])
    return before, Fit(18321.4 + gained, rms[1], nis[1], white[1])


def fake_explanation(verdict: str = "explained", recordings: int | None = None) -> Explanation:
    """An explanation with this verdict; ``explained`` is of two recordings unless told."""
    case = CASES[verdict]
    count = recordings or (2 if verdict == "explained" else 1)
    names = (("walk-with-phone.mcap", 84.0), ("desk-turns.mcap", 52.0))[:count]
    each = tuple(_explained(case, n, s, 7 + i) for i, (n, s) in enumerate(names))
    before, after = _fits(case, each)
    gained = after.log_evidence - before.log_evidence
    missing = _missing(case)
    own = each[0].parameters if count == 1 else ()
    known = (*own, *(p for m in missing for p in m.parameters), *_parameters(HIDDEN))
    e = Explanation(
        verdict=verdict, mismatch=(), missing=missing, unnamed=(),
        hypotheses=_hypotheses(case, np.random.default_rng(11)), before=before, after=after,
        held_out=HeldOut("later blocks", 6120.0, 6120.0 + 0.3 * gained, before.residual_rms,
                         after.residual_rms),
        next_motion=(), parameters=known, covariance=np.diag([p.sigma**2 for p in known]),
        noise=each[0].noise, recordings=each, warnings=(), hand=Hand("held", 0.993),
    )  # fmt: skip
    return replace(e, **DETAILS[verdict](e))


def _details_explained(e: Explanation):
    two = len(e.recordings) > 1
    more = (Mismatch("gyro_z", 12.0, 44.0, 0.19, "turning faster than 60 deg/s", 1),) if two else ()
    return {
        "mismatch": (
            Mismatch("accel_y", 16.0, 62.0, 0.46, "turning faster than 90 deg/s"),
            Mismatch("gyro_x", 22.0, 80.0, 0.21, "turning about x"),
            *more,
        ),
        "next_motion": (
            NextMotion("Turn about z while x points up, then about y.", ("lever_arm",), 41.0),
        ),
        "warnings": ("3 readings of the accelerometer were not finite and were left out.",),
    }


def _details_nothing(_: Explanation):
    return {
        "next_motion": (
            NextMotion("Let the device warm up by 10 K at rest.", ("gyro_temperature",), 38.0),
        ),
    }


def _details_unexplained(_: Explanation):
    return {
        "mismatch": (Mismatch("accel_x", 14.0, 58.0, 0.71, "turning about y, warm"),
                     Mismatch("position_z", 20.0, 40.0, 0.14, "turning about y")),
        "unnamed": (Unnamed("accel_x += k * omega_y * abs(omega_y)", 0.1184, 0.0041,
                            "(m/s^2)/(rad/s)^2", 95.0),
                    Unnamed("accel_x += k * omega_y * T", -3.1e-5, 4.4e-6,
                            "(m/s^2)/(rad/s)/K", 12.4)),
        "held_out": None,
        "warnings": ("Residuals of accelerometer x are still not white after every known effect.",),
    }  # fmt: skip


def _details_cannot_tell(_: Explanation):
    return {
        "mismatch": (Mismatch("accel_z", 8.0, 80.0, 0.83, "z pointing up or down"),),
        "next_motion": (
            NextMotion("Rest with x up, then with y up, ten seconds each.",
                       ("gravity", "accel_scale", "accel_asymmetry"), 64.0),
            NextMotion("Rest with z down.", ("accel_scale", "accel_asymmetry"), 22.0),
        ),
    }  # fmt: skip


DETAILS = {"explained": _details_explained, "nothing_missing": _details_nothing,
           "unexplained": _details_unexplained, "cannot_tell": _details_cannot_tell}  # fmt: skip
