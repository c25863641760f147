"""Does the health check say what is wrong with a recording?

    python benchmarks/health_campaign.py [--seeds N] [--only KIND,...] [--json OUT]

Simulated recordings, in motions that show a fault and in motions that do not, are spoilt in one
way: a full scale, a sample rate, a unit, one of the 48 axis maps of gyro, accelerometer or
magnetometer, stamps in bursts, a gap. Each ends as

    said         what is said is right (axes: the option that is named mends them, applied here)
    cannot tell  nothing is said, and `info` says that the motion does not show it
    right        nothing is refused, and the calibration is right: every scale and bias within three
                 sigma of the truth, or within one of what the clean recording gives where that is
                 further off; none of them more than twice as uncertain as without the fault
    no matter    the sensors agree in these axes as well (all three axes of an accelerometer or of
                 a magnetometer reversed: what is up, and the hemisphere, is what they say)
    WRONG        anything else

A clean recording is right where nothing is said.
"""

from __future__ import annotations

import argparse
import json
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

import handcal
from handcal.recordings.inputs import of_arrays
from handcal.recordings.inputs._turning import SIGNED, named
from handcal.recordings.overview import overview
from handcal.show.info import unit_sentences
from handcal.types import Array, HandcalError, Recording
from handcal_sim import simulate
from handcal_sim.motion_ordinary import six_sides, two_axes, yaw_on_a_table
from handcal_sim.motion_phone import swings
from handcal_sim.phone import Phone, consumer_magnetometer, consumer_phone

MOTIONS = {
    "free hand": "free-hand", "six sides": six_sides, "two axes": two_axes,
    "swung about a joint": swings(1.0, 0.6), "yaw on a table": yaw_on_a_table, "still": "static",
}  # fmt: skip
SECONDS = 60.0
SCALES = (0.25, 0.5, 0.8, 1.25, 1.5, 2.0, 3.0, 4.0)
RATES = (0.25, 0.5, 2.0, 4.0)
BURSTS = (2, 3, 5, 10, 20, 50)
GAPS = (1.0, 10.0, 100.0, 1000.0)
KINDS = ("clean", "gyro scale", "accel scale", "sample rate", "unit", "gyro axes", "accel axes",
         "mag axes", "bursts", "gap")  # fmt: skip
ENDS = ("said", "cannot tell", "right", "no matter", "WRONG")
CANNOT = "does not tell"
G = 9.80665
Found = dict[tuple[str, str], tuple[float, float]]  # value and sigma


@dataclass(frozen=True)
class Raw:
    """Arrays as a file would have them: t (n,), gyro, accel (n, 3); mag at tm (m,), (m, 3)."""

    t: Array
    gyro: Array
    accel: Array
    tm: Array
    mag: Array

    def read(self) -> Recording:
        streams = {"mag": ((self.tm, self.mag), 3)}
        return of_arrays("campaign", self.t, self.gyro, self.accel, streams)


def device(rng: np.random.Generator) -> Phone:
    return replace(consumer_phone(rng), heading=None, mag=consumer_magnetometer(rng))


def world(motion: str, seed: int) -> tuple[Raw, dict[tuple[str, str], float]]:
    rng = np.random.default_rng(1000 + seed)
    effects = {
        "gyro_scale": rng.normal(0, 0.01, 3), "accel_scale": rng.normal(0, 0.01, 3),
        "mag_hard_iron": rng.normal(0, 2e-5, 3),
    }  # fmt: skip
    w = simulate(MOTIONS[motion], seed=seed, duration_s=SECONDS, phone=device, effects=effects)
    v, mag = w.imu.values, w.streams["mag"]
    truth = {(e, p["name"]): p["value"] for e, ps in w.parameters["effects"].items() for p in ps
             if e in ("gyro_bias", "accel_bias", "gyro_scale", "accel_scale")}  # fmt: skip
    return Raw(w.imu.stamps, v[:, :3], v[:, 3:6], mag.stamps, mag.values), truth


