"""How far scores scatter beyond what a model says of them, told effect by effect."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from handcal.estimate.robust import BLOCK_S, _scattered

EFFECTS, EACH, SECONDS, RATE, SIZE = 12, 2, 400.0, 20.0, 30.0


def a_pass(rng: np.random.Generator, odd: int) -> Any:
    """White innovations, but for one effect by whose parameters they err from block to block."""
    ids = [f"effect {k}" for k in range(EFFECTS)]
    slots = [SimpleNamespace(owner=i) for i in ids for _ in range(EACH)]
    problem = SimpleNamespace(effects=[SimpleNamespace(id=i) for i in ids], slots=slots)
    t = np.arange(0.0, SECONDS, 1.0 / RATE)
    seen = rng.standard_normal((len(t), 6 + EFFECTS * EACH)) / np.sqrt(len(t))
    own = seen[:, 6 + EACH * odd : 6 + EACH * (odd + 1)]
    errs = rng.standard_normal((int(SECONDS / BLOCK_S) + 1, EACH))[(t / BLOCK_S).astype(int)]
    innovations = rng.standard_normal(len(t)) + SIZE * (own * errs).sum(axis=1)
    linear = SimpleNamespace(t=t, problem=problem)
    # (of far more information than the priors have)
    by_constants, S = 30.0 * seen, 1.0 + EACH * SIZE**2 / len(t)
    return SimpleNamespace(
        nu=np.column_stack([innovations, by_constants]),
        S=np.full(len(t), S),
        log_likelihood=(0.0, None, by_constants.T @ by_constants / S),
        reduction=SimpleNamespace(linear=linear, first=np.arange(len(t) + 1)),
    )


@pytest.mark.parametrize("present", [None, 6, 6 + 3 * EACH])
@pytest.mark.parametrize("odd", range(0, EFFECTS, 3))
def test_the_effect_that_errs_from_block_to_block_is_told(present: int | None, odd: int) -> None:
    """Alone: of white scores the ratio is a chi-square's of as many degrees as there are blocks
    (five standard deviations, two parameters each)."""
    done = a_pass(np.random.default_rng(odd), odd)
    beside = None if present is None else np.arange(present)
    found = _scattered(done, np.zeros(6 + EFFECTS * EACH), beside)
    assert sorted(i for i, *_ in found) == sorted(f"effect {k}" for k in range(EFFECTS))
    blocks = SECONDS / BLOCK_S
    room = 5.0 * np.sqrt(2.0 / (EACH * blocks))
    for i, ratio, count in found:
        assert count == blocks
        if i == f"effect {odd}":
            assert ratio > 3.0
        else:
            assert abs(ratio - 1.0) < room, i
