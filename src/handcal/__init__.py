"""handcal calibrates cheap inertial sensors while somebody turns them in the hand.

Conventions, decided once (everything else in the package relies on them):

- Navigation frame ``n``: local level, ENU, z up. Body frame ``b``: the IMU's own
  axes (phone: x right, y up, z out of the screen).
- ``C_nb`` takes body vectors to navigation; ``q_nb`` is the same as a quaternion
  w x y z. ``omega_ib_b``: rate of b against inertial space, in b. ``f_b``: specific
  force in b; at rest it reads +g on the axis that points up.
- Attitude error ``psi`` is a rotation vector in n: ``C_nb = exp([psi x]) C_nb_estimated``.
  Every error is true minus estimated.
- Heading (yaw) is ``atan2(C_nb[1, 0], C_nb[0, 0])``: of body x, counter-clockwise
  from east, rad, in (-pi, pi].
- A sensor reads truth plus error: ``gyro_reading = omega_ib_b + error``.
- A sample is the value at its stamp. The gyro's stamps define time; a delay is
  signed: the reading at t is the value at ``t - delay``.
- SI inside (m, s, rad, tesla; degC for temperature); other units only at the edges,
  and named (``_deg``, ``_mg``). Gravity is 9.80665 m/s^2 and the Earth does not turn
  unless a latitude is given.
- Book letters: P covariance, Q process noise, R observation noise, H observation
  matrix, Phi transition.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"
__all__ = ["calibrate", "load"]

if TYPE_CHECKING:
    from handcal.estimate.calibration import calibrate
    from handcal.recordings.inputs import load


def __getattr__(name: str) -> Any:
    """Import the heavy parts when first used, so that ``handcal --help`` is instant."""
    if name == "load":
        from handcal.recordings.inputs import load

        return load
    if name == "calibrate":
        from handcal.estimate.calibration import calibrate

        return calibrate
    raise AttributeError(f"module 'handcal' has no attribute {name!r}")