def faults(raw: Raw, seed: int) -> Iterator[tuple[str, str, Raw, Callable[[str], bool]]]:
    """Kind, which, the spoilt readings, and whether a text is right about them."""
    yield "clean", "", raw, lambda _: False
    for f in SCALES:
        yield "gyro scale", f"{f:g}", replace(raw, gyro=f * raw.gyro), _times(1 / f)
    for f in (0.25, 0.5, 2.0, 4.0):
        told = _factor(re.compile(r"reads ([\d.]+) g at rest"), f)
        yield "accel scale", f"{f:g}", replace(raw, accel=f * raw.accel), told
    for f in RATES:
        yield "sample rate", f"{f:g}", replace(raw, t=f * raw.t, tm=f * raw.tm), _times(1 / f)
    for name, f in (("deg/s", 180 / np.pi), ("mdeg/s", 180e3 / np.pi), ("rad/s", np.pi / 180)):
        told = _has(re.compile(rf"gyro={re.escape(name)}\b"))
        yield "unit", f"gyro {name}", replace(raw, gyro=f * raw.gyro), told
    for name, f in (("g", 1 / G), ("mg", 1000 / G)):
        told = _has(re.compile(f"accel={name}[. ]"))
        yield "unit", f"accel {name}", replace(raw, accel=f * raw.accel), told
    for name, f in (("ms", 1e3), ("us", 1e6)):
        told = _has(re.compile(f"time={name}"))
        yield "unit", f"time {name}", replace(raw, t=f * raw.t, tm=f * raw.tm), told
    step = float(np.median(np.diff(raw.t)))
    index = replace(raw, t=np.arange(len(raw.t)) * 1.0, tm=raw.tm / step)
    yield "unit", "time counts", index, _has(re.compile("--rate"))
    for A in SIGNED[1:]:
        word = ",".join(named(A))
        for kind in ("gyro", "accel", "mag"):
            spoilt = replace(raw, **{kind: getattr(raw, kind) @ A.T})
            yield f"{kind} axes", word, spoilt, _mends(spoilt, kind, A)
    rng = np.random.default_rng(seed)
    for m in BURSTS:
        stamps = _arriving(raw.t, m, rng)
        yield "bursts", str(m), replace(raw, t=stamps), _has(re.compile("arrival"))
    for seconds in GAPS:
        for where in ("at rest", "turning"):
            yield "gap", f"{seconds:g} s {where}", _gapped(raw, seconds, where), lambda _: False


def _has(told: re.Pattern[str]) -> Callable[[str], bool]:
    return lambda text: bool(told.search(text))


def _times(factor: float) -> Callable[[str], bool]:
    return _factor(re.compile(r"turns ([\d.]+) times as far as the gyro"), factor)


def _factor(told: re.Pattern[str], factor: float) -> Callable[[str], bool]:
    """Whether the factor that is said is this one to a tenth."""

    def right(text: str) -> bool:
        found = told.search(text)
        return found is not None and abs(float(found[1]) / factor - 1.0) < 0.1

    return right


def _mends(raw: Raw, kind: str, A: Array) -> Callable[[str], bool]:
    """Whether the option that is named gives the axes back: those of gyro and accelerometer may
    both be turned together, and a field's sense is the hemisphere's."""

    def right(text: str) -> bool:
        found = re.search(r"--axes (gyro|accel|mag)=([-xyz,]+)", text)
        if found is None or (found[1] == "mag") != (kind == "mag"):
            return False
        B = next(P for P in SIGNED if ",".join(named(P)) == found[2].rstrip(",."))
        if kind == "mag":
            return bool(np.array_equal(abs(B @ A), np.eye(3))
                                          and abs(np.trace(B @ A)) == 3)  # fmt: skip
        try:
            spoilt = replace(raw, tm=raw.tm[:2], mag=raw.mag[:2])
            mended = replace(spoilt, **{found[1]: getattr(spoilt, found[1]) @ B.T}).read()
        except HandcalError:
            return False
        return not mended.unfit

    return right


def _arriving(t: Array, m: int, rng: np.random.Generator) -> Array:
    """Stamps of arrival: m at a time, when the last of them is there, 0.2 ms apart, up to 3 ms
    late; a clock that runs 50 ppm fast."""
    group = np.arange(len(t)) // m
    ready = t[np.minimum((group + 1) * m, len(t)) - 1]
    late = np.minimum(rng.exponential(1e-3, group[-1] + 1), 3e-3)[group]
    stamps = 1.00005 * ready + late + 2e-4 * (np.arange(len(t)) % m)
    return np.maximum.accumulate(stamps + 1e-9 * np.arange(len(t)))


