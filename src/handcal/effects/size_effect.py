"""Size effect: the three accelerometers do not sit at one place."""

from __future__ import annotations

import numpy as np

from handcal.effects import Effect, Param, Signals
from handcal.effects._derivative import derivative, sound
from handcal.effects._linear import added
from handcal.types import Array


def features(signals: Signals) -> list[tuple[int, int, Array]]:
    """Of ``[alpha x r_i + omega x (omega x r_i)]_i`` on accelerometer i.

    r (9,) m in the order xx xy xz yx ... zz: row i is the place of accelerometer i.
    """
    w = signals.gyro
    alpha = derivative(signals.t, w) if signals.alpha is None else signals.alpha
    square = np.einsum("ni,ni->n", w, w)
    out = []
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        columns = w[:, i : i + 1] * w
        columns[:, i] -= square
        columns[:, j] -= alpha[:, k]
        columns[:, k] += alpha[:, j]
        out.append((3 + i, 3 * i, columns))
    return out


EFFECT = Effect(
    id="size_effect",
    title="Size effect",
    parameters=tuple(Param(i + j, "m", 0.02) for i in "xyz" for j in "xyz"),
    story="The three accelerometers sit beside each other, so a turn swings each differently.",
    source="paper 003",
    motion="Fast turns, speeding up and slowing down, about all axes.",
    validated="the simulator's injection",
    imu_error=added(features),
    features=features,
    sound=sound,
    swings=True,
    exclusive=("lever_arm",),
    # A hand turns a device about one place when it rolls it, about another when it pitches it.
    # Real ones, held to be a point, show 12 to 15 nats of this beyond a lever arm.
    imitated=20.0,
    # What all three places have in common is the lever arm's.
    together=np.asarray(np.kron(np.eye(3) - 1.0 / 3.0, np.eye(3)), dtype=np.float64),
)
