"""A problem linearised about a fixed trajectory: everything but the noise levels.

Between two observation epochs the readings are integrated once into one transition
(preintegration), so a pass costs as many steps as there are epochs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from handcal.compiled import so3
from handcal.compiled.jit import copy1, njit
from handcal.compiled.kernel import BASE, Nodes, Tables, fill_nav, linearise
from handcal.compiled.preintegration import (
    preintegrate,
    preintegration_work,
    responses,
    turn_errors,
    turn_noise,
)
from handcal.effects import ATTITUDE, DELAY, Effect, Signals
from handcal.estimate.corrected import Corrected, corrected_readings
from handcal.estimate.derivatives import differentiated, moving
from handcal.estimate.exciting import held, sway, unexciting
from handcal.estimate.parallel import in_threads
from handcal.estimate.problem import Problem, Slopes, constants_of
from handcal.estimate.seen import (
    by_biases,
    measured,
    seen_by_biases,
    seen_by_constants,
    seen_by_past,
)
from handcal.estimate.start import Start
from handcal.estimate.trajectory import Trajectory, biases, intervals, path
from handcal.observations import NAV
from handcal.signals import further, reading
from handcal.types import Array, BoolArray, IntArray

# Epochs from which they are integrated in two halves, on two cores: a twentieth of a second.
MANY = 10_000


@dataclass(frozen=True)
class Linear:
    """A problem linearised about a trajectory; everything but the noise levels.

    Phi (k, 9, 15 + mi) from the epoch before, d (k, 9) predicted minus nominal, Q_gyro,
    Q_accel, Q_extra (k, 9, 9) per unit density; t, rate (k,); first (k + 1,) rows of each
    epoch; kind (q,), r (q, m), H (q, m, N), used (q,), m the most that any kind reads at once.
    """

    problem: Problem
    trajectory: Trajectory
    start: Start
    Phi: Array
    d: Array
    Q_gyro: Array
    Q_accel: Array
    Q_extra: Array
    t: Array
    rate: Array
    first: IntArray
    kind: IntArray
    r: Array
    H: Array
    used: BoolArray


@dataclass(frozen=True)
class About:
    """A problem and the trajectory about which it is linearised, once that is asked for.

    What is linearised is fifty times as large as what it is made of, and made in a moment: a fit
    that is only kept, to be compared or begun from, does without (``bare``).
    """

    problem: Problem
    start: Start
    trajectory: Trajectory

    @property
    def linear(self) -> Linear:
        # (no cached_property: its lock would let one thread wait for all others' linearisations)
        held: Linear | None = self.__dict__.get("_linear")
        if held is None:
            held = linearise_about(self.problem, self.start, self.trajectory)
            self.__dict__["_linear"] = held
        return held

    def released(self) -> Linear:
        """What it was linearised to, not kept here: whoever asks may make it something smaller."""
        linear = self.linear
        self.__dict__.pop("_linear", None)
        return linear

    @property
    def corrected(self) -> Problem:
        """The problem with readings that are corrected at its trajectory's constants."""
        held: Linear | None = self.__dict__.get("_linear")
        return prepared(self.problem, self.trajectory)[0] if held is None else held.problem

    @property
    def bare(self) -> About:
        return replace(self)


def known_linear(linear: Linear) -> About:
    """Of what is linearised already, or was changed since."""
    about = About(linear.problem, linear.start, linear.trajectory)
    about.__dict__["_linear"] = linear
    return about


def beside(linear: Linear, problem: Problem, nominal: Trajectory) -> About:
    """About the same trajectory the problem with further Markov states and no further constants:
    what is between the epochs does not depend on them."""
    have = linear.problem
    problem = replace(problem, nodes=have.nodes, ref=have.ref, slopes=have.slopes, error=have.error)
    between = linear.Phi, linear.d, (linear.Q_gyro, linear.Q_accel, linear.Q_extra)
    return known_linear(observed(problem, linear.start, nominal, between))


