"""GTSAM: one Gauss-Newton iteration of its batch smoother, a pose and velocity at each epoch.

    python gtsam_smoother.py DATA.npz EVERY

An epoch is every EVERY-th IMU sample, with the position, the velocity and the heading that
handcal observes there; the readings in between are preintegrated beforehand, which is not
measured. The biases are one variable. Measured is what is done again and again: linearise,
solve, move. Covariances are not asked for.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from _serve import missing, serve

try:
    import gtsam
    from gtsam.symbol_shorthand import B, V, X
except ImportError:
    missing("gtsam")

TILT_UNKNOWN = 1e3


def graph_of(data: Any, every: int) -> tuple[Any, Any, int]:
    """Factors, initial values and the number of epochs."""
    t, gyro, accel, yaw = data["t"], data["gyro"], data["accel"], data["yaw"]
    epochs = np.arange(0, len(t), every)
    settings = gtsam.PreintegrationParams.MakeSharedU(9.80665)
    settings.setGyroscopeCovariance(float(data["gyro_noise"]) ** 2 * np.eye(3))
    settings.setAccelerometerCovariance(float(data["accel_noise"]) ** 2 * np.eye(3))
    settings.setIntegrationCovariance(1e-12 * np.eye(3))
    bias = gtsam.imuBias.ConstantBias()
    sigmas = gtsam.noiseModel.Diagonal.Sigmas
    place = np.full(3, float(data["position_noise"]))
    seen = sigmas(np.r_[TILT_UNKNOWN, TILT_UNKNOWN, float(data["heading_noise"]), place])
    level = sigmas(np.r_[0.02, 0.02, float(data["heading_noise"]), place])
    still = sigmas(np.full(3, float(data["velocity_noise"])))
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.PriorFactorConstantBias(
        B(0), bias, sigmas(np.r_[np.full(3, 0.6), np.full(3, np.radians(1.0))])
    ))  # fmt: skip
    values.insert(B(0), bias)
    for j, i in enumerate(epochs):
        pose = gtsam.Pose3(gtsam.Rot3.Rz(float(yaw[i])), np.zeros(3))
        graph.add(gtsam.PriorFactorPose3(X(j), pose, seen if j else level))
        graph.add(gtsam.PriorFactorVector(V(j), np.zeros(3), still))
        values.insert(X(j), pose)
        values.insert(V(j), np.zeros(3))
        if j:
            between = gtsam.PreintegratedImuMeasurements(settings, bias)
            for k in range(epochs[j - 1] + 1, i + 1):
                between.integrateMeasurement(accel[k], gyro[k], float(t[k] - t[k - 1]))
            graph.add(gtsam.ImuFactor(X(j - 1), V(j - 1), X(j), V(j), B(0), between))
    return graph, values, len(epochs)


def main() -> None:
    graph, values, epochs = graph_of(np.load(sys.argv[1]), int(sys.argv[2]))
    ordering = gtsam.Ordering.ColamdGaussianFactorGraph(graph.linearize(values))

    def work() -> int:
        values.retract(graph.linearize(values).optimize(ordering))
        return epochs

    serve("GTSAM", work)


if __name__ == "__main__":
    main()
