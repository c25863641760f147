"""Hands that do what ``handcal live`` asks for, beside hands that follow a fixed routine.

Of each simulated phone and hand: the guided hand is asked again after every motion, by what has
been recorded so far; the unguided one turns once about each axis, as the demo in README does; the
planned one does what the information matrix finds best for the whole minute, asked once, with the
noise and the hand known. The worst of biases and scale errors after the same time is compared.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from handcal_sim import profiles, simulate
from handcal_sim.motion import NONE, STILL, Motion, Start, random_start, start_matrix
from handcal_sim.phone import Phone, consumer_phone
from handcal_sim.profiles import Array
from handcal_sim.scenario import World

RATE_HZ, TOGETHER_S = 200.0, 60.0
EFFECTS = ("gyro_scale", "accel_scale")
# What people do differently from what they are asked: how long a turn takes them, how far they
# turn, and how long they think before, s.
HASTE, FAR, THINK_S = (0.8, 1.3), 0.03, (0.3, 1.0)
# It is picked up while somebody thinks, s before the first turn.
PICKED_UP_S = 0.1
# A hand may be asked for so long, s, until all is known well enough.
LONGEST_S = 180.0
# Sigmas a hundredth of what is wanted: never reached, so a minute is used to its end.
NEVER = 0.01
# Means of samples drawn again, for the interval of a median.
AGAIN = 2000
Turns = Sequence[tuple[tuple[float, float, float], float, float]]
AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Hand:
    """One phone in one hand. seed: everything that is drawn comes from it; rate_hz: the phone's."""

    seed: int
    rate_hz: float = RATE_HZ

    def phone(self, rng: np.random.Generator) -> Phone:
        """A consumer's, without a heading, with scale errors of 1 %."""
        made = consumer_phone(rng)
        off = [np.diag(rng.normal(0.0, 0.01, 3)) for _ in range(2)]
        gyro = replace(made.gyro, response=made.gyro.response + off[0])
        accel = replace(made.accel, response=made.accel.response + off[1])
        return replace(made, rate_hz=self.rate_hz, gyro=gyro, accel=accel, heading=None)

    def human(self, turns: Turns) -> list[tuple[tuple[float, float, float], float, float]]:
        """The turns as this hand makes them; the same for the same turns."""
        rng = np.random.default_rng([self.seed, 1])
        out: list[tuple[tuple[float, float, float], float, float]] = []
        for axis, degrees, seconds in turns:
            if degrees == 0.0:
                out.append((axis, 0.0, seconds))
                rng.random(3)
                continue
            out.append(((0.0, 0.0, 1.0), 0.0, float(rng.uniform(*THINK_S))))
            far = degrees * (1.0 + FAR * float(rng.standard_normal()))
            out.append((axis, far, seconds * float(rng.uniform(*HASTE))))
        return out

    def recorded(self, turns: Turns) -> tuple[World, Any]:
        """The world in which this hand made these turns, and handcal's recording of it."""
        from handcal.types import Imu, Recording

        made = self.human(turns)
        duration = sum(seconds for _, _, seconds in made)

        def motion(seconds: float, start: Start, _rng: np.random.Generator) -> Motion:
            return chain(made, seconds, start)

        world = simulate(motion, seed=self.seed, phone=self.phone, duration_s=duration,
                         start=random_start)  # fmt: skip
        value = world.imu.values
        t = world.imu.stamps - world.imu.stamps[0]
        imu = Imu(t, np.ascontiguousarray(value[:, :3]), np.ascontiguousarray(value[:, 3:]),
                  np.ones(len(t), dtype=np.bool_))  # fmt: skip
        return world, Recording("simulated", imu, {}, 0)


def chain(turns: Turns, duration: float, start: Start) -> Motion:
    """Turns one after another about axes of the body; an angle of zero is a rest."""
    stages, rates, rests, at = [], [], [], 0.0
    for axis, degrees, seconds in turns:
        if degrees == 0.0:
            rests.append((at, at + seconds))
        else:
            angle = math.radians(degrees)
            stages.append(profiles.along(np.asarray(axis), profiles.turn(at, at + seconds, angle)))
            rates.append(profiles.turn_rate(at, at + seconds, angle))
        at += seconds
    activity = profiles.add(*rates) if rates else NONE
    # (asked to lay it down, it lies on a table until the first turn)
    first = next((begin for begin, _ in _gaps(rests, duration)), duration)
    held = profiles.gate([(first - PICKED_UP_S, duration + 10.0)], 2.0 * PICKED_UP_S)
    return Motion("asked", duration, start_matrix(start), tuple(stages), STILL, held, activity,
                  tuple(rests))  # fmt: skip


