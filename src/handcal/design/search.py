"""The search for the best set of poses: one after the other, or all at once.

One after the other is paper 001's: the next pose is the one whose readings, each row of
length one, project least on the rows there are. Once these span everything, nothing is left
to project, and the pose that improves the criterion most is next.

All at once: the criterion climbs along its gradient from several random sets (BFGS).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from handcal.compiled import so3
from handcal.design.plain import in_order, plainest, plainness, regular_solids, unit
from handcal.design.poses import PLAIN, Experiment, everywhere
from handcal.types import Array, HandcalError

CRITERIA = ("D", "A", "condition")
# Powers by which the largest and the smallest eigenvalue are told from the others, in turn.
SHARPER = (4.0, 16.0, 64.0, 256.0)
STEP = 3e-4
FINE = 4000
SAME = 1e-6
HELD_WITHIN_DEG = 5.0
TRIES = 200

Report = Callable[[float], None]


@dataclass(frozen=True)
class Design:
    """A set of poses and how good it is.

    up (n, 3): up in body axes. information (k, k): mean over the poses, in the experiment's
    units. d_efficiency: (det M / det M*)^(1/k), M* that of the best design with any number of
    poses; a_efficiency: likewise of the mean variance; condition: of M, and the best there is.
    loose: D-efficiency that 95 of 100 users keep who hold each pose within 5 deg (1 sigma).
    """

    experiment: Experiment
    up: Array
    criterion: str
    way: str
    information: Array
    d_efficiency: float
    a_efficiency: float
    condition: float
    best_condition: float
    loose: float

    @property
    def sigma(self) -> Array:
        """Standard deviations (k,) of the parameters, in their own units; see ``NOISE``."""
        covariance = np.linalg.solve(self.information, np.eye(len(self.information)))
        return np.asarray(
            np.sqrt(np.diag(covariance) / len(self.up)) * self.experiment.scale
        )  # fmt: skip


def design(
    experiment: Experiment,
    n: int,
    criterion: str,
    rng: np.random.Generator,
    sequential: bool = False,
    starts: int = 24,
    progress: Report | None = None,
) -> Design:
    """The best n poses for an experiment.

    Errors: HandcalError where n poses cannot tell all the parameters.
    """
    _enough(experiment, n)
    if sequential:
        up = one_by_one(experiment, n, criterion)
    else:
        up = in_order(all_at_once(experiment, n, criterion, rng, starts, progress))
    return judged(experiment, up, criterion, "sequential" if sequential else "global", rng)


def judged(
    experiment: Experiment, up: Array, criterion: str, way: str, rng: np.random.Generator
) -> Design:
    """A given set of poses up (n, 3) beside the best that there is."""
    M = experiment.information(up)
    own = {c: value(M, c) for c in CRITERIA}
    known = {c: value(experiment.information(*anywhere(experiment, c)), c) for c in CRITERIA}
    best = {c: min(own[c], known[c]) for c in CRITERIA}

    def held() -> float:
        turned = up + math.radians(HELD_WITHIN_DEG) * rng.standard_normal(up.shape)
        return value(experiment.information(unit(turned)), "D")

    loose = float(np.quantile([held() for _ in range(TRIES)], 0.95))
    return Design(
        experiment, up, criterion, way, M,
        math.exp(best["D"] - own["D"]), math.exp(best["A"] - own["A"]),
        math.exp(own["condition"]), math.exp(best["condition"]), math.exp(best["D"] - loose),
    )  # fmt: skip


def _enough(e: Experiment, n: int) -> None:
    least = -(-len(e.scale) // e.readings)
    if n < least:
        raise HandcalError(
            f"{n} poses give {n * e.readings} readings for {len(e.scale)} unknowns "
            f"({', '.join(x.id for x in e.effects)}): at least {least} poses."
        )


def value(M: Array, criterion: str) -> float:
    """What is to be small: -log det M / k, log of the mean variance, or log of the condition."""
    values = np.linalg.eigvalsh(M)
    if values[0] <= 0.0:
        return math.inf
    if criterion == "D":
        return -float(np.log(values).mean())
    if criterion == "A":
        return float(np.log((1.0 / values).mean()))
    return float(np.log(values[-1] / values[0]))


def _smooth(M: Array, criterion: str, power: float) -> tuple[float, Array]:
    """``value`` and its gradient (k, k) by M; of the condition, eigenvalues nearly extreme
    count in part, the less the higher the power."""
    values, V = np.linalg.eigh(M)
    values = np.maximum(values, 1e-14 * max(float(values[-1]), 1e-300))
    k = len(values)
    if criterion == "D":
        return -float(np.log(values).mean()), (V * (-1.0 / (k * values))) @ V.T
    if criterion == "A":
        inverse = 1.0 / values
        return float(np.log(inverse.mean())), (V * (-(inverse**2) / inverse.sum())) @ V.T
    log = np.log(values)
    high, low = power * (log - log[-1]), power * (log[0] - log)
    top, bottom = np.exp(high), np.exp(low)
    f = log[-1] + np.log(top.sum()) / power - log[0] + np.log(bottom.sum()) / power
    slope = (top / top.sum() - bottom / bottom.sum()) / values
    return float(f), (V * slope) @ V.T


def all_at_once(
    e: Experiment, n: int, criterion: str, rng: np.random.Generator, starts: int,
    progress: Report | None = None,
) -> Array:  # fmt: skip
    """The best of several climbs from random sets of n poses, (n, 3); of equals the plainest."""
    found: list[tuple[float, Array]] = []
    regular = [up for up in regular_solids() if len(up) == n]
    for i in range(starts):
        up = regular.pop() if regular else unit(rng.standard_normal((n, 3)))
        for power in _powers(criterion):
            up = climbed(e, up, criterion, power)
        found.append((value(e.information(up), criterion), up))
        if progress is not None:
            progress((i + 1) / starts)
    least = min(v for v, _ in found)
    equals = [up for v, up in found if v < least + SAME]
    if _turns_freely(e, equals[0], criterion, rng):
        equals = [plainest(up) for up in equals]
    best = max(equals, key=lambda up: round(plainness(up), 6))
    return np.where(np.abs(best) < 1e-7, 0.0, best)


def climbed(e: Experiment, up: Array, criterion: str, power: float = 1.0) -> Array:
    """Poses (n, 3) moved until the criterion no longer improves."""
    n = len(up)

    def slope(x: Array) -> tuple[float, Array]:
        length = np.linalg.norm(x.reshape(n, 3), axis=1, keepdims=True)
        u = x.reshape(n, 3) / length
        J = e.jacobian(u)
        f, G = _smooth(np.einsum("nmi,nmj->ij", J, J) / n, criterion, power)
        beside = u[:, None, None] + STEP * np.stack([np.eye(3), -np.eye(3)])
        moved = e.jacobian(unit(beside.reshape(-1, 3))).reshape(n, 2, 3, *J.shape[1:])
        dJ = (moved[:, 0] - moved[:, 1]) / (2.0 * STEP)
        return f, (2.0 / n * np.einsum("nami,ij,nmj->na", dJ, G, J) / length).ravel()

    # BFGS: small matrices only, for which L-BFGS-B's would wait for threads on a busy machine
    done = minimize(slope, up.ravel(), jac=True, method="BFGS", options={"gtol": 1e-8})
    return unit(done.x.reshape(n, 3))


def anywhere(e: Experiment, criterion: str) -> tuple[Array, Array]:
    """The best design with any number of poses: directions (q, 3) and weights (q,).

    It begins with equal weight all over the sphere, which is already the best for the
    determinant wherever no direction is special, and once more along axes and diagonals.
    """
    up, even = everywhere()
    up = np.vstack([PLAIN, up])
    J = e.jacobian(up)
    each = np.einsum("nmi,nmj->nij", J, J)
    little = 1e-4

    def slope(x: Array, power: float) -> tuple[float, Array]:
        w = np.exp(x - x.max())
        w /= w.sum()
        f, G = _smooth(np.einsum("n,nij->ij", w, each), criterion, power)
        by_weight = np.einsum("nij,ij->n", each, G)
        return f, w * (by_weight - w @ by_weight)

    options = [np.r_[np.zeros(len(PLAIN)), even]]
    for share in (little, 1.0 - little):
        x = np.log(np.r_[np.full(len(PLAIN), share / len(PLAIN)), (1.0 - share) * even])
        for power in _powers(criterion):
            x = minimize(slope, x, (power,), jac=True, method="L-BFGS-B",
                         options={"maxiter": 400, "ftol": 1e-13, "gtol": 1e-10}).x  # fmt: skip
        w = np.exp(x - x.max())
        options.append(w / w.sum())
    best = min(options, key=lambda w: value(np.einsum("n,nij->ij", w, each), criterion))
    return up, best


def _powers(criterion: str) -> tuple[float, ...]:
    return SHARPER if criterion == "condition" else SHARPER[:1]


def one_by_one(e: Experiment, n: int, criterion: str = "D") -> Array:
    """Paper 001's way: n poses (n, 3), the first with z up, parameters in their SI units."""
    up = np.vstack([[0.0, 0.0, 1.0], PLAIN, _spread(FINE)])
    J = e.jacobian(up)
    printed = J / e.scale
    chosen = [0]
    while len(chosen) < n:
        rows = printed[chosen].reshape(-1, len(e.scale))
        if np.linalg.matrix_rank(J[chosen].reshape(-1, len(e.scale))) < len(e.scale):
            score = efficiency_function(printed, rows)
        else:
            score = _added(J, J[chosen].reshape(-1, len(e.scale)), criterion)
        # of equals the first, as far as they are equal to rounding
        chosen.append(int(np.argmin(np.round(score, 9))))
    return up[chosen]


