"""What a reading of the reference holds, place by place: z of the observation ``known_input``.

The observation writes it and effects on that observation read it, all by these names.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from handcal.effects import Z_DIM
from handcal.types import Array

# Where each part of z begins (integers, as compiled functions read them), beyond what every kind
# has.
NOW, SLOPE, BEFORE, AFTER, SLOPE_BEFORE, SLOPE_AFTER, REACH = (Z_DIM + 6 * k for k in range(7))
GYRO_LEFT, ACCEL_LEFT, END = REACH + 1, REACH + 2, REACH + 8
PLACES = (NOW, SLOPE, BEFORE, AFTER, SLOPE_BEFORE, SLOPE_AFTER, REACH, GYRO_LEFT, ACCEL_LEFT)


class ReferenceRows(NamedTuple):
    """Readings of the reference at q times, rate and force in the IMU's axes, SI.

    now, slope (q, 6): they and their derivatives, for its lateness. before, after, slope_before,
    slope_after (q, 6): the same at moments ``reach`` (q, 1) seconds earlier and later, a time that
    grows with the recording, for a clock that runs fast. gyro_left (q, 1), accel_left (q, 6): how
    uncertain the biases are: of the gyro's one number, of the accelerometer's a lower triangular
    matrix, row by row.
    """

    now: Array
    slope: Array
    before: Array
    after: Array
    slope_before: Array
    slope_after: Array
    reach: Array
    gyro_left: Array
    accel_left: Array

    def joined(self) -> Array:
        """As z (q, END), each part in its place. Raises ValueError where one does not fit there."""
        out = np.zeros((len(self.now), END))
        for first, last, part in zip(PLACES, (*PLACES[1:], END), self, strict=True):
            out[:, first:last] = part
        return out
