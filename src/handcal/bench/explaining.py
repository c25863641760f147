"""Time and memory of ``handcal explain``: whole commands, as a person runs them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from handcal.bench.program import simulated
from handcal.bench.timing import (
    Figure,
    Missing,
    Ran,
    Row,
    Skipped,
    Target,
    Tick,
    profile,
    run_handcal,
)
from handcal.search.budget import SO_FAR
from handcal.types import HandcalError

# Errors of usual size, of which a device has many at once.
ERRORS = (
    "gyro_scale=0.008,-0.006,0.01",
    "gyro_misalignment=0.006,-0.004,0.008,0.005,-0.007,0.004",
    "gyro_g_sensitivity=1e-4,-2e-4,1.5e-4,2e-4,1e-4,-1e-4,2e-4,-1.5e-4,1e-4",
    "gyro_quadratic=0.004,-0.005,0.006",
    "accel_scale=0.006,-0.01,0.008",
    "accel_misalignment=0.006,-0.005,0.007",
    "accel_delay=0.008",
    "lever_arm=0.04,-0.06,0.03",
)
WITH_MAG = ("accel_bias_walk=0.002", "heading_delay=0.06")
WITH_POSE = ("gyro_bandwidth=0.012", "pose_delay=0.015")
# Seconds and megabytes that are asked.
CLEAN_S, TEN_S, LONG_S, MEDIAN_S, WORST_S = 2.0, 30.0, 60.0, 15.0, 40.0
USUAL_MB, LONG_MB = 600.0, 1000.0


def explaining(folder: Path, rounds: int, tick: Tick) -> Iterator[Row]:
    """Simulated recordings: one of a perfect device, two of devices with ten errors, a long one."""
    ten = ("--duration", "120", "--seed", "1")
    rows = (
        ("84 s at 100 Hz, no error", ("--duration", "84"), CLEAN_S, USUAL_MB),
        ("120 s, ten errors, magnetometer", (*ten, "--mag", *_put(WITH_MAG)), TEN_S, USUAL_MB),
        ("120 s, ten errors, pose", (*ten, "--pose", *_put(WITH_POSE)), TEN_S, USUAL_MB),
        ("10 min, no error", ("--duration", "600"), LONG_S, LONG_MB),
    )
    for title, options, seconds, megabytes in rows:
        tick(title)
        path = simulated("free-hand", folder / "explained.mcap", *options)
        ran = [_explained(path, tick) for _ in range(rounds)]
        yield from _figures("explain", f"explain: {title}", ran, seconds, megabytes)
        yield from profile("explain", f"explain: {title}", ran[-1])


def _put(more: Sequence[str]) -> list[str]:
    return [word for one in (*ERRORS, *more) for word in ("--effect", one)]


def devices(recordings: Path, tick: Tick) -> Iterator[Row]:
    """Every recording (MCAP) below a folder once, the smallest first; then median and worst.

    One that cannot be explained is left out. Interrupted, it tells the median of those before,
    of which nothing is asked: large recordings take longer. Raises Missing where there is none.
    """
    files = sorted(recordings.rglob("*.mcap"), key=lambda path: (path.stat().st_size, path))
    if not files:
        raise Missing(f"there is no recording in {recordings} (--recordings names another folder).")
    wall: list[float] = []
    try:
        for k, path in enumerate(files, 1):
            tick(f"{path.name} ({k} of {len(files)})")
            try:
                ran = _explained(path, tick)
            except HandcalError as problem:
                yield Skipped("devices", f"explain: {path.stem}", str(problem))
                continue
            wall.append(ran.wall)
            yield from _figures("devices", f"explain: {path.stem}", [ran], WORST_S)
            yield from _last_found(path, ran)
            yield from profile("devices", f"explain: {path.stem}", ran)
    except (KeyboardInterrupt, SystemExit):
        yield from _summary(wall, f"the smallest {len(wall)} of {len(files)} recordings", False)
        raise
    yield from _summary(wall, f"{len(wall)} recordings", True)


def _summary(wall: Sequence[float], of: str, asked: bool) -> Iterator[Figure]:
    """The median and the worst of what was measured, if something was."""
    for title, middle, most in (("median", np.median, MEDIAN_S), ("worst", np.max, WORST_S)):
        if wall:
            target = Target(most, True) if asked else None
            value = np.array([middle(wall)])
            yield Figure("devices", f"explain: {title} of {of}", "s", value, "wall", target)


def _last_found(path: Path, ran: Ran) -> Iterator[Figure]:
    """When a search last found something, or took something back, if it said so."""
    times = [t for t, line in ran.said if SO_FAR in line]
    if times:
        last = np.array([times[-1]])
        yield Figure("devices", f"explain: {path.stem}, found what it says by", "s", last, "wall")


def _explained(path: Path, tick: Tick) -> Ran:
    ran = run_handcal("explain", path, whole=True, sampled=True)
    tick()
    return ran


def _figures(
    group: str, title: str, ran: Sequence[Ran], seconds: float = 0.0, megabytes: float = 0.0
) -> list[Figure]:
    """Time by the clock and memory, each with what is asked of it, if something is."""
    time, most = (Target(x, True) if x else None for x in (seconds, megabytes))
    wall, memory = np.array([one.wall for one in ran]), np.array([one.memory for one in ran])
    out = [Figure(group, title, "s", wall, "wall", time)]
    if not np.isnan(memory).any():
        out.append(Figure(group, f"{title}, memory", "MB", memory, "", most))
    return out
