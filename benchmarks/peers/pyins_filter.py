"""pyins: its feedback filter with 15 states, position and velocity at every IMU sample.

    python pyins_filter.py DATA.npz

The same readings as handcal's, in pyins' frames (north, east, down; body z down), and without
heading, which pyins would need a class of its own for: that is in its favour.
"""

from __future__ import annotations

import sys

import numpy as np
from _serve import missing, serve

try:
    import pandas as pd
    from pyins import filters, inertial_sensor, measurements, strapdown
    from pyins.util import TRAJECTORY_COLS
except ImportError:
    missing("python-ins")

SAMPLES = 300
DOWN = np.array([1.0, -1.0, -1.0])


def main() -> None:
    data = np.load(sys.argv[1])
    t = data["t"][:SAMPLES]
    readings = np.hstack([data["gyro"][:SAMPLES] * DOWN, data["accel"][:SAMPLES] * DOWN])
    names = [f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz"]
    increments = strapdown.compute_increments_from_imu(
        pd.DataFrame(readings, index=t, columns=names), "rate"
    )
    heading = 90.0 - np.degrees(data["yaw"][0])
    pva = pd.Series([45.0, 10.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, heading], TRAJECTORY_COLS, name=t[0])
    place = pd.DataFrame(np.tile([45.0, 10.0, 0.0], (len(t), 1)), t, ["lat", "lon", "alt"])
    still = pd.DataFrame(np.zeros((len(t), 3)), t, ["VN", "VE", "VD"])
    sigma = float(data["position_noise"]), float(data["velocity_noise"])

    def work() -> int:
        filters.run_feedback_filter(
            pva, 1.0, 0.1, 1.0, 1.0, increments,
            inertial_sensor.EstimationModel(np.radians(1.0), float(data["gyro_noise"])),
            inertial_sensor.EstimationModel(0.6, float(data["accel_noise"])),
            [measurements.Position(place, sigma[0]), measurements.NedVelocity(still, sigma[1])],
            time_step=1.0,
        )  # fmt: skip
        return len(t) - 1

    serve("pyins", work)


if __name__ == "__main__":
    main()