# (numbers that run away are no fit, which is seen later)
@np.errstate(over="ignore", invalid="ignore")
def linearise_about(problem: Problem, start: Start, nominal: Trajectory) -> Linear:
    """Integrate between the epochs and linearise everything about the nominal trajectory."""
    problem, Phi, d, Q = _integrated(problem, nominal)
    if any(o.navigates for o in problem.observations):
        # (else d is no noise: it holds whatever moved the biases, and nothing pulls it back)
        turn_noise(Phi, d)
    problem = believing(problem, nominal.constants)
    return observed(problem, start, nominal, (Phi, d, (Q[0], Q[1], Q[2])))


def observed(
    problem: Problem,
    start: Start,
    nominal: Trajectory,
    between: tuple[Array, Array, tuple[Array, Array, Array]],
) -> Linear:
    """What is observed, linearised, with what is between the epochs: Phi, d and the three Q."""
    nodes, node = problem.nodes, nominal.node
    r, H, used = _rows(problem, nominal)
    if problem.slopes is not None:
        seen_by_constants(problem.slopes, nodes.first, H)
    seen_by_past(problem, nominal, r, H)
    by_bias = by_biases(problem, nominal)
    seen_by_biases(problem, None if by_bias is None else by_bias[0], H)
    if by_bias is not None:
        measure = measured(problem, by_bias[1])
        r, H = np.einsum("qij,qj->qi", measure, r), measure @ H
    for kind, observation in enumerate(problem.observations):
        if observation.isotropic:
            rows = (nodes.kind == kind) & ~nodes.z[:, :DELAY].any(axis=1)
            H[rows, :3, 6:9] -= so3.skew(r[rows, :3])
    Phi, d, Q = between
    return Linear(
        problem,
        nominal,
        start,
        Phi,
        d,
        *Q,
        nodes.t[node],
        turning(problem, node),
        np.r_[nodes.first[node], nodes.first[-1]],
        nodes.kind,
        r,
        H,
        used,
    )


def _integrated(problem: Problem, nominal: Trajectory) -> tuple[Problem, Array, Array, Array]:
    """The problem with readings that are corrected at the nominal constants, and Phi, d and the
    three Q (see ``transitions``) between the epochs, those of the constants with them."""
    problem, done, C_nb = prepared(problem, nominal)
    Phi, d, Q, W = transitions(problem, nominal, done is not None)
    if done is not None:
        # What an effect does depends on the true rate and force: take off the noise that
        # this trajectory implies, or each sample's noise would pose as motion that excites it.
        problem = differentiated(done, *unexciting(problem, nominal, d, C_nb))
        slopes = problem.slopes
        assert slopes is not None
        responses(W, slopes.values, slopes.channel, slopes.column, nominal.node, Phi[:, :, BASE:])
    return problem, Phi, d, Q


def prepared(
    problem: Problem, nominal: Trajectory
) -> tuple[Problem, Corrected | None, Array | None]:
    """The problem with readings that are corrected at the nominal constants for good, how that was
    done (None: there was nothing to do), and C_nb (n, 3, 3) where that was asked for."""
    turning = problem.navigated and any(ATTITUDE in e.needs or e.swings for e in problem.effects)
    done, C_nb = None, None
    if problem.imu_constants:
        C_nb = _attitude(problem, nominal) if turning or held(problem) else None
        done = _corrected(problem, nominal, C_nb)
        problem = done.problem
    return _bare(replace(problem, ref=nominal.constants)), done, C_nb


def _rows(problem: Problem, nominal: Trajectory) -> tuple[Array, Array, BoolArray]:
    """r (q, m), H (q, m, N) and used (q,) of all readings, but for what acts on the IMU's."""
    q = len(problem.nodes.kind)
    widest = int(problem.tables.dim.max(initial=1))
    r, H = np.zeros((q, widest)), np.zeros((q, widest, problem.size))
    used = np.zeros(q, dtype=np.bool_)
    _linearise_rows(
        problem.nodes,
        problem.tables,
        nominal.node,
        (nominal.p, nominal.v, nominal.C, nominal.markov),
        (*biases(problem, nominal), nominal.constants),
        (r, H, used),
    )
    return r, H, used


