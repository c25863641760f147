"""What a fit says of its parameters: values, sigmas, and how they depend on each other."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from handcal.compiled import so3
from handcal.effects import Effect, Param, catalogue, select
from handcal.estimate.case import Case, name_of
from handcal.estimate.evidence import reduced_pass
from handcal.estimate.fit import believed
from handcal.estimate.model import Model
from handcal.estimate.pieces import reduced
from handcal.estimate.quadratic import given, local
from handcal.observations.pose import aligned
from handcal.types import Array, Likelihood, MarkerRotation, Parameter

# In the order of the filter's states.
BIASES = tuple(
    (e.id, p.name, p.unit, p.prior_sigma)
    for e in select(("gyro_bias", "accel_bias"))
    for p in e.parameters
)


# Rotation vector of the marker's axes against the IMU's, as the pose's constants have it.
MARKER = tuple(("pose", f"marker_{axis}") for axis in "xyz")


@dataclass(frozen=True)
class Moment:
    """When what is not linear in its moment happens, s, and how well that is known."""

    at: float
    sigma: float


@dataclass(frozen=True)
class Known:
    """Parameters of one recording's fit, biases first, and their covariance (m, m); column (m,):
    which constant of the problem each is, biases counted (-1: a moment); marker: of a pose."""

    parameters: tuple[Parameter, ...]
    covariance: Array
    column: tuple[int, ...]
    marker: MarkerRotation | None = None


def known(
    model: Model, part: int, excess: Mapping[str, float], moments: Mapping[str, Moment]
) -> Known:
    """Biases of one recording and the effects' parameters, shared by all recordings.

    excess: by which the scores of each effect scatter beyond the information matrix; moments: of
    the effects that are held at one, by id.
    """
    if model.known is not None:
        model, excess = believed(model, excess), {}
    problem = model.parts[part].problem
    whole, C, unit_of = _constants(model, part)
    parameters, column, widen = [], [], []
    for i, (bias, axis, unit, prior) in enumerate(BIASES):
        sigma = math.sqrt(C[i, i]) * float(unit_of[i])
        parameters.append(Parameter(bias, axis, float(whole[i]), sigma, unit, prior, None))
        column.append(i)
        widen.append(float(unit_of[i]))
    owners = [(s.owner, s.name) for s in problem.slots]
    for effect, p in _listed(problem.effects):
        if (effect.id, p.name) not in owners:
            moment = moments.get(effect.id, Moment(float("nan"), float("nan")))
            value, sigma, k, scale = moment.at, moment.sigma, -1, 1.0
        else:
            k = 6 + owners.index((effect.id, p.name))
            scale = math.sqrt(excess.get(effect.id, 1.0)) * float(unit_of[k])
            value, sigma = float(whole[k]), math.sqrt(max(C[k, k], 0.0)) * scale
        parameters.append(
            Parameter(name_of(effect.id), p.name, value, sigma, p.unit, p.prior_sigma, None)
        )
        column.append(k)
        widen.append(scale)
    columns = np.array(column)
    covariance = C[np.ix_(columns, columns)] * np.outer(widen, widen)
    for i, k in enumerate(column):
        if k < 0:
            covariance[i], covariance[:, i] = 0.0, 0.0
            covariance[i, i] = parameters[i].sigma ** 2
    sigmas = np.sqrt(np.maximum(np.diag(C), 0.0)) * unit_of
    marker = _marker(model.parts[part].case, owners, whole[6:], sigmas[6:])
    return Known(tuple(parameters), covariance, tuple(column), marker)


def _marker(
    case: Case, owners: Sequence[tuple[str, str]], constants: Array, sigma: Array
) -> MarkerRotation | None:
    """The rough alignment that rows of the pose went through, with what was found beyond it."""
    at = [owners.index(n) for n in MARKER if n in owners]
    if len(at) < len(MARKER):
        return None
    R_bm, _ = aligned(case.recording, case.recording.streams["pose"])
    q = so3.quaternion_of((so3.matrix_exp(constants[at]) @ R_bm).T[None])[0]
    return MarkerRotation(q if q[0] >= 0.0 else -q, sigma[at])


def _constants(model: Model, part: int) -> tuple[Array, Array, Array]:
    """Values (nc,) of a recording's biases and constants, SI, their covariance (nc, nc) in units
    of their priors, and these units (nc,)."""
    f = model.parts[part]
    nominal = f.trajectory
    done = reduced_pass(reduced(f.about), f.levels)
    own = local(done, frozenset(e.id for e in model.effects))
    at = {n: i for i, n in enumerate(model.quadratic.names)}
    u = given(model.quadratic, own.quadratic, model.u)
    mine = [at[n] for n in own.quadratic.names]
    C_u = model.covariance[np.ix_(mine, mine)]
    n = len(own.own) + len(own.shared)
    C = np.zeros((n, n))
    cross = own.by_shared @ C_u
    C[np.ix_(own.shared, own.shared)] = C_u
    C[np.ix_(own.own, own.own)] = own.covariance + cross @ own.by_shared.T
    C[np.ix_(own.own, own.shared)], C[np.ix_(own.shared, own.own)] = cross, cross.T
    scale = done.reduction.scale
    whole = np.r_[nominal.bg, nominal.ba, nominal.constants] + scale * own.deviations(u)
    return whole, C, scale


def likelihood(model: Model, part: int, excess: Mapping[str, float]) -> Likelihood:
    """What one recording says of its biases and of the effects that are constants; excess: as in
    ``known``."""
    f = model.parts[part]
    done = reduced_pass(reduced(f.about), f.levels)
    slots, (_, b, G) = f.problem.slots, done.log_likelihood
    effects = {e.id for e in model.effects if "+=" not in e.id}
    listed = [(s.owner, s.name) if s.owner in effects else ("", "") for s in slots]
    names = [*((effect, axis) for effect, axis, *_ in BIASES), *listed]
    own = np.array([name[0] == "" for name in names], dtype=bool)
    # (what belongs to the recording alone has its prior)
    root = np.linalg.cholesky(G[np.ix_(own, own)] + np.eye(int(own.sum())))
    both = np.column_stack([b[own] + done.reduction.w0[own], G[np.ix_(own, ~own)]])
    half = np.linalg.solve(root, both)
    y, Y = half[:, 0], half[:, 1:]
    # (one power for all: two factors would change which sum of two parameters is known)
    power = 1.0 / max(1.0, float(np.mean(list(excess.values()) or [1.0])))
    scale = done.reduction.scale[~own]
    nominal = f.trajectory
    at = np.r_[nominal.bg, nominal.ba, nominal.constants][~own]
    Lambda = power * (G[np.ix_(~own, ~own)] - Y.T @ Y) / np.outer(scale, scale)
    information = 0.5 * (Lambda + Lambda.T)
    vector = power * (b[~own] - Y.T @ y) / scale + information @ at
    told = tuple((name_of(i), n) for (i, n), mine in zip(names, own, strict=True) if not mine)
    return Likelihood(told, information, vector)


def _listed(effects: Sequence[Effect]) -> list[tuple[Effect, Param]]:
    """Each parameter of each effect that is a constant, a held moment among them."""
    return [
        (e, p)
        for e in effects
        if e.process is None and not e.outliers
        for p in catalogue().get(name_of(e.id), e).parameters
    ]


def with_shown(parameters: Sequence[Parameter]) -> frozenset[str]:
    """Ids of the effects of which a recording shows at least one parameter."""
    return frozenset(p.effect for p in parameters if p.shown)


def given_model(
    parameters: Sequence[Parameter], covariance: Array, found: Collection[str]
) -> tuple[Array, Array]:
    """Values (m,) and sigmas (m,) of the parameters if, besides biases, there are the effects found
    alone: the normal density of all, given that the others are zero, which is what they are then.

    covariance (m, m): of the parameters.
    """
    value = np.array([p.value for p in parameters])
    own = {i for i, *_ in BIASES} | set(found)
    out = np.array([p.effect not in own for p in parameters], dtype=bool)
    mean, sigma = value.copy(), np.sqrt(np.diag(covariance))
    if out.any():
        unit = sigma[out]
        C = covariance[np.ix_(out, out)] / np.outer(unit, unit)
        gain = np.linalg.lstsq(C, covariance[np.ix_(out, ~out)] / unit[:, None], rcond=1e-12)[0].T
        mean[~out] -= gain @ (value[out] / unit)
        less = np.einsum("ij,ij->i", gain, covariance[np.ix_(~out, out)] / unit)
        sigma[~out] = np.sqrt(np.maximum(np.diag(covariance)[~out] - less, 0.0))
        mean[out], sigma[out] = 0.0, 0.0
    return mean, sigma
