"""Terms of a measured heading that nobody named: functions of the attitude and of time.

Each term is an effect of one parameter: the heading reads k times a signal in addition. What
the catalogue covers is left out, so that a term found here has no name.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from handcal import so3
from handcal._jit import residual_function
from handcal.effects import TIME, Z_DIM, Effect, Param, catalogue, observed_error
from handcal.explain.laws import PROBED, basis, spanned
from handcal.signals import probe
from handcal.types import Recording

# Root mean square of what a term adds, one prior sigma, rad.
HEADING_SIZE = 0.1


def again(formula: str, prior: float) -> Effect:
    """The term that was found before by its formula, with its prior (SI).

    Raises KeyError for a formula that there is none of.
    """
    address, unit = _HEADING[formula.removeprefix("heading += k * ")]
    return term(formula, unit, prior, observation_error={"heading": address})


def term(
    formula: str, unit: str, prior: float, story: str = "", positive: bool = False, **physics: Any
) -> Effect:
    """An effect of one parameter k without a name but its formula; prior: sigma of k; story: what
    that means in plain words, if it can be said."""
    return Effect(
        id=formula,
        title=formula,
        parameters=(Param("k", unit, prior, positive),),
        story=story,
        source="found in this recording",
        motion="The motion in which it was found.",
        validated="held-out data alone",
        **physics,
    )


def _sin3(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    yaw = np.arctan2(nav[9], nav[6])
    r[0] -= k[0] * np.sin(3.0 * yaw)
    return 0


def _cos3(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    yaw = np.arctan2(nav[9], nav[6])
    r[0] -= k[0] * np.cos(3.0 * yaw)
    return 0


def _pitch(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    r[0] -= k[0] * nav[12]
    return 0


def _roll(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    r[0] -= k[0] * nav[13]
    return 0


def _tilt2(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    r[0] -= k[0] * (1.0 - nav[14] * nav[14])
    return 0


def _time2(nav: Any, k: Any, z: Any, r: Any) -> int:  # noqa: ARG001
    r[0] -= k[0] * z[TIME] * z[TIME]
    return 0


_HEADING: Mapping[str, tuple[int, str]] = {
    "sin(3 yaw)": (residual_function(_sin3), "rad"),
    "cos(3 yaw)": (residual_function(_cos3), "rad"),
    "sin(pitch of x)": (residual_function(_pitch), "rad"),
    "sin(pitch of y)": (residual_function(_roll), "rad"),
    "sin(tilt)^2": (residual_function(_tilt2), "rad"),
    "t^2": (residual_function(_time2), "rad/s^2"),
}


def heading_terms(recording: Recording) -> list[Effect]:
    """Terms of a measured heading."""
    out = []
    known = _named_headings(tuple(catalogue()))
    for formula, (address, unit) in _HEADING.items():
        if formula in known:
            continue
        prior = HEADING_SIZE * (2.0 / recording.duration_s**2 if unit == "rad/s^2" else 1.0)
        out.append(
            term(
                f"heading += k * {formula}",
                unit,
                prior,
                observation_error={"heading": address},
            )
        )
    return out


@cache
def _named_headings(ids: tuple[str, ...]) -> frozenset[str]:
    """Formulas of the heading that effects of the catalogue add up to, tried as in ``_named``."""
    s = probe(PROBED)
    assert s.C_nb is not None
    n = len(s.t)
    place, speed = s.streams["pose"][:, :3], s.streams["mag"]
    nav = np.hstack([place, speed, s.C_nb.reshape(n, 9), s.gyro, s.accel])
    z = np.zeros((n, Z_DIM))
    z[:, 0], z[:, TIME] = so3.yaw_of(s.C_nb), s.t
    columns = [np.ones((n, 1))]  # a constant offset
    for i in ids:
        effect = catalogue()[i]
        if "heading" in effect.observation_error and effect.process is None:
            for step in np.diag(1e-3 * effect.prior_sigma):
                less, more = (
                    observed_error(effect, "heading", x, nav, z, 1) for x in (-step, step)
                )
                columns.append(more - less)
    found = []
    for formula, (address, unit) in _HEADING.items():
        alone = term(formula, unit, 1.0, observation_error={"heading": address})
        found.append(observed_error(alone, "heading", np.ones(1), nav, z, 1))
    inside = spanned(basis(np.hstack(columns)), np.hstack(found))
    return frozenset(f for f, yes in zip(_HEADING, inside, strict=True) if yes)
