"""Do two recordings of one device tell the same of it?

    python benchmarks/real_pairs.py [--shared DIR] [--json OUT]

Each recording is calibrated alone. What each says of the device without any prior (``likelihood``
of the result) is taken beside the usual sizes, the common prior counted once: the difference of
the two means over the covariance of the difference, as chi-square per degree of freedom. A
direction counts by how much of it both recordings show. Biases are compared where both were made
on one day and at one temperature.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

import handcal
from handcal.device.file import kept, told_of, usual_of
from handcal.estimate.start import BIASES
from handcal.types import Array, Likelihood

# Recordings of one device; the last says whether they are of one day.
DEVICES = (
    (("devices/android_fullyaw", "devices/android_fullpitch"), True),
    (("devices/phone_oscillations1", "devices/phone_oscillations3"), False),
    (("array_1_imu5", "devices/array_6_imu5"), False),
    (
        (
            "broad_01_slow_rotation", "broad_04_slow_rotation_breaks", "broad_06_fast_rotation",
            "devices/broad_07", "broad_08_fast_rotation_breaks", "broad_10_slow_translation",
        ),
        False,
    ),
)  # fmt: skip
# What is another in every hand or at every marker.
OF_THE_OCCASION = ("lever_arm",)


@dataclass(frozen=True)
class Pair:
    """Two recordings, the chi-square of their difference, and how many directions both show."""

    first: str
    second: str
    chi2: float
    dof: float


def compared(a: Likelihood, b: Likelihood, biases: bool) -> tuple[float, float]:
    """Chi-square of the difference and its degrees of freedom.

    In units of the usual sizes each recording's posterior mean is (I + L)^-1 h; of one truth drawn
    from the prior the difference of two has a covariance of which the eigenvalues say how much
    both show of a direction.
    """
    names = [n for n in a.names if n in b.names and kept(n) and n[0] not in OF_THE_OCCASION]
    names = [n for n in names if biases or n not in BIASES]
    usual = usual_of(names)
    units = np.outer(usual, usual)
    (L1, h1), (L2, h2) = ((L * units, h * usual) for L, h in (told_of(x, names) for x in (a, b)))
    # (m = W x + noise of covariance W - W W', with W = (I + L)^-1 L = I - P)
    (P1, N1, m1), (P2, N2, m2) = _posterior(L1, h1), _posterior(L2, h2)
    C = N1 + N2 + (P1 - P2) @ (P1 - P2).T
    W1, W2 = np.eye(len(names)) - P1, np.eye(len(names)) - P2
    values, vectors = np.linalg.eigh(0.5 * (C + C.T))
    z = vectors.T @ (m1 - m2)
    both = np.clip(np.einsum("ik,ij,jk->k", vectors, W1 @ W2, vectors), 0.0, 1.0)
    seen = values > 1e-14
    return float((both * z**2 / np.where(seen, values, 1.0))[seen].sum()), float(both[seen].sum())


def _posterior(L: Array, h: Array) -> tuple[Array, Array, Array]:
    """Covariance, that of the mean about its expectation, and the mean, beside a prior of one."""
    values, V = np.linalg.eigh(0.5 * (L + L.T))
    values = np.maximum(values, 0.0)
    return (
        (V / (1.0 + values)) @ V.T,
        (V * (values / (1.0 + values) ** 2)) @ V.T,
        V @ ((V.T @ h) / (1.0 + values)),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    root = Path(__file__).resolve().parents[2]
    parser.add_argument("--shared", type=Path, default=root / "shared")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    pairs = []
    for names, one_day in DEVICES:
        said = {}
        for name in names:
            file = options.shared / "recordings" / f"{name}.mcap"
            said[Path(name).name] = handcal.calibrate(str(file)).likelihood
        for (first, a), (second, b) in combinations(said.items(), 2):
            pairs.append(Pair(first, second, *compared(a, b, one_day)))
            p = pairs[-1]
            print(f"{first:30} {second:30} chi2 {p.chi2:9.1f}  of {p.dof:5.1f}", flush=True)
    total, dof = sum(p.chi2 for p in pairs), sum(p.dof for p in pairs)
    print(f"all: {total / dof:.2f} per degree of freedom (asked: at most 1.5), {dof:.0f} of them")
    if options.json:
        options.json.write_text(json.dumps([vars(p) for p in pairs], indent=1) + "\n")


if __name__ == "__main__":
    main()