def _gaps(rests: Sequence[tuple[float, float]], duration: float) -> Iterator[tuple[float, float]]:
    """What lies between rests."""
    at = 0.0
    for begin, end in [*rests, (duration, duration)]:
        if begin > at + 1e-9:
            yield at, begin
        at = end


def routine(seconds: float) -> Turns:
    """README's: once about x, y and z, with short rests, again and again."""
    rest = (AXES[2], 0.0, 1.0)
    once = [rest, *(step for axis in AXES for step in ((axis, 360.0, 8.0), rest))]
    out: list[tuple[tuple[float, float, float], float, float]] = [(AXES[2], 0.0, 4.0)]
    while sum(s for _, _, s in out) < seconds:
        out += once
    return out


def cut(recording: Any, seconds: float) -> Any:
    """The beginning of a recording."""
    n = int(np.searchsorted(recording.imu.t, seconds))
    imu = recording.imu
    return replace(
        recording,
        imu=replace(imu, t=imu.t[:n], gyro=imu.gyro[:n], accel=imu.accel[:n], valid=imu.valid[:n]),
    )


def guided(hand: Hand, until: Mapping[str, float], seconds: float) -> dict[str, Any]:
    """A hand that is asked again after each motion, until all is known or the time is over."""
    from handcal.live.looks import looked
    from handcal.live.turns import FIRST, Watched, asked_for

    turns: list[Any] = list(FIRST.motion.turns)
    names: list[str] = []
    seen = 0
    while True:
        _, recording = hand.recorded(turns)
        now = recording.duration_s
        left = seconds - now
        look = looked(recording, EFFECTS, None, until, max(left, 10.0))
        if look is None or look.next is None or look.enough or left <= 0.0:
            break
        asked = asked_for(look.next.name)
        turns += list(asked.motion.turns)
        names.append(asked.name)
        _, after = hand.recorded(turns)
        watched = Watched(asked)
        own = after.imu.t > now
        watched.saw(after.imu.gyro[own] - look.bias, np.full(int(own.sum()), 1.0 / RATE_HZ))
        seen += watched.over
    return {"turns": turns, "names": names, "seen": seen, "seconds": now,
            "enough": bool(look is not None and look.enough)}  # fmt: skip


def planned(like: Any, result: Any) -> Turns:
    """The best plan for the whole minute, with noise and hand as they were found to be."""
    from handcal.design.motion import updated
    from handcal.live.goals import wanted
    from handcal.live.planning import best_plan, informations
    from handcal.live.turns import CHOICE, FIRST, asked_for

    told = dict(informations(result, like, (FIRST, *CHOICE)))
    scale = np.array([p.prior_sigma for p in result.parameters])
    goal = wanted(result.parameters, {})
    known = updated(np.eye(len(scale)), told.pop(FIRST))
    left = TOGETHER_S - FIRST.motion.duration_s
    pause = sum(THINK_S) / 2.0
    names = best_plan(told, known, scale / (NEVER * goal), left, pause)
    turns: list[Any] = list(FIRST.motion.turns)
    for name in names:
        turns += list(asked_for(name).motion.turns)
    return turns


def worst(result: Any) -> float:
    """How many times as uncertain as wanted the worst of biases and scales is."""
    from handcal.live.goals import wanted

    sigma = np.array([p.sigma for p in result.parameters])
    return float((sigma / wanted(result.parameters, {})).max())


def errors(world: World, result: Any) -> list[float]:
    """Errors of all estimates, in their sigmas."""
    true = world.parameters["effects"]
    out = []
    for p in result.parameters:
        entries = true.get(p.effect, [])
        value = next((e["value"] for e in entries if e["name"] == p.name), 0.0)
        out.append((p.value - value) / p.sigma)
    return out


