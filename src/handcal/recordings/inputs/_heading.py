"""Does a heading count as it is said to? It turns no faster than the device, and the way that the
gyro turns about the vertical."""

from __future__ import annotations

import numpy as np

from handcal.types import Array, InputError

# A heading that was unwrapped may be many turns, rad, but no faster than the gyro by this factor,
# from one second to the next; degrees are 57 times as many.
FEW_TURNS, HEADING_FASTER = 6.0 * np.pi, 5.0
# Between two looks, s; and the share of gravity that has to stand across body x, or its yaw turns
# faster than the device.
HEADING_S, LEVEL = 0.5, 0.5
# Looks in which it should have turned so far, rad (a compass that swings turns by less), and how
# many are enough; what is missed as read, rad, and what the other sense may leave of it.
TURNED, FEWEST, MISSED, CLEARLY = 0.2, 20, 0.15, 0.25


def check_heading_unit(t: Array, gyro: Array, when: Array, heading: Array) -> None:
    """A heading must not turn faster than the device. t (n,) s, gyro (n, 3) rad/s; heading (m,)
    as rad at when (m,) s, same clock. Errors: InputError where it seems to be in degrees."""
    usable = (when >= t[0]) & (when <= t[-1]) & (np.abs(heading) < 1e7)
    when, heading = when[usable], heading[usable]
    most = float(np.quantile(np.abs(heading), 0.9)) if len(heading) else 0.0
    if most <= FEW_TURNS:
        return
    rate = np.linalg.norm(gyro, axis=1)
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))])
    _, seconds = np.unique(np.floor(when), return_index=True)
    own = float(np.abs(np.diff(heading[seconds])).sum())
    device = float(np.diff(np.interp(when[seconds], t, turned)).sum())
    if own > HEADING_FASTER * device or most > FEW_TURNS + 2.0 * float(turned[-1]):
        raise InputError(
            f"The heading is in degrees? It reads up to {np.abs(heading).max():.0f} rad and turns "
            f"by {own:.0f} rad where the gyroscope turns by {device:.0f}; if so, give "
            "--units heading=deg."
        )


def check_heading_sense(t: Array, gyro: Array, accel: Array, when: Array, heading: Array) -> None:
    """heading (m,), rad, at when (m,), s, on the clock of t (n,). Errors: InputError where it turns
    the other way than the gyro about the vertical."""
    inside = (when >= t[0]) & (when <= t[-1]) & (np.abs(heading) < 1e7)
    first = np.flatnonzero(np.diff(np.floor(when[inside] / HEADING_S), prepend=-1.0))
    at, psi = when[inside][first], heading[inside][first]
    if len(at) < FEWEST:
        return
    up = accel / np.maximum(np.linalg.norm(accel, axis=1, keepdims=True), 1e-9)
    across = 1.0 - up[:, 0] ** 2
    rate = (gyro[:, 1] * up[:, 1] + gyro[:, 2] * up[:, 2]) / np.maximum(across, LEVEL**2)
    whole = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t))])
    steep = np.concatenate([[0.0], np.cumsum((across[1:] < LEVEL**2) * np.diff(t))])
    own = np.diff(np.interp(at, t, whole))
    fair = (np.diff(np.interp(at, t, steep)) == 0) & (np.abs(own) > TURNED) & (np.diff(at) < 1.0)
    if fair.sum() < FEWEST:
        return
    as_read, reversed_ = (
        float(np.median(np.abs(np.angle(np.exp(1j * (s * np.diff(psi) - own)))[fair])))
        for s in (1.0, -1.0)
    )
    if as_read > MISSED and reversed_ < CLEARLY * as_read:
        raise InputError(
            f"The heading turns against the gyroscope ({np.degrees(as_read):.0f} deg off after "
            f"{HEADING_S:g} s; with its sign turned {np.degrees(reversed_):.1f}): it counts "
            "clockwise, as a compass does, and here counter-clockwise is meant. Turn its sign in "
            "the file; of a table give --units heading=deg-cw or rad-cw."
        )