def _gapped(raw: Raw, seconds: float, where: str) -> Raw:
    """Without a second of readings at rest, or in a turn, behind which time goes on later."""
    rate = np.convolve(np.linalg.norm(raw.gyro, axis=1), np.ones(50) / 50, mode="same")
    inside = (raw.t > 2.0) & (raw.t < raw.t[-1] - 4.0)
    pick = np.where(inside, rate, np.inf if where == "at rest" else -np.inf)
    begin = raw.t[int(np.argmin(pick) if where == "at rest" else np.argmax(pick))]
    end = begin + min(1.0, seconds)

    def cut(t: Array) -> tuple[Array, Array]:
        kept = (t < begin) | (t > end)
        return kept, np.where(t > end, t + seconds - (end - begin), t)[kept]

    (kept, t), (km, tm) = cut(raw.t), cut(raw.tm)
    return Raw(t, raw.gyro[kept], raw.accel[kept], tm, raw.mag[km])


def end_of(
    kind: str, raw: Raw, right: Callable[[str], bool], truth: dict[tuple[str, str], float],
    clean: Found, axes_matter: bool,
) -> tuple[str, str]:  # fmt: skip
    """How it ends, and what was said."""
    try:
        recording = raw.read()
        text = " ".join([recording.unfit, *recording.warnings])
    except HandcalError as error:
        return ("said" if right(str(error)) else "WRONG"), str(error)
    if kind == "clean":
        return ("WRONG" if text.strip() else "right"), text
    if kind not in ("bursts", "gap"):
        if right(text):
            return "said", text
        if not axes_matter:
            return "no matter", text
        told = unit_sentences(overview(recording))
        which = [s for s in told if ("magnetometer" in s) == (kind == "mag axes")]
        silent = "It was turned so" not in text and "as far as the gyro" not in text
        open_ = CANNOT in text or any(CANNOT in s for s in which)
        return ("cannot tell" if silent and open_ else "WRONG"), text
    if kind == "bursts" and not right(text):
        return "WRONG", text
    off = misfits(recording, truth, clean)
    return ("WRONG", f"{text} {off}") if off else ("right", text)


def calibrated(recording: Recording) -> Found:
    result = handcal.calibrate(recording)
    return {(p.effect, p.name): (p.value, p.sigma) for p in result.parameters}


def misfits(
    recording: Recording, truth: dict[tuple[str, str], float],
    clean: Found,
) -> str:  # fmt: skip
    try:
        got = calibrated(recording)
    except HandcalError as error:
        return str(error)
    out = []
    for key, true in truth.items():
        value, sigma = got[key]
        usual, least = clean[key]
        off = min(abs(value - true), 3.0 * abs(value - usual))
        if off > 3.0 * sigma or sigma > 2.0 * least:
            out.append(f"{key[0]} {key[1]}: {(value - true) / sigma:+.1f} sigma, "
                       f"{sigma / least:.1f} times the clean one's")  # fmt: skip
    return "; ".join(out)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--seeds", type=int, default=1)
    options.add_argument("--only", default=",".join(KINDS))
    options.add_argument("--motions", default=",".join(MOTIONS))
    options.add_argument("--json", default="")
    asked = options.parse_args()
    kinds, rows = asked.only.split(","), []
    for motion in asked.motions.split(","):
        for seed in range(asked.seeds):
            raw, truth = world(motion, seed)
            clean: Found = {}
            if {"bursts", "gap"} & set(kinds):
                clean = calibrated(raw.read())
            for kind, which, spoilt, right in faults(raw, seed):
                if kind not in kinds:
                    continue
                matters = which != "-x,-y,-z" or kind == "gyro axes"
                end, text = end_of(kind, spoilt, right, truth, clean, matters)
                rows.append({"motion": motion, "seed": seed, "kind": kind, "which": which,
                             "end": end, "text": text})  # fmt: skip
                if end == "WRONG":
                    print(f"WRONG: {motion}, seed {seed}, {kind} {which}: {text[:300]}", flush=True)
    if asked.json:
        with open(asked.json, "w", encoding="utf-8") as file:
            json.dump(rows, file, indent=1)
    print(f"| motion | fault | {' | '.join(ENDS)} |")
    print(f"|---|---|{'---|' * len(ENDS)}")
    for motion in asked.motions.split(","):
        for kind in kinds:
            of = Counter(r["end"] for r in rows if (r["motion"], r["kind"]) == (motion, kind))
            print(f"| {motion} | {kind} | {' | '.join(str(of[e] or '') for e in ENDS)} |")


if __name__ == "__main__":
    main()
