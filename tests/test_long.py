"""A long recording is gone about piece by piece: the same as all at once, in little memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from proved import proved
from worlds import recording_of

from handcal.bench.program import simulated
from handcal.bench.timing import run_handcal
from handcal.compiled import so3
from handcal.effects import select
from handcal.estimate import first_trajectory, pieces, smoother
from handcal.estimate.baseline import started
from handcal.estimate.calibration import calibrate
from handcal.estimate.case import case_of, problem_with
from handcal.estimate.evidence import reduce, reduced_pass
from handcal.estimate.filter import run_compiled
from handcal.estimate.fit import fitted
from handcal.estimate.linear import About
from handcal.estimate.model import Fitted
from handcal.estimate.noise_levels import initial_levels
from handcal.estimate.observed import first_state
from handcal.estimate.transfer import moved_to
from handcal.types import Recording
from handcal_sim import simulate

# Nats, and standard deviations, within which nothing may change (the issue that asked for it).
NATS, SIGMAS = 0.05, 0.02
EFFECTS = (
    ("heading_delay", "heading_soft_iron"), ("gyro_bias_walk",),
    ("gyro_scale", "accel_delay", "heading_delay"),
)  # fmt: skip


@pytest.fixture(scope="module")
def recording() -> Recording:
    return recording_of(simulate("free-hand", seed=0, duration_s=40.0), "heading")


@pytest.fixture(scope="module")
def plain(recording: Recording) -> Fitted:
    """Settled without effects."""
    (part,) = fitted([started(case_of(recording))], ()).parts
    return part


@pytest.fixture(scope="module", params=EFFECTS, ids="+".join)
def fit(plain: Fitted, request: pytest.FixtureRequest) -> Fitted:
    """With effects that are looked for from there."""
    return moved_to(plain, select(request.param))


@pytest.fixture
def _as_long(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Half a minute is as long as an hour, and its pieces end in the midst of it."""
    monkeypatch.setattr(pieces, "LONG", 1000)
    monkeypatch.setattr(pieces, "PIECE", 333)
    monkeypatch.setattr(first_trajectory, "PIECE", 777)
    with pieces.by_pieces():
        yield


@pytest.mark.usefixtures("_as_long")
def test_the_same_evidence_and_constants(fit: Fitted) -> None:
    each, long = reduce(fit.linear, folds=False), pieces.reduced(fit.about)
    assert len(long.linear.t) < (0.25 if fit.problem.walks else 0.1) * len(each.linear.t)
    assert len(long.h) < 0.6 * len(each.h)
    a, b = reduced_pass(long, fit.levels), reduced_pass(each, fit.levels)
    assert abs(a.log_evidence - b.log_evidence) < NATS
    sigma = np.linalg.norm(b.spread, axis=1)
    assert np.abs((a.w - b.w) / sigma).max() < SIGMAS
    assert np.abs(np.linalg.norm(a.spread, axis=1) / sigma - 1.0).max() < SIGMAS


@pytest.mark.usefixtures("_as_long")
def test_the_same_trajectory(fit: Fitted) -> None:
    """Moved by what a pass finds: within a fiftieth of the sigma that is left where windows begin,
    which is what a history shows, and a fifth within them, where a window's noise is spread
    evenly."""
    whole, _ = smoother.smoothed_mean(fit.linear, fit.levels)
    exact = smoother.moved(fit.trajectory, whole)
    done = reduced_pass(pieces.reduced(fit.about), fit.levels, keep=True)
    there = smoother.followed(done, fit.trajectory)()
    forward = smoother.forward(fit.linear, fit.levels)
    _, P = smoother.smooth(fit.linear, fit.levels, forward)
    sigma = np.sqrt(np.einsum("kii->ki", P))
    turned = so3.matrix_log(there.C @ exact.C.transpose(0, 2, 1))
    away = np.abs(np.hstack([there.p - exact.p, there.v - exact.v, turned])) / sigma[:, :9]
    begin = pieces.starts(fit.problem, fit.trajectory)
    assert np.quantile(away[begin], 0.99) < SIGMAS
    assert np.quantile(away, 0.99) < 10 * SIGMAS


