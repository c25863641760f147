"""What the noise levels make of a linearised problem: its process noise, at these levels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from handcal.compiled import so3
from handcal.estimate.linear import Linear
from handcal.estimate.problem import Problem, markov_transitions
from handcal.types import Array


@dataclass(frozen=True)
class Driven:
    """What the noise levels make of a linearised problem: Q (k, v, v) of the navigation
    errors; B (k, v, e): how they depend on Markov
    states; Phi_e, Q_e (k, e, e), d_e (k, e), Phi_psi (k, e, 3) of the Markov states."""

    Q: Array
    B: Array
    Phi_e: Array
    Q_e: Array
    d_e: Array
    Phi_psi: Array


def driven(linear: Linear, levels: Mapping[str, float], v: int = 9) -> Driven:
    """The intervals' noise at these levels; v: of so many errors of the navigation, 9 or 0."""
    problem = linear.problem
    Phi_e, Q_e = markov_transitions(problem, levels, linear.t, linear.rate)
    d_e, Phi_psi = _markov_steps(problem, linear.trajectory.markov[: len(linear.t)], Phi_e)
    Q = (
        levels["gyro_noise"] ** 2 * linear.Q_gyro[:, :v, :v]
        + levels["accel_noise"] ** 2 * linear.Q_accel[:, :v, :v]
        + linear.Q_extra[:, :v, :v]
    )
    B = np.zeros((len(linear.t), v, problem.markov_size if problem.walks else 0))
    for state, column in problem.walks:
        B[:, :, state : state + 3] = linear.Phi[:, :v, 9 + column : 12 + column]
    return Driven(Q, B, Phi_e, Q_e, d_e, Phi_psi)


def _markov_steps(problem: Problem, markov: Array, Phi_e: Array) -> tuple[Array, Array]:
    """Steps d_e (k, e) predicted minus nominal of the Markov states, and Phi_psi (k, e, 3).

    The noise that drives a vector such as the hand's sway has no preferred direction, so
    an error of attitude turns what the trajectory says of it: with it, a heading that
    nothing observes stays unobserved. (Without, the noise's own directions would seem to
    be known, and the heading with them.)
    """
    d_e = np.zeros_like(markov)
    d_e[1:] = np.einsum("kij,kj->ki", Phi_e[1:], markov[:-1]) - markov[1:]
    Phi_psi = np.zeros((*markov.shape, 3))
    at = 0
    for kept in problem.markovs:
        for i in range(at, at + 3 * kept.vectors, 3):
            Phi_psi[:, i : i + 3] = so3.skew(d_e[:, i : i + 3])
        at += kept.size
    return d_e, Phi_psi
