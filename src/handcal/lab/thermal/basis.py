"""Functions of temperature from which a curve is put together: polynomials and splines.

All are made for a span of temperatures: the first is one, the second rises by one over half the
span, and the others are independent of both, as large as one or less. So one prior serves all.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from scipy.interpolate import CubicSpline

from handcal.types import Array

HIGHEST, MOST_KNOTS = 5, 5
GRID = 401


@dataclass(frozen=True)
class Basis:
    """kind "polynomial" of a degree, or "spline" (natural, cubic) with so many inner knots,
    evenly over the span low to high, degC."""

    kind: Literal["polynomial", "spline"]
    degree: int
    low: float
    high: float

    @property
    def size(self) -> int:
        """Number of functions."""
        return self.degree + (1 if self.kind == "polynomial" else 2)

    @property
    def title(self) -> str:
        """In words."""
        if self.kind == "spline":
            return f"spline with {self.degree} inner knot{'s' if self.degree > 1 else ''}"
        names = ("constant", "straight line", "parabola", "cubic")
        return names[self.degree] if self.degree < 4 else f"polynomial of degree {self.degree}"

    @property
    def knots(self) -> Array:
        """Temperatures, degC, whose values give the whole curve: of a spline its knots, of a
        polynomial as many as it has coefficients."""
        n = self.size
        return np.linspace(self.low, self.high, n) if n > 1 else np.array([self.middle])

    @property
    def middle(self) -> float:
        """Of the span, degC."""
        return 0.5 * (self.low + self.high)

    def values(self, T: Array) -> Array:
        """The functions (n, size) at temperatures T (n,), degC."""
        tau = (np.asarray(T) - self.middle) / max(0.5 * (self.high - self.low), 1e-9)
        if self.kind == "polynomial":
            return np.asarray(np.polynomial.legendre.legvander(tau, self.degree))
        return np.column_stack([np.ones_like(tau), tau, _bends(self.degree, tau)])


def _bends(inner: int, tau: Array) -> Array:
    """What natural splines with so many inner knots can do beyond a straight line, (n, inner)."""
    cardinal, mixed = _mixed(inner)
    inside = np.clip(tau, -1.0, 1.0)
    over = (tau - inside)[:, None]
    return np.asarray((cardinal(inside) + over * cardinal(inside, 1)) @ mixed)


@cache
def _mixed(inner: int) -> tuple[CubicSpline, Array]:
    """Cardinal splines, and how they are mixed so that each bend is orthogonal to straight lines
    and to the others, and one at most."""
    at = np.linspace(-1.0, 1.0, inner + 2)
    cardinal = CubicSpline(at, np.eye(inner + 2), bc_type="natural")
    grid = np.linspace(-1.0, 1.0, GRID)
    V = cardinal(grid)
    line, _ = np.linalg.qr(np.column_stack([np.ones(GRID), grid]))
    # which mixtures are orthogonal to straight lines
    _, _, Vt = np.linalg.svd(line.T @ V)
    free = Vt[2:].T
    _, _, order = np.linalg.svd(V @ free, full_matrices=False)
    mixed = free @ order.T
    return cardinal, mixed / np.abs(V @ mixed).max(axis=0)


def candidates(low: float, high: float, temperatures: int) -> tuple[Basis, ...]:
    """What may be tried for a span: fewer functions than there are different temperatures."""
    most = max(1, temperatures - 1)
    out = [Basis("polynomial", k, low, high) for k in range(HIGHEST + 1)]
    out += [Basis("spline", m, low, high) for m in range(1, MOST_KNOTS + 1)]
    return tuple(b for b in out if b.size <= most)
