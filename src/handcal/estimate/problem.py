"""The estimation problem: what the filter is given, and the layout of its state.

``[position, velocity, psi, gyro bias, accel bias | constants | Markov states]``, each of
the first five (3,). Constants are first those of effects that act on the readings
(``imu constants``), then all others. This package alone knows the layout; ``assemble`` puts a
problem together, ``corrected`` and ``derivatives`` make its readings and slopes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from handcal.compiled.kernel import BASE, MAX_DIM, Nodes, Noise, Tables
from handcal.effects import Effect
from handcal.observations import Observation
from handcal.types import Array, BoolArray, IntArray, Level, Markov, Recording

# The readings themselves show the white noise of the sensors to a few percent; there can be
# more than that (whatever the model lacks), hardly less.
IMU_LEVELS = (
    Level("gyro_noise", "rad/s/sqrt(Hz)", 2e-4, 1e-6, 0.1, below=0.15, above=0.3),
    Level("accel_noise", "m/s^2/sqrt(Hz)", 2e-3, 1e-5, 1.0, below=0.15, above=0.3),
)


@dataclass(frozen=True)
class Slot:
    """One constant of the state: whose it is, its name, unit and prior (about zero, unless
    something outside the filter says better)."""

    owner: str
    name: str
    unit: str
    prior_sigma: float
    prior_mean: float = 0.0


@dataclass(frozen=True)
class Slopes:
    """How the readings depend on the IMU constants: derivatives (n, s) at the nodes, each of one
    channel (s,) by one constant (s,), in the order of the channels; all others are zero."""

    values: Array
    channel: IntArray
    column: IntArray

    def dense(self, constants: int) -> Array:
        """The same as (n, 6, constants)."""
        out = np.zeros((len(self.values), 6, constants))
        out[:, self.channel, self.column] = self.values
        return out

    def times(self, x: Array) -> Array:
        """By how much the readings (n, 6) change with constants that change by x (c,)."""
        of_channel = np.where(self.channel[:, None] == np.arange(6), x[self.column][:, None], 0.0)
        return np.asarray(self.values @ of_channel)


@dataclass(frozen=True)
class Problem:
    """A recording made ready for the filter.

    ref (c,): values of the constants about which the effects were linearised; g_n, omega_ie_n
    (3,); rate (n,): smoothed turning rate at the nodes, rad/s; observations: the kinds in use,
    numbered as in ``nodes.kind``; dropped: rows outside the recording; smooth (6,): of each
    channel, see ``smoothness``. markovs: the processes whose states follow the constants, in
    their order; walks: (first state of those, column of the readings) of each that adds to
    these, and wandering: of each that is a bias; alpha: known angular acceleration (n, 3) at
    the IMU's samples, rad/s^2. slopes: at ref, of what has been linearised about a trajectory;
    the online filter reads ``nodes.J`` instead. error: (n, 6) at the IMU's samples, what the
    effects were last found to add; where the next search for that begins. rests (r, 2): from when
    until when the device rests, s.
    """

    recording: Recording
    effects: tuple[Effect, ...]
    observations: tuple[Observation, ...]
    slots: tuple[Slot, ...]
    imu_constants: int
    markovs: tuple[Markov, ...]
    walks: tuple[tuple[int, int], ...]
    wandering: tuple[tuple[int, int], ...]
    nodes: Nodes
    tables: Tables
    ref: Array
    g_n: Array
    omega_ie_n: Array
    rate: Array
    dropped: int
    smooth: Array
    alpha: Array | None = None
    slopes: Slopes | None = None
    error: Array | None = None
    rests: Array = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def constants(self) -> int:
        return len(self.slots)

    @property
    def navigated(self) -> bool:
        """Whether motion is integrated: not beside a reference alone."""
        return any(o.navigates for o in self.observations)

    @property
    def compared(self) -> bool:
        """Whether readings are compared with a reference's, and nothing is navigated."""
        return bool(self.observations) and not self.navigated

    @property
    def prior_mean(self) -> Array:
        """Prior means (c,) of the constants."""
        return np.array([s.prior_mean for s in self.slots])

    @property
    def markov_size(self) -> int:
        return sum(m.size for m in self.markovs)

    def states_of(self, process: Markov | None) -> IntArray:
        """Places of a process's states among those of all; none where it is not there."""
        at = 0
        for markov in self.markovs:
            if markov is process:
                return np.arange(at, at + markov.size, dtype=np.int64)
            at += markov.size
        return np.zeros(0, dtype=np.int64)

    @property
    def size(self) -> int:
        """Number of states."""
        return BASE + len(self.slots) + self.markov_size

    @property
    def levels(self) -> tuple[Level, ...]:
        """Every noise level that plays a part."""
        found = {lv.name: lv for o in self.observations for lv in o.levels}
        found |= {lv.name: lv for e in self.effects for lv in e.levels}
        return (*IMU_LEVELS, *found.values())


