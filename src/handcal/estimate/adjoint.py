"""The slope of the evidence by every variance there is, and by how Markov states move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handcal.compiled.reduced_adjoint import BackwardWork, reduced_backward
from handcal.compiled.rows import blank, padded
from handcal.compiled.sparse import no_entries
from handcal.estimate.evidence import ReducedPass, kept
from handcal.types import Array, IntArray


@dataclass(frozen=True)
class Slopes:
    """Derivatives of the log-evidence: by R (s,) of each scalar, by the two densities
    squared (2,), by Q_e (k, e, e), by the prior of the moving states (m, m); by Phi_psi and Phi_e
    (k, e, 3 + e) and by d_e (k, e), or empty."""

    R: Array
    densities: Array
    Q_e: Array
    prior: Array
    step: Array
    d_e: Array


def backward(
    done: ReducedPass,
    score: bool,
    r_kept: Array,
    N_kept: Array,
    spread: bool = True,
    rows: IntArray | None = None,
    steps: bool = False,
) -> Slopes:
    """Adjoint of ``reduced_pass``; r_kept (k, m, columns), N_kept (k, m, m) may be empty, and hold
    the epochs of ``rows``, or all.

    score: with the derivatives; spread: r has columns for the uncertainty of the constants,
    besides the one for their mean. steps: with the derivatives by how Markov states move; then the
    pass was kept whole.
    """
    linear, (s, m) = done.reduction.linear, done.gain.shape
    columns = 1 + len(done.w) if spread else 1
    # (rows of whole blocks of eight: zeros beyond what is wanted)
    width, high = padded(columns) if spread else 1, padded(m)
    given = blank(1 + len(done.w), width)
    given[0, 0] = 1.0
    given[1:, 0] = done.w
    given[1:, 1:columns] = done.spread[:, : columns - 1]
    k, e = len(linear.t), done.arrays.Phi_e.shape[1]
    slopes = Slopes(
        np.zeros(s), np.zeros(2), np.zeros((k, e, e)), np.zeros((m, m)),
        np.zeros((k if steps else 0, e, 3 + e)), np.zeros((k if steps else 0, e)),
    )  # fmt: skip
    most = int(np.diff(done.arrays.first).max(initial=0))
    work, moves = _backward_work(m, width, most), _steps_work(m, e, width)
    reduced_backward(
        done.arrays,
        done.gain,
        done.nu,
        done.S,
        given,
        (linear.Q_gyro, linear.Q_accel),
        blank(m, width),
        blank(m, high) if score else blank(0, 0),
        (r_kept, N_kept),
        (slopes.R, slopes.densities, slopes.Q_e, slopes.prior),
        work,
        kept(k, rows),
        (slopes.step, slopes.d_e),
        (done.X, done.P),
        moves,
    )
    return slopes


def _backward_work(m: int, width: int, most: int) -> BackwardWork:
    """Work space of ``reduced_backward``; most: scalars that an epoch holds."""
    high = padded(m)
    return BackwardWork(
        no_entries(m, most), no_entries(m), blank(m, width), blank(width, high), blank(m, high),
        blank(m, high), blank(most, width), blank(most, m), blank(m, most), blank(1, high),
        blank(high), blank(high),
    )  # fmt: skip


def _steps_work(m: int, e: int, width: int) -> tuple[Array, Array, Array, Array, Array]:
    """Work space of ``reduced_backward`` for how Markov states move."""
    away = e + (3 if m > e else 0)
    wide = padded(away)
    return (
        blank(away, width), blank(width, wide), blank(m, m), blank(m, wide), blank(e, wide),
    )  # fmt: skip
