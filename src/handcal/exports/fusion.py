"""xio Fusion: misalignment, sensitivity and offset for C, the numbers for Python in the comments.

Fusion corrects a reading (github.com/xioTechnologies/Fusion, README, "Sensor calibration";
FusionModel.h, FusionModelInertial; ``imufusion.model_inertial`` in Python):

    calibrated = misalignment (sensitivity * (uncalibrated - offset))

sensitivity axis by axis. The sensitivity here is the diagonal of handcal's matrix, so that of the
misalignment is one. Fusion computes in single precision, and its AHRS wants degrees per second and
g: the numbers hold for SI readings, to be converted behind the correction.
"""

from __future__ import annotations

import numpy as np

from handcal.exports import Contents, Format
from handcal.exports._correction import Correction
from handcal.exports._text import row
from handcal.types import Array


def keep(correction: Correction) -> Correction:
    """All but the gyro's reading of forces."""
    c = correction
    return Correction(c.gyro_bias, c.accel_bias, c.gyro, c.accel, np.zeros((3, 3)))


def _sensor(name: str, title: str, matrix: Array, offset: Array) -> str:
    scale = np.diag(matrix)
    rows = ", ".join(f"{{{', '.join(f'{v:.9e}f' for v in r)}}}" for r in matrix / scale)
    return (
        f"static const FusionMatrix {name}Misalignment = {{.array = {{{rows}}}}};\n"
        f"static const FusionVector {name}Sensitivity = {{.array = {{{_floats(scale)}}}}};\n"
        f"static const FusionVector {name}Offset = {{.array = {{{_floats(offset)}}}}};\n"
        f"// imufusion.model_inertial({title}, {name}_misalignment, {name}_sensitivity, "
        f"{name}_offset)\n"
        f"// {name}_misalignment = numpy.array([[{'], ['.join(row(r) for r in matrix / scale)}]])\n"
        f"// {name}_sensitivity = numpy.array([{row(scale)}])\n"
        f"// {name}_offset = numpy.array([{row(offset)}])\n"
    )


def _floats(values: Array) -> str:
    return ", ".join(f"{v:.9e}f" for v in values)


def write(contents: Contents) -> str:
    """The header."""
    c = contents.correction
    return (
        f"{contents.commented('// ')}#ifndef HANDCAL_FUSION_H\n#define HANDCAL_FUSION_H\n"
        f'#include "FusionModel.h"\n\n{_sensor("gyroscope", "gyro", c.gyro, c.gyro_bias)}\n'
        f"{_sensor('accelerometer', 'accel', c.accel, c.accel_bias)}#endif\n"
    )


FORMAT = Format(
    program="xio Fusion",
    line="xio Fusion: misalignment, sensitivity and offset, for C and Python",
    write=write,
    keep=keep,
    notes=("Signs: calibrated = misalignment (sensitivity * (reading - offset)); readings in SI",),
)