def _attitude(problem: Problem, nominal: Trajectory) -> Array:
    """C_nb (n, 3, 3) at the IMU's samples."""
    return path(problem, nominal).C[np.searchsorted(problem.nodes.t, problem.recording.imu.t)]


@dataclass(frozen=True)
class Excited:
    """What effects that a linearised problem does not have would act on: its corrected readings,
    and what of them counts as motion (noise, force: see ``differentiated``). C_nb (n, 3, 3), or
    None; W (n, 9, 6): what an error of the readings over each interval makes of the state at the
    next epoch; by_reading (q, m, 6): of observations that look at rate and force themselves;
    measure (q, m, m): what their residuals are multiplied by, or None."""

    done: Corrected
    noise: Array | None
    force: Array | None
    C_nb: Array | None
    W: Array
    by_reading: Array
    measure: Array | None


def excited(linear: Linear, fresh: Problem) -> Excited:
    """What further effects would act on; fresh: the linearised problem as it was built."""
    problem, nominal = linear.problem, linear.trajectory
    C_nb = _attitude(fresh, nominal) if problem.navigated else None
    done = _corrected(fresh, nominal, C_nb)
    _, d, _, W = transitions(problem, nominal, True)
    if problem.navigated:
        turn_errors(W, nominal.node, d)
    H = linear.H if problem.navigated else _rows(problem, nominal)[1]
    by_bias = by_biases(problem, nominal)
    measure = None if by_bias is None else measured(problem, by_bias[1])
    H = H if measure is None else measure @ H
    by_reading = H[:, :, 9:BASE] if H[:, :, 9:BASE].any() else np.zeros((0, 0, 6))
    noise, force = unexciting(problem, nominal, d, C_nb)
    return Excited(done, noise, force, C_nb, W, np.ascontiguousarray(by_reading), measure)


def slopes_of(told: Excited, effects: Sequence[Effect], beside: Sequence[Effect] = ()) -> Slopes:
    """Derivatives of the readings by the constants of effects that are zero; beside: others that
    are on trial with them."""
    done, acting = told.done, [e for e in effects if e.imu_error is not None]
    asked = told.force is not None or any(
        ATTITUDE in e.needs or e.swings for e in (*acting, *beside) if e.imu_error is not None
    )
    have = done.problem
    needed = [e for e in have.effects if e.imu_error is not None] + acting
    read = replace(
        done.read,
        C_nb=told.C_nb if asked else None,
        streams=further(have.recording, needed),
    )
    zeros = np.zeros(sum(len(e.parameters) for e in acting))
    problem = replace(have, effects=tuple(acting), ref=zeros)
    found = differentiated(replace(done, problem=problem, read=read), told.noise, told.force).slopes
    assert found is not None
    return found


def motion_of(told: Excited) -> Signals:
    """Rate, force and attitude as they may excite an effect, at the IMU's samples."""
    done = told.done
    truth, _ = moving(done, told.noise, told.force)
    streams = further(done.problem.recording, ())
    return reading(replace(done.read, C_nb=told.C_nb, streams=streams), truth)


def believing(problem: Problem, constants: Array) -> Problem:
    """The problem with what its observations and effects tell others of their constants (c,)."""
    for k, o in enumerate(problem.observations):
        told = [(o.kind, o.believed)] if o.believed is not None else []
        told += [(e.id, e.believed[o.kind]) for e in problem.effects if o.kind in e.believed]
        if told:
            z, mine = problem.nodes.z.copy(), problem.nodes.kind == k
            for owner, believed in told:
                z[mine] = believed(z[mine], constants_of(problem, constants, owner))
            problem = replace(problem, nodes=problem.nodes._replace(z=z))
    return problem