@pytest.mark.usefixtures("_as_long")
def test_the_filter_goes_through_pieces_as_through_the_whole(fit: Fitted) -> None:
    rows = np.r_[np.arange(0, len(fit.t), 50), len(fit.t) - 1]
    whole = smoother.forward(fit.linear, fit.levels, rows=rows)
    piecewise, told = smoother.forward_by_pieces(fit.about, fit.levels, rows)
    # (a walk begins with what it has, which is known)
    sigma = np.maximum(np.sqrt(np.einsum("kii->ki", whole.P)), 1e-12)
    np.testing.assert_allclose(piecewise.x / sigma, whole.x / sigma, atol=1e-6)
    np.testing.assert_allclose(piecewise.nis, whole.nis, rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(told.used, fit.linear.used)
    np.testing.assert_allclose(told.r, fit.linear.r, atol=1e-12)


@pytest.mark.usefixtures("_as_long")
def test_the_online_filter_too(recording: Recording) -> None:
    case = case_of(recording)
    problem = problem_with(case, ())
    levels = initial_levels(problem)
    state = first_state(problem, case.start, levels)
    short = first_trajectory.first_trajectory(problem, levels, state, run_compiled)
    first_trajectory.PIECE = len(problem.nodes.t)
    whole = first_trajectory.first_trajectory(problem, levels, state, run_compiled)
    for name in ("p", "v", "C", "bg", "ba", "markov"):
        np.testing.assert_array_equal(getattr(short, name), getattr(whole, name))


@pytest.mark.parametrize("only", [True, *proved(False)])
def test_the_same_calibration(
    recording: Recording, only: bool, request: pytest.FixtureRequest
) -> None:
    whole = calibrate(recording, only=only)
    request.getfixturevalue("_as_long")
    long = calibrate(recording, only=only)
    assert long.log_evidence == pytest.approx(whole.log_evidence, abs=NATS)
    for a, b in zip(long.parameters, whole.parameters, strict=True):
        assert abs(a.value - b.value) < SIGMAS * b.sigma
        assert a.sigma == pytest.approx(b.sigma, rel=SIGMAS)
        assert a.shown == b.shown
    assert len(long.innovations["heading"].t) == len(whole.innovations["heading"].t)
    assert long.history.t[-1] == whole.history.t[-1]
    assert long.standing is not None
    assert whole.standing is not None


def test_precise_headings_are_not_gathered_for_long(plain: Fitted) -> None:
    """Where the heading is better than the gyro's noise, that noise would be neglected."""
    problem, nominal = plain.problem, plain.trajectory
    heading = [o.kind for o in problem.observations].index("heading")
    z, mine = problem.nodes.z.copy(), problem.nodes.kind == heading
    z[mine, 0] = np.linspace(0.0, 1e-3, int(mine.sum()))
    precise = replace(problem, nodes=problem.nodes._replace(z=z))
    assert len(pieces.starts(precise, nominal)) > 2 * len(pieces.starts(problem, nominal))


@pytest.mark.usefixtures("_as_long")
def test_only_where_it_is_allowed_and_no_effect_sees_the_past(plain: Fitted) -> None:
    """Scans ask for every reading."""
    assert pieces.is_long(plain.problem, plain.trajectory)
    token = pieces._ALLOWED.set(False)
    assert not pieces.is_long(plain.problem, plain.trajectory)
    pieces._ALLOWED.reset(token)


@pytest.mark.usefixtures("_as_long")
def test_what_was_reduced_is_asked_for_once(plain: Fitted) -> None:
    about = pieces.known_reduced(plain.about)
    assert pieces.reduced(about) is pieces.released(about)
    assert pieces.reduced(about) is not pieces.reduced(about)
    assert isinstance(about, About)


@pytest.mark.prove
def test_an_hour_takes_little_memory(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Two gigabytes before; asked are 400 MB."""
    folder = tmp_path_factory.mktemp("hour")
    path = simulated("free-hand", folder / "hour.mcap", "--duration", "3600")
    assert run_handcal("calibrate", path).memory < 700.0
