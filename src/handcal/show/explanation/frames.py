"""What there is to see of an ``Explanation``, and in what order; nothing here draws."""

from __future__ import annotations

import numpy as np

from handcal.explanation import Explained, Explanation, Hypothesis, Mismatch, Trace
from handcal.show.explanation.words import one_model
from handcal.types import Array

CELLS = 120  # time bins of a heat strip


def nothing_added(explanation: Explanation) -> bool:
    """Whether all that was found is in the baseline too (a magnetometer's hard iron), so that
    baseline and final model are one."""
    return bool(explanation.missing) and one_model(explanation)


def told_mismatch(explanation: Explanation) -> tuple[Mismatch, ...]:
    """Where the baseline does not fit; nowhere where it is the final model."""
    return () if nothing_added(explanation) else explanation.mismatch


def found_effects(explanation: Explanation) -> list[str]:
    """Ids of the effects found, most evidence first: each has a colour of its own."""
    return [h.effect for h in by_gain(explanation) if h.verdict]


def by_gain(explanation: Explanation) -> list[Hypothesis]:
    """Those found by what they gain in the end, then the others by what they gain alone."""
    return sorted(
        explanation.hypotheses,
        key=lambda h: (not h.verdict, -h.final if h.verdict else -h.alone),
    )


def mismatches(explanation: Explanation, recording: int, channel: str = "") -> list[Mismatch]:
    """Those of one recording, and of one channel if it is named."""
    return [
        m for m in told_mismatch(explanation)
        if m.recording == recording and channel in ("", m.channel)
    ]  # fmt: skip


def _known(values: Array) -> Array:
    """Nothing where a value is not a number."""
    return np.where(np.isfinite(values), values, 0.0)


def lost(recording: Explained) -> dict[str, float]:
    """Nats that each channel lost in all, most first; channels without a trace too."""
    total = {c: float(np.clip(_known(s), 0, None).sum()) for c, s in recording.shortfall.items()}
    return dict(sorted(total.items(), key=lambda pair: -pair[1]))


def missed(trace: Trace, model: Array) -> Array:
    """Recorded minus simulated (k,), angles within half a turn."""
    difference = trace.recorded - model
    if trace.unit == "rad":
        difference = np.angle(np.exp(1j * difference))
    return np.asarray(difference)


def ranked_traces(explanation: Explanation, recording: int) -> list[Trace]:
    """A recording's traces: those with a mismatch first, then by what they lost."""
    r = explanation.recordings[recording]
    loss = lost(r)
    return sorted(
        (t for t in r.traces if t.t.size > 1),
        key=lambda t: (not mismatches(explanation, recording, t.channel), -loss.get(t.channel, 0)),
    )


def cells(recording: Explained) -> tuple[Array, dict[str, Array]]:
    """Bins and shortfall, neighbours added up until there are not too many."""
    step = max(-(-(recording.bins.size - 1) // CELLS), 1)
    starts = np.arange(0, recording.bins.size - 1, step)
    bins = np.append(recording.bins[starts], recording.bins[-1])
    return bins, {c: np.add.reduceat(_known(s), starts) for c, s in recording.shortfall.items()}
