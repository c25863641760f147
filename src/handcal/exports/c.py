"""C: a header of one function without dependencies, C99 and C++.

``handcal_correct(gyro, accel, rate, force)`` takes readings in rad/s and m/s^2 on the recording's
axes and gives what handcal makes of them. In and out may be the same arrays.
"""

from __future__ import annotations

from handcal.exports import Contents, Format
from handcal.exports._text import row
from handcal.types import Array

FUNCTION = """
static inline void handcal_correct(const double gyro[3], const double accel[3], double rate[3],
                                   double force[3]) {
    double f[3], w[3], u[3], v[3];
    int i, j;
    for (i = 0; i < 3; i++) u[i] = accel[i] - HANDCAL_ACCEL_BIAS[i];
    for (i = 0; i < 3; i++)
        for (f[i] = 0.0, j = 0; j < 3; j++) f[i] += HANDCAL_ACCEL[i][j] * u[j];
    for (i = 0; i < 3; i++)
        for (v[i] = gyro[i] - HANDCAL_GYRO_BIAS[i], j = 0; j < 3; j++)
            v[i] -= HANDCAL_G_SENSITIVITY[i][j] * f[j];
    for (i = 0; i < 3; i++)
        for (w[i] = 0.0, j = 0; j < 3; j++) w[i] += HANDCAL_GYRO[i][j] * v[j];
    for (i = 0; i < 3; i++) { rate[i] = w[i]; force[i] = f[i]; }
}
#endif
"""


def _matrix(name: str, matrix: Array) -> str:
    rows = ",\n    ".join("{" + row(r) + "}" for r in matrix)
    return f"static const double {name}[3][3] = {{\n    {rows}}};\n"


def write(contents: Contents) -> str:
    """The header."""
    c = contents.correction
    return (
        f"{contents.commented('// ')}#ifndef HANDCAL_CORRECT_H\n#define HANDCAL_CORRECT_H\n\n"
        f"static const double HANDCAL_GYRO_BIAS[3] = {{{row(c.gyro_bias)}}};\n"
        f"static const double HANDCAL_ACCEL_BIAS[3] = {{{row(c.accel_bias)}}};\n"
        f"{_matrix('HANDCAL_GYRO', c.gyro)}{_matrix('HANDCAL_ACCEL', c.accel)}"
        f"{_matrix('HANDCAL_G_SENSITIVITY', c.g_sensitivity)}{FUNCTION}"
    )


FORMAT = Format(
    program="C",
    line="C: a header of one function without dependencies",
    write=write,
    notes=("Signs: force = ACCEL (a - ACCEL_BIAS); rate = GYRO (w - GYRO_BIAS - G_SENSITIVITY "
           "force)",),
)  # fmt: skip