def turning(problem: Problem, node: IntArray) -> Array:
    """Turning rate (k,), rad/s, that the noise of each interval goes by: root mean square over the
    time since the last look at the held point, so that it does not depend on how many readings
    of a heading come in between."""
    nodes = problem.nodes
    folds = np.array([o.folds for o in problem.observations], dtype=np.bool_)
    looks = np.zeros(len(nodes.t), dtype=np.bool_)
    at = np.repeat(np.arange(len(nodes.t)), np.diff(nodes.first))
    looks[at[~folds[nodes.kind]]] = True
    look = np.flatnonzero(looks[node])
    if not len(look):
        return problem.rate[node]
    ends = node[np.r_[look, len(node) - 1]]
    begins = np.r_[node[0], ends[:-1]]
    squares = np.r_[0.0, np.cumsum(problem.rate[1:] ** 2 * np.diff(nodes.t))]
    span = nodes.t[ends] - nodes.t[begins]
    mean = (squares[ends] - squares[begins]) / np.maximum(span, 1e-9)
    rates = np.where(span > 0.0, np.sqrt(mean), problem.rate[ends])
    return np.asarray(rates[np.searchsorted(look, np.arange(len(node)))])


def _corrected(problem: Problem, nominal: Trajectory, C_nb: Array | None) -> Corrected:
    """The problem with readings that are corrected at the nominal constants."""
    swayed = sway(problem, nominal, C_nb) if held(problem) and C_nb is not None else None
    constants = nominal.constants
    return corrected_readings(problem, constants, nominal.bg, nominal.ba, C_nb, swayed)


def _bare(problem: Problem) -> Problem:
    """The problem with readings that have been corrected at problem.ref for good."""
    return replace(problem, nodes=problem.nodes._replace(J=np.zeros((len(problem.nodes.t), 6, 0))))


def transitions(
    problem: Problem, nominal: Trajectory, by_reading: bool
) -> tuple[Array, Array, Array, Array]:
    """Phi (k, 9, 15 + mi) but for the constants, d (k, 9) and the three Q (3, k, 9, 9) between the
    epochs; W (n, 9, 6) (see ``preintegrate``), or (0, 9, 6) if that is not asked for."""
    k = len(nominal.node)
    Phi, d = np.zeros((k, 9, BASE + problem.imu_constants)), np.zeros((k, 9))
    Q, W = np.zeros((3, k, 9, 9)), np.empty((len(problem.nodes.t) if by_reading else 0, 9, 6))
    nodes, epoch, (p, v, C), (bg, ba), g_n, turns = intervals(problem, nominal)

    def integrated(a: int, b: int) -> None:
        some = slice(a, b + 1)  # (what leads to an epoch begins at the one before)
        preintegrate(
            nodes, epoch[some], (p[some], v[some], C[some]), (bg[some], ba[some]), g_n, turns,
            (Phi[some], d[some], Q[0, some], Q[1, some], Q[2, some]), W,
            preintegration_work(int(np.diff(epoch[some]).max(initial=0))),
        )  # fmt: skip

    cuts = [0, k // 2, k - 1] if k > MANY else [0, k - 1]
    for _ in in_threads(partial(integrated, a, b) for a, b in pairwise(cuts)):
        pass
    return Phi, d, Q, W


@njit
def _linearise_rows(
    nodes: Nodes,
    tables: Tables,
    epoch: IntArray,
    nominal: tuple[Array, Array, Array, Array],
    constants: tuple[Array, Array, Array],
    out: tuple[Array, Array, BoolArray],
) -> None:
    bg, ba, constant = constants
    extras = np.empty(len(constant) + nominal[3].shape[1])
    copy1(constant, extras[: len(constant)])
    nav, w, f = np.empty(NAV), np.empty(3), np.empty(3)
    for j in range(len(epoch)):
        i = epoch[j]
        for a in range(nominal[3].shape[1]):
            extras[len(constant) + a] = nominal[3][j, a]
        for a in range(3):
            w[a] = nodes.gyro[i, a] - bg[j, a]
            f[a] = nodes.accel[i, a] - ba[j, a]
        fill_nav(nominal[0][j], nominal[1][j], nominal[2][j], w, f, nav)
        for q in range(nodes.first[i], nodes.first[i + 1]):
            out[2][q] = (
                linearise(
                    nodes.kind[q], tables, nav, extras, nodes.z[q], nodes.J[i], out[0][q], out[1][q]
                )
                == 0
            )
