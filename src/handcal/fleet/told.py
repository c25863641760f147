"""What one recording says of every parameter, whether or not an effect was named.

An explanation has values of what it named, so only of what happened to come out large: a mean over
devices of such values is no mean of devices. Here the effects of ``ALWAYS`` are in the model of
every recording, beside what the explanation found in it, and each other effect of the catalogue is
looked at beside them, one at a time, in one linear pass about that fit. Value and sigma are of the
likelihood alone: the prior that the fit needed is divided out again, so what a recording does not
show has a sigma without bound.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from handcal.device.file import unit_of, usual_of
from handcal.effects import ATTITUDE, PLACE, Effect, catalogue, select
from handcal.estimate.baseline import baseline
from handcal.estimate.case import Case, case_of
from handcal.estimate.model import Model
from handcal.estimate.parameters import known
from handcal.estimate.quadratic import Quadratic
from handcal.estimate.rest_only import resting, travels
from handcal.estimate.scan import scan
from handcal.estimate.specification import Specification, seen, settled, view_of
from handcal.laws.of_devices import Known, known_of
from handcal.observations import catalogue as observations
from handcal.population.joint import kept
from handcal.types import HandcalError, Recording

# The model of an inertial sensor in every textbook, and the arm from the held point, which is
# another in every hand: without it a hand's arm is taken for errors of the accelerometer.
ALWAYS = ("gyro_scale", "gyro_misalignment", "accel_scale", "accel_misalignment", "lever_arm")
# Information below this part of the prior's is rounding; so is a sigma above a hundred priors'.
LEAST = 1e-4


@dataclass(frozen=True)
class Told:
    """What a recording says of one parameter: value and sigma of the likelihood, prior_sigma (the
    catalogue's), SI; together: it was estimated with the others, not alone beside them."""

    effect: str
    name: str
    value: float
    sigma: float
    unit: str
    prior_sigma: float
    together: bool


@dataclass(frozen=True)
class Telling:
    """values: each parameter by itself; information: of all but the biases at once, in units of the
    catalogue's priors (``Quadratic``); laws: what may have no name."""

    values: tuple[Told, ...]
    information: Quadratic
    laws: Known


def told(recording: Recording, found: Specification | None = None) -> Telling:
    """Biases, the effects of ``ALWAYS`` and every other that acts here; found: the explanation's
    model, if it has one. Errors: HandcalError where there is no fit with those of ``ALWAYS``."""
    model = _model(recording, found)
    case = model.parts[0].case
    have = {e.id for e in model.effects}
    others = [e for e in catalogue().values() if e.id not in have and _acts(e, case)]
    q = _of_catalogue(scan(model, others))
    out = _biases(model, q.worth)
    own = [i for i, n in enumerate(q.names) if n[0] in have]
    out += _marginals(q, own, own, True)
    for effect in others:
        mine = [i for i, n in enumerate(q.names) if n[0] == effect.id]
        out += _marginals(q, [*own, *mine], mine, False)
    return Telling(tuple(out), q, known_of(model))


def _model(recording: Recording, found: Specification | None) -> Model:
    """The fit about which a recording is asked."""
    if found is not None and len(found.views) == 1:
        # (what was known before would count once for each recording)
        options = replace(found.options, before=None)
        return _fit(seen(recording, found.views[0], options), replace(found, options=options))
    model = _fit(case_of(recording, "auto", None))
    return _fit(resting(model.parts[0], None, 0.0)) if travels(model.parts[0]) else model


def _fit(case: Case, found: Specification | None = None) -> Model:
    base = baseline([case])
    chosen = Specification((), (view_of(case),)) if found is None else found
    effects = {e.id: e for e in (*base.effects, *chosen.effects)}
    taken = {i for e in effects.values() for i in (e.id, *e.exclusive)}
    new = {e.id: e for e in select(ALWAYS) if e.id not in taken and _acts(e, case)}
    model = settled(base, replace(chosen, effects=(*(effects | new).values(),)))
    if not math.isfinite(model.log_evidence):
        raise HandcalError(
            "No fit with scale errors, misalignments and an arm holds on this recording: one of "
            "its sensors reads something else than it should."
        )
    return model


def _of_catalogue(q: Quadratic) -> Quadratic:
    """Without laws that have no name, which are this recording's alone: integrated out."""
    keep = [i for i, n in enumerate(q.names) if n[0] in catalogue()]
    gone = [i for i, n in enumerate(q.names) if n[0] not in catalogue()]
    if not gone:
        return q
    b, G = kept(q.b, q.G, keep, gone)
    return replace(q, names=tuple(q.names[i] for i in keep), b=b, G=G)


def _acts(e: Effect, case: Case) -> bool:
    """Whether an effect is a constant of the device that this recording could show."""
    streams = {n for n in e.needs if n not in (ATTITUDE, PLACE)}
    if e.baseline or e.process is not None or e.outliers or e.moments is not None or e.instead:
        return False
    if not streams <= set(case.recording.streams):
        return False
    if PLACE in e.needs and not any(observations()[k].places for k in case.kinds):
        return False
    return e.imu_error is not None or bool(e.acts_on & set(case.kinds))


def _biases(model: Model, worth: float) -> list[Told]:
    """gyro_bias and accel_bias: their posterior without the prior of the catalogue."""
    found = known(model, 0, {}, {})
    out = []
    for p in found.parameters:
        effect = catalogue().get(p.effect)
        if effect is not None and effect.baseline:
            ratio = (p.sigma / p.prior_sigma) ** 2 if worth > 0 else 1.0
            out.append(_one((p.effect, p.name), p.unit, p.prior_sigma,
                            p.value / p.prior_sigma, ratio, True, worth))  # fmt: skip
    return [t for t in out if t is not None]


def _marginals(q: Quadratic, index: Sequence[int], of: Sequence[int], together: bool) -> list[Told]:
    """Of the parameters ``of``, the model being those of ``index``: each with the others' priors
    in place and without its own."""
    if not of:
        return []
    A = q.G[np.ix_(index, index)] + np.eye(len(index))
    C = np.linalg.solve(A, np.eye(len(index)))
    mean = C @ q.b[list(index)]
    out = []
    for i in of:
        k = list(index).index(i)
        effect, name = q.names[i]
        unit, usual = unit_of((effect, name)), float(usual_of([(effect, name)])[0])
        out.append(_one((effect, name), unit, usual, float(mean[k]), float(C[k, k]), together, 1.0))
    return [t for t in out if t is not None]


def _one(
    name: tuple[str, str], unit: str, prior: float, mean: float, variance: float, together: bool,
    worth: float,
) -> Told | None:  # fmt: skip
    """mean and variance of a posterior in units of its prior, whose own share is taken out; None
    where nothing is left. worth: power of the likelihood that is still to be given."""
    information = (1.0 / variance - 1.0) * worth
    if not math.isfinite(mean) or information < LEAST:
        return None
    value = mean / variance * worth / information
    return Told(*name, value * prior, prior / math.sqrt(information), unit, prior, together)
