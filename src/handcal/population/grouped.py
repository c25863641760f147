"""Recordings to devices: what stays with a device is one number for all of its recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handcal.types import Array, IntArray


@dataclass(frozen=True)
class Devices:
    """Of d devices: value (d,), sigma (d,), count (d,) recordings, and chi2 (d,) of these about
    the device's mean (count - 1 degrees of freedom). owner (n,): which device each recording is
    of; log_within: log-likelihood of the recordings about their devices' means, nats."""

    value: Array
    sigma: Array
    count: IntArray
    chi2: Array
    owner: IntArray
    log_within: float


def owners(names: Sequence[str]) -> IntArray:
    """A number for each device (n,), from 0; a name that is "" is a device of its own."""
    at: dict[object, int] = {}
    return np.array(
        [at.setdefault(n or (i,), len(at)) for i, n in enumerate(names)], dtype=np.int64
    )


def telling(value: Array, sigma: Array, owner: IntArray) -> tuple[Array, Array, IntArray]:
    """Values, sigmas and owners of those recordings that tell (both are finite), the owners'
    numbers from 0 on."""
    there = np.isfinite(value) & np.isfinite(sigma)
    own = np.unique(owner[there], return_inverse=True)[1].astype(np.int64)
    return value[there], sigma[there], own


def devices(value: Array, sigma: Array, owner: IntArray, apart: float = 0.0) -> Devices:
    """value (n,), sigma (n,), owner (n,) of recordings; apart: by how much a device differs from
    one switching on to the next (standard deviation)."""
    count = np.bincount(owner).astype(np.int64)
    w = 1.0 / (sigma**2 + apart**2)
    total = np.bincount(owner, w)
    mean = np.bincount(owner, w * value) / total
    off = w * (value - mean[owner]) ** 2
    # each recording's normal density, over that of the device's mean at its own place
    log = -0.5 * (off + np.log(2.0 * np.pi / w)).sum() + 0.5 * np.log(2.0 * np.pi / total).sum()
    deviation, chi2 = np.asarray(total**-0.5), np.asarray(np.bincount(owner, off), dtype=np.float64)
    return Devices(np.asarray(mean), deviation, count, chi2, owner, float(log))
