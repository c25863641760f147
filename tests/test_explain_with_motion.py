"""Errors that go with the motion and have no law: their process, and that they are told as such."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import schemas
from fake_explanation import fake_explanation
from worlds import recording_of
from worlds import slow as at_fifty_hertz

from handcal.commands import explain as explain_command
from handcal.effects import catalogue
from handcal.explain import explain, naming
from handcal.explain.model_file import chosen_from
from handcal.explanation import Explanation, Unnamed
from handcal.laws import with_motion
from handcal.show.explanation.document import explanation_json
from handcal.types import Array, Recording
from handcal_sim import simulate

ALL = [
    with_motion.on_axes(of, axes)
    for of in with_motion.effects()
    for n in range(1, len(with_motion.channels(of)) + 1)
    for axes in combinations(range(len(with_motion.channels(of))), n)
]


def noise_levels(e: with_motion.Effect) -> dict[str, float]:
    return {level.name: level.initial for level in e.levels}


@pytest.mark.parametrize("e", ALL, ids=lambda e: e.id)
def test_its_variance_stays_while_the_rate_does(e: with_motion.Effect) -> None:
    assert e.process is not None
    levels, rate = noise_levels(e), 0.7
    P = e.process.start(levels, rate)
    Phi, Q = e.process.transition(levels, np.array([0.02, 0.4]), np.full(2, rate))
    for k in range(2):
        np.testing.assert_allclose(Phi[k] @ P @ Phi[k].T + Q[k], P, rtol=1e-12)
    axes = 1 if "heading" in e.id else sum(c in "xyz" for c in e.id.split(" +=")[0].split("_")[1])
    assert np.count_nonzero(np.diag(P)) == axes == len(with_motion.channels(e))


def test_at_rest_one_kind_dies_away_and_the_other_stays() -> None:
    for kind, lasts in (("turning", 0.0), ("attitude", 1.0)):
        e = with_motion.effect("gyro", (0, 1, 2), kind)
        assert e.process is not None
        Phi, Q = e.process.transition(noise_levels(e), np.array([100.0]), np.zeros(1))
        np.testing.assert_allclose(Phi[0], lasts * np.eye(3), atol=1e-12)
        assert not Q.any()


def test_every_one_is_told_by_its_id_and_is_always_the_same() -> None:
    assert len({e.id for e in ALL}) == len(ALL)
    for e in ALL:
        assert with_motion.is_with_motion(e.id)
        assert with_motion.again(e.id) is e
    for unknown in ("gyro_x += k * omega_x", "gyro_bias_walk", "field_x += e(attitude)"):
        assert not with_motion.is_with_motion(unknown) or unknown.startswith("field")
        with pytest.raises(KeyError):
            with_motion.again(unknown)


def ringing(t: Array, omega: Array) -> Array:
    """A resonance of 0.5 Hz, hardly damped, that a rate sets going: no law on trial."""
    y, v = np.zeros_like(omega), np.zeros(3)
    stiff, loss = (2.0 * np.pi * 0.5) ** 2, 2.0 * 0.1 * 2.0 * np.pi * 0.5
    for k, dt in enumerate(np.diff(t)):
        v = v + dt * (stiff * (omega[k] - y[k]) - loss * v)
        y[k + 1] = y[k] + dt * v
    return y - omega


def rings(seed: int, size: float) -> Recording:
    recording = recording_of(
        simulate("free-hand", seed=seed, duration_s=25.0, phone=at_fifty_hertz), "heading"
    )
    imu = recording.imu
    added = size * ringing(imu.t, imu.gyro) * np.array([1.0, 0.0, 0.0])
    return replace(recording, imu=replace(imu, gyro=imu.gyro + added))


@pytest.mark.prove
@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_what_no_law_describes_is_no_walk_and_no_handful_of_names(seed: int) -> None:
    e = explain([rings(seed, 0.05)])
    assert e.verdict == "unexplained"
    assert [m.effect for m in e.missing] == []
    assert (
        {"gyro_x"} <= {c for u in e.unnamed for c in u.channels} <= {"gyro_x", "gyro_y", "gyro_z"}
    )
    _is_told_and_written(e)


def _is_told_and_written(e: Explanation) -> None:
    document = explanation_json(e)
    schemas.check(document)
    assert all(len(u["curve"]["x"]) > 10 for u in document["unnamed"])
    assert e.model is not None
    again = chosen_from(document["model"])
    assert [x.id for x in again.effects] == [x.id for x in e.model.effects]


# --- names beside it ---------------------------------------------------------------------------


class Stub:
    """A model of these effects, which is asked for their names alone."""

    def __init__(self, *effects: with_motion.Effect) -> None:
        self.effects, self.ids = effects, {e.id for e in effects}


@pytest.mark.parametrize(
    ("name", "beside", "ratio", "told"),
    [
        ("gyro_scale", "gyro_xyz += e(attitude)", 3.0, False),
        ("gyro_scale", "gyro_xyz += e(attitude)", 3.5, True),
        ("gyro_scale", "accel_xyz += e(attitude)", 0.1, True),
        ("gyro_bias_walk", "gyro_x += k * |omega|", 2.0, False),
        ("gyro_scale", "gyro_x += k * |omega|", 0.5, True),
        ("gyro_scale", "gyro_x += g(|omega|)", 0.5, False),
    ],
)
def test_a_name_stands_out_from_what_is_not_understood(
    monkeypatch: pytest.MonkeyPatch, name: str, beside: str, ratio: float, told: bool
) -> None:
    """By sqrt(10) times: z^2 / 2 nats against prior odds of 5."""
    unknown = replace(catalogue()["gyro_quadratic"], id=beside)
    size = {"gyro_scale": {"gyro_x": ratio}, "gyro_bias_walk": {"gyro_x": ratio}}
    size[beside] = {"accel_x" if beside.startswith("accel") else "gyro_x": 1.0}
    monkeypatch.setattr(naming.importance, "sizes", lambda _, e, **_spread: size[e.id])
    effect = catalogue()[name]
    assert (naming._own(Stub(effect, unknown), effect) > naming.LIKELY) == told


@pytest.mark.parametrize(
    ("sizes", "told"), [((2.0, 2.0, 2.0), False), ((4.0, 1.0, 1.0), True), ((3.1, 3.1, 3.1), False)]
)
def test_a_name_may_stand_out_on_one_axis(
    monkeypatch: pytest.MonkeyPatch, sizes: tuple[float, ...], told: bool
) -> None:
    unknown = replace(catalogue()["gyro_quadratic"], id="gyro_xyz += e(attitude)")
    effect, axes = catalogue()["gyro_scale"], ("gyro_x", "gyro_y", "gyro_z")
    size = {effect.id: dict(zip(axes, sizes, strict=True)), unknown.id: dict.fromkeys(axes, 1.0)}
    monkeypatch.setattr(naming.importance, "sizes", lambda _, e, **_spread: size[e.id])
    assert (naming._own(Stub(effect, unknown), effect) > naming.LIKELY) == told


@pytest.mark.parametrize(
    ("channel", "named", "counts"), [("gyro_x", 19.9, True), ("gyro_x", 20.1, False),
                                     ("attitude_x", 1e6, True)],
)  # fmt: skip
def test_what_has_no_name_counts_beside_what_is_named_on_the_same_channel(
    monkeypatch: pytest.MonkeyPatch, channel: str, named: float, counts: bool
) -> None:
    """From a twentieth of the size on; a late tracker, worth as many nats
    as one likes, adds to no gyro."""
    law = replace(catalogue()["gyro_quadratic"], id="gyro_x += k * |omega|")
    other = catalogue()["gyro_scale"]
    size = {law.id: {"gyro_x": 1.0}, other.id: {channel: named}}
    monkeypatch.setattr(naming.importance, "sizes", lambda _, e, **_spread: size[e.id])
    u = Unnamed(law.id, 1.0, 0.1, "rad/s", 50.0, channels=("gyro_x",))
    assert naming.next_to_nothing(Stub(law, other), u) != counts


def test_what_a_hand_may_lend_is_no_physics() -> None:
    held, posed = (SimpleNamespace(kinds=k) for k in (("fixed_position", "heading"), ("pose",)))
    u = Unnamed(
        "accel_xy += e(t) * |omega|", 0.1, 0.01, "m/s^2", 0.9 * naming.LENT,
        channels=("accel_x", "accel_y"),
    )  # fmt: skip
    assert naming.by_the_hand(u, [held])
    assert not naming.by_the_hand(u, [posed])
    assert not naming.by_the_hand(replace(u, log_evidence_gain=1.1 * naming.LENT), [held])
    assert not naming.by_the_hand(replace(u, formula="accel_x += k * f_x^2"), [held])
    assert not naming.by_the_hand(replace(u, channels=("gyro_x",)), [held])


def test_nothing_is_written_of_what_is_no_law(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    u = Unnamed("gyro_x += e(attitude)", 0.1, 0.01, "rad/s", 50.0, channels=("gyro_x",))
    explain_command._write(
        replace(fake_explanation("unexplained"), unnamed=(u,)), tmp_path / "x.py"
    )
    assert list(tmp_path.iterdir()) == []
    said = capsys.readouterr().err
    assert "not a law" in said
    assert "x.py is not written" in said