def efficiency_function(J: Array, rows: Array) -> Array:
    """How much of each pose's readings is known already, (q,), 0 to 1: the squared length of
    the projection of their rows J (q, m, k), each of length one, on the span of rows (r, k).

    Source: paper 001, equation 10, with rows of length one: long ones count no more.
    """
    length = np.linalg.norm(J, axis=2, keepdims=True)
    unit = J / np.where(length > 0.0, length, 1.0)
    U, s, _ = np.linalg.svd(rows.T / np.linalg.norm(rows, axis=1), full_matrices=False)
    span = U[:, s > 1e-9 * s[0]]
    counted = np.maximum((length[:, :, 0] > 0.0).sum(axis=1), 1)
    return np.asarray(((unit @ span) ** 2).sum(axis=(1, 2)) / counted)


def _added(J: Array, rows: Array, criterion: str) -> Array:
    """The criterion (q,) of the rows with each pose added."""
    M = rows.T @ rows
    more = M + np.einsum("nmi,nmj->nij", J, J)
    values = np.linalg.eigvalsh(more)
    if criterion == "D":
        return -np.asarray(np.log(values).sum(axis=1))
    if criterion == "A":
        return np.asarray(np.log((1.0 / values).sum(axis=1)))
    return np.asarray(np.log(values[:, -1] / values[:, 0]))


def _spread(n: int) -> Array:
    """Directions (n, 3) evenly over the sphere (a Fibonacci spiral)."""
    i = np.arange(n) + 0.5
    z, turn = 1.0 - 2.0 * i / n, np.pi * (1.0 + math.sqrt(5.0)) * i
    r = np.sqrt(1.0 - z**2)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)


def _turns_freely(e: Experiment, up: Array, criterion: str, rng: np.random.Generator) -> bool:
    """Whether the criterion is the same however a set is turned as a whole."""
    now = value(e.information(up), criterion)
    turns = so3.rotations(rng.standard_normal((3, 3)))
    return all(abs(value(e.information(up @ R.T), criterion) - now) < SAME for R in turns)