def tried(seed: int) -> dict[str, Any]:
    """One hand, guided, unguided and planned."""
    from handcal.estimate.calibration import calibrate
    from handcal.live.goals import USUAL

    hand = Hand(seed)

    def measured(turns: Turns) -> tuple[dict[str, Any], Any, Any]:
        world, recording = hand.recorded(turns)
        result = calibrate(cut(recording, TOGETHER_S), EFFECTS)
        return {"worst": worst(result), "errors": errors(world, result)}, recording, result

    never = {e: NEVER * USUAL[e] for e in ("gyro_bias", "accel_bias", *EFFECTS)}
    made, soon = guided(hand, never, TOGETHER_S), guided(hand, {}, LONGEST_S)
    led, like, found = measured(made["turns"])
    return {
        "seed": seed,
        "guided": led | {k: made[k] for k in ("names", "seen")},
        "unguided": measured(routine(TOGETHER_S))[0],
        "planned": measured(planned(like, found))[0],
        "soon": {k: soon[k] for k in ("seconds", "enough", "names", "seen")},
    }


def run(n: int, seed: int, advance: Callable[[], None] = lambda: None) -> dict[str, Any]:
    """So many hands, and what is compared of them."""
    began = time.monotonic()
    trials = []
    for k in range(n):
        trials.append(tried(seed + k))
        advance()
    return score(trials) | {"seed": seed, "took_s": time.monotonic() - began, "trials": trials}


def score(trials: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Medians with 95 % intervals, and how honest the sigmas are."""
    rng = np.random.default_rng(0)

    def middle(values: Sequence[float]) -> dict[str, float]:
        x = np.asarray(values, dtype=np.float64)
        again = np.median(x[rng.integers(0, len(x), (AGAIN, len(x)))], axis=1)
        return {"median": float(np.median(x)), "from": float(np.quantile(again, 0.025)),
                "to": float(np.quantile(again, 0.975))}  # fmt: skip

    w = {k: np.array([t[k]["worst"] for t in trials]) for k in ("guided", "unguided", "planned")}
    e: Array = np.concatenate([t["guided"]["errors"] for t in trials])
    done = [t["soon"]["seconds"] for t in trials if t["soon"]["enough"]]
    asked = sum(len(t[k]["names"]) for t in trials for k in ("guided", "soon"))
    seen = sum(t[k]["seen"] for t in trials for k in ("guided", "soon"))
    return {
        "schema": "handcal-sim/prove-live/1", "hands": len(trials),
        "worst": {k: middle(list(v)) for k, v in w.items()},
        "unguided_to_guided": middle(list(w["unguided"] / w["guided"])),
        "least_unguided_to_guided": float((w["unguided"] / w["guided"]).min()),
        "guided_to_planned": middle(list(w["guided"] / w["planned"])),
        "seconds_to_enough": middle(done) if done else None, "enough": len(done),
        "motions_asked": asked, "motions_seen_done": seen,
        "errors": {"rms": float(np.sqrt(np.mean(e**2))),
                   "within_3_sigma": float(np.mean(np.abs(e) < 3.0)), "of": len(e)},
    }  # fmt: skip


def lines(found: Mapping[str, Any]) -> list[str]:
    """The score in sentences."""

    def interval(m: Mapping[str, float]) -> str:
        return f"{m['median']:.2f} (95 %: {m['from']:.2f} to {m['to']:.2f})"

    soon = found["seconds_to_enough"]
    return [
        f"{found['hands']} hands, {TOGETHER_S:.0f} s each at {RATE_HZ:.0f} Hz; the worst of biases "
        "and scales, as times as uncertain as wanted (0.1 %, 15 deg/h, 2 mg):",
        *(f"  {k}: {interval(found['worst'][k])}" for k in ("guided", "planned", "unguided")),
        f"unguided to guided: {interval(found['unguided_to_guided'])}, at least "
        f"{found['least_unguided_to_guided']:.2f}",
        f"guided to planned: {interval(found['guided_to_planned'])}",
        "all scales within 0.1 %, biases within 15 deg/h and 2 mg: "
        + (f"after {interval(soon)} s" if soon else "never")
        + f", {found['enough']} of {found['hands']} hands within {LONGEST_S:.0f} s",
        f"{found['motions_seen_done']} of {found['motions_asked']} motions were seen to be done",
        f"errors of the guided: rms {found['errors']['rms']:.2f} sigma, "
        f"{found['errors']['within_3_sigma']:.1%} of {found['errors']['of']} within three",
    ]