def slots_of(effects: Sequence[Effect]) -> list[Slot]:
    """Constants of effects, first of those that act on the readings."""
    acting = [e for e in effects if e.imu_error is not None]
    others = [e for e in effects if e.imu_error is None]
    return [
        Slot(e.id, p.name, p.unit, p.prior_sigma)
        for e in (*acting, *others)
        for p in e.parameters
        if e.process is None and not e.outliers
    ]


def constants_of(problem: Problem, constants: Array, owner: str) -> Array:
    """Those of the problem's constants (c,) that are an observation's or an effect's."""
    return constants[[i for i, s in enumerate(problem.slots) if s.owner == owner]]


def between(problem: Problem, a: int, b: int) -> Problem:
    """The problem's nodes from a to b and their readings."""
    nodes, s = problem.nodes, slice(a, b + 1)
    q = slice(int(nodes.first[a]), int(nodes.first[b + 1]))
    own = nodes._replace(
        t=nodes.t[s], gyro=nodes.gyro[s], accel=nodes.accel[s], bend=nodes.bend[s], J=nodes.J[s],
        extra=nodes.extra[s], first=nodes.first[a : b + 2] - q.start, kind=nodes.kind[q],
        z=nodes.z[q],
    )  # fmt: skip
    slopes = problem.slopes
    if slopes is not None:
        slopes = replace(slopes, values=slopes.values[s])
    return replace(problem, nodes=own, rate=problem.rate[s], slopes=slopes)


def observation_variances(problem: Problem, levels: Mapping[str, float]) -> Array:
    """R (K, MAX_DIM) of each kind at these noise levels."""
    R = np.ones((len(problem.observations), MAX_DIM))
    for k, o in enumerate(problem.observations):
        R[k, : o.dim] = o.variance(levels)
    return R


def foldable(problem: Problem) -> BoolArray:
    """Kinds of observations (k,) whose readings may be folded."""
    noisy = {kind for e in problem.effects if e.process is not None for kind in e.acts_on}
    some = [o.folds and o.kind not in noisy for o in problem.observations]
    return np.array(some, dtype=np.bool_)


def markov_transitions(
    problem: Problem, levels: Mapping[str, float], t: Array, rate: Array
) -> tuple[Array, Array]:
    """Phi_e, Q_e (n, e, e) of the intervals that end at t (n,); the first is the identity."""
    e = problem.markov_size
    Phi = np.broadcast_to(np.eye(e), (len(t), e, e)).copy()
    Q = np.zeros((len(t), e, e))
    dt = np.diff(t, prepend=t[0])
    at = 0
    for markov in problem.markovs:
        s = slice(at, at + markov.size)
        Phi[:, s, s], Q[:, s, s] = markov.transition(levels, dt, rate)
        at += markov.size
    return Phi, Q


def noise_arrays(problem: Problem, levels: Mapping[str, float]) -> Noise:
    """Noise levels (SI) turned into what the kernel uses at every node."""
    Phi_e, Q_e = markov_transitions(problem, levels, problem.nodes.t, problem.rate)
    return Noise(
        float(levels["gyro_noise"] ** 2),
        float(levels["accel_noise"] ** 2),
        np.zeros(BASE + problem.constants),
        observation_variances(problem, levels),
        Phi_e,
        Q_e,
    )
