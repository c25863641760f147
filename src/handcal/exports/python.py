"""Python: one function without dependencies, for readings as they come.

``corrected((wx, wy, wz), (ax, ay, az))`` gives rate and force as handcal has them: rad/s and m/s^2
on the recording's axes, what is read too much taken off.
"""

from __future__ import annotations

from handcal.exports import Contents, Format
from handcal.exports._text import row
from handcal.types import Array

FUNCTION = '''

def _turned(matrix, v):
    return tuple(sum(m * x for m, x in zip(row, v)) for row in matrix)


def corrected(gyro, accel):
    """Rate (rad/s) and force (m/s^2) of one reading of each, three numbers in SI."""
    force = _turned(ACCEL, [a - b for a, b in zip(accel, ACCEL_BIAS)])
    felt = _turned(G_SENSITIVITY, force)
    rate = _turned(GYRO, [w - b - g for w, b, g in zip(gyro, GYRO_BIAS, felt)])
    return rate, force
'''


def _matrix(matrix: Array) -> str:
    return "(" + ", ".join(f"({row(r)})" for r in matrix) + ")"


def write(contents: Contents) -> str:
    """The module."""
    c = contents.correction
    constants = (
        f"GYRO_BIAS = ({row(c.gyro_bias)})\n"
        f"ACCEL_BIAS = ({row(c.accel_bias)})\n"
        f"GYRO = {_matrix(c.gyro)}\n"
        f"ACCEL = {_matrix(c.accel)}\n"
        f"G_SENSITIVITY = {_matrix(c.g_sensitivity)}\n"
    )
    return f"{contents.commented()}{constants}{FUNCTION}"


FORMAT = Format(
    program="Python",
    line="Python: a function of twenty lines without dependencies",
    write=write,
    notes=("Signs: force = ACCEL (a - ACCEL_BIAS); rate = GYRO (w - GYRO_BIAS - G_SENSITIVITY "
           "force)",),
)  # fmt: skip
