"""Numbers as text, and matrices as the factors that formats ask for."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

import numpy as np

from handcal.types import Array, HandcalError

# Entries so small, as a part of the largest, are zero but for rounding.
ZERO = 1e-12
# (what numpy.linalg.inv returns is typed loosely)
AnyMatrix = np.ndarray[Any, np.dtype[Any]]


def one_line(text: str) -> str:
    """Somebody else's words in a file that is a program, or is read by one: on one line, which
    does not take the next one into a comment either (as C does, of a backslash at its end)."""
    line = "".join(c if c.isprintable() else "?" for c in text)
    return re.sub(r"(\\|\?\?/|\s)+$", "", line)


def number(value: float) -> str:
    """So many digits that reading it again gives the same number."""
    text = repr(float(value) + 0.0)  # (and no -0.0)
    # (YAML 1.1 takes 1e-05 for a word)
    return text if "." in text else text.replace("e", ".0e")


def row(values: Iterable[float], separator: str = ", ") -> str:
    """Numbers in a row."""
    return separator.join(number(v) for v in values)


def yaml_matrix(name: str, matrix: Array, indent: int) -> str:
    """A matrix as a list of rows."""
    space = " " * indent
    rows = "".join(f"{space}  - [{row(r)}]\n" for r in matrix)
    return f"{space}{name}:\n{rows}"


def lower_times_turn(matrix: AnyMatrix) -> tuple[Array, Array]:
    """L (3, 3) lower triangular with a positive diagonal, and a rotation C: ``L @ C``.

    Errors: HandcalError where there is none (a matrix that mirrors).
    """
    q, r = np.linalg.qr(matrix.T)
    return _cleaned(r.T, q.T, np.sign(np.diag(r)), columns=True)


def turn_times_upper(matrix: Array) -> tuple[Array, Array]:
    """A rotation C (3, 3), and U upper triangular with a positive diagonal: ``C @ U``.

    Errors: as ``lower_times_turn``.
    """
    q, r = np.linalg.qr(matrix)
    upper, turn = _cleaned(r, q, np.sign(np.diag(r)), columns=False)
    return turn, upper


def _cleaned(triangle: Array, turn: Array, sign: Array, columns: bool) -> tuple[Array, Array]:
    if columns:
        triangle, turn = triangle * sign, sign[:, None] * turn
    else:
        triangle, turn = sign[:, None] * triangle, turn * sign
    if not np.linalg.det(turn) > 0.0:
        raise HandcalError("The matrix of scale and misalignment mirrors; no sensor does.")
    small = np.abs(triangle) < ZERO * np.abs(triangle).max()
    return np.where(small, 0.0, triangle), turn


def lower_accel(accel: AnyMatrix, program: str) -> Array:
    """The accelerometer's matrix (3, 3) for a program that wants it lower triangular.

    Errors: HandcalError where it is not.
    """
    if np.abs(np.triu(accel, 1)).max() > ZERO * np.abs(accel).max():
        raise HandcalError(
            f"{program} takes the accelerometer's x axis for that of the body, and its y axis for "
            "one in the body's x-y plane; an effect here turns the accelerometer against that. "
            "Use --to python or --to c, or `handcal apply`."
        )
    return np.tril(accel)
