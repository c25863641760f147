"""Explain in a world that the project's simulator does not make."""

from __future__ import annotations

import numpy as np
import pytest
from other_world import drawn, recorded

from handcal.explain import explain


@pytest.mark.prove
@pytest.mark.parametrize("count", [0, 1, 2])
def test_names_and_values_in_another_world(count: int) -> None:
    """Twelve recordings: at most one wrong (asked are 98 % for one effect, 90 % for several),
    and of those named the standardised errors have the squares that chance allows."""
    wrong, z = [], []
    for seed in range(12):
        effects = drawn(seed, count)
        found = explain([recorded(seed, effects)])
        named = {m.effect: m for m in found.missing}
        verdict = "explained" if effects else "nothing_missing"
        print(count, seed, found.verdict, sorted(effects), sorted(named))
        if found.verdict != verdict or set(named) != set(effects):
            wrong.append((seed, found.verdict, sorted(effects), sorted(named)))
            continue
        for name, values in effects.items():
            z += [
                (p.value - v) / p.sigma for p, v in zip(named[name].parameters, values, strict=True)
            ]
    print(
        f"{len(wrong)} wrong of 12; {len(z)} parameters, rms of z", np.sqrt(np.mean(np.square(z)))
    )
    assert len(wrong) <= 1, wrong
    if z:
        # five sigma of a chi square's mean, either way
        assert abs(np.mean(np.square(z)) - 1.0) < 5.0 * np.sqrt(2.0 / len(z))


def test_the_other_world_is_as_it_says() -> None:
    """Gravity at rest, and a turn that the gyro's readings integrate to."""
    world = recorded(1, {}, 20.0)
    assert np.linalg.norm(world.imu.accel[:200].mean(axis=0)) == pytest.approx(9.81, abs=0.7)
    assert world.imu.gyro[:200].std() < 0.01
    assert world.imu.gyro[300:-300].std() > 0.3
