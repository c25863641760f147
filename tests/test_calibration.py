"""``calibrate``: what it refuses, how it decides, and that it does the same again."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from proved import proved
from worlds import recording_of, true_levels

from handcal import calibrate
from handcal.compiled import so3
from handcal.earth import EARTH_RATE, local_earth
from handcal.effects import catalogue as known
from handcal.estimate.start import from_rest
from handcal.types import HandcalError, InputError, Series
from handcal_sim import simulate
from handcal_sim.phone import consumer_magnetometer, consumer_phone, paper_phone
from handcal_sim.sensors import earth_at


@pytest.fixture(scope="module")
def turns():
    world = simulate("three-turns", seed=0)
    return recording_of(world, "heading"), true_levels(world)


# --- what it refuses ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"effects": ["gyro_scales"]}, "gyro_scales"),
        ({"assume": "fixed"}, "fixed"),
        ({"observations": ["gps"]}, "gps"),
        ({"ignore": ["pose"]}, "pose"),
        ({"engine": "quantum"}, "quantum"),
        ({"latitude": 48.0}, "latitude"),
    ],
)
def test_unknown_names_and_options_are_told(turns, wrong, said):
    """In a sentence that names what was wrong; a wrong name of a list says what there is."""
    with pytest.raises(InputError) as caught:
        calibrate(turns[0], **wrong)
    assert said in str(caught.value)
    assert str(caught.value).endswith(".")


def test_rest_only_needs_rests():
    world = simulate("free-hand", seed=0, duration_s=30.0)
    recording = recording_of(world, "heading")
    begin = world.parameters["rests"][0][1] + 2.0
    imu = recording.imu
    keep = (imu.t > begin) & (imu.t < world.parameters["rests"][1][0] - 2.0)
    moving = replace(
        recording,
        imu=replace(
            imu, t=imu.t[keep], gyro=imu.gyro[keep], accel=imu.accel[keep], valid=imu.valid[keep]
        ),
    )
    with pytest.raises(HandcalError, match="never rests") as caught:
        calibrate(moving, assume="rest-only")
    assert not isinstance(caught.value, InputError)


@pytest.mark.parametrize("kind", ["magnetometer", "pose"])
def test_an_observation_without_its_stream_is_told(turns, kind):
    with pytest.raises(HandcalError, match=kind[:3]):
        calibrate(turns[0], observations=["fixed_position", kind])


# --- how it decides -------------------------------------------------------------------------


def auto(name, seed, **more):
    """As a user would, who knows nothing; a short recording, for the search takes long."""
    return calibrate(recording_of(simulate(name, seed=seed, **more), "heading"))


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        ("z-turn", 0),
        *proved(("three-turns", 0), ("z-turn", 1)),
    ],
)
def test_turns_in_the_hand_are_taken_to_be_about_a_fixed_point(name, seed):
    result = auto(name, seed, duration_s=15.0)
    assert result.assume == "fixed-point"
    assert "fixed_position" in result.innovations
    assert not any("travels" in w for w in result.warnings)


@pytest.mark.prove
@pytest.mark.parametrize("seed", range(1))
def test_a_hand_that_travels_is_still_only_at_rest(seed):
    """It moves by half a metre: told, and only the rests are taken to be still."""
    result = auto("travel", seed, duration_s=30.0)
    assert result.assume == "rest-only"
    assert set(result.innovations) == {"zero_velocity", "zero_rate", "heading"}
    assert any("travels" in w for w in result.warnings)
    t = result.innovations["zero_velocity"].t
    assert all(any(a <= x <= b for a, b in result.rests) for x in t)


def test_the_assumption_can_be_made_by_the_user(turns):
    recording, noise = turns
    held = calibrate(recording, assume="fixed-point", noise=noise, only=True)
    rested = calibrate(recording, assume="rest-only", noise=noise, only=True)
    assert (held.assume, rested.assume) == ("fixed-point", "rest-only")
    assert set(held.innovations) == {"fixed_position", "heading"}
    assert set(rested.innovations) == {"zero_velocity", "zero_rate", "heading"}
    # a point held throughout tells more of the accelerometer's biases
    pairs = list(zip(held.parameters, rested.parameters, strict=True))
    assert [a.effect for a, _ in pairs[3:6]] == ["accel_bias"] * 3
    assert all(a.sigma < b.sigma for a, b in pairs[3:6])


def test_a_stream_can_be_left_out(turns):
    recording, noise = turns
    result = calibrate(recording, assume="fixed-point", noise=noise, ignore=["heading"], only=True)
    assert set(result.innovations) == {"fixed_position"}
    assert result.observed_heading is None


# --- noise ------------------------------------------------------------------------------------


def estimated(result):
    return {n.name: n.value for n in result.noise if n.estimated}


def test_levels_that_are_given_stay(turns):
    recording, noise = turns
    known = {k: v for k, v in noise.items() if k != "heading_noise"}
    result = calibrate(recording, assume="fixed-point", noise=known, heading_sigma=0.123, only=True)
    assert estimated(result) == {}
    assert {n.name: n.value for n in result.noise} == known | {"heading_noise": 0.123}


def test_heading_noise_is_found(turns):
    """Truth: 5 degrees. 1000 or more headings give a sigma to 1/sqrt(2000), 2.2 %."""
    recording, noise = turns
    known = {k: v for k, v in noise.items() if k != "heading_noise"}
    result = calibrate(recording, assume="fixed-point", noise=known, only=True)
    assert set(estimated(result)) == {"heading_noise"}
    n = len(result.innovations["heading"].t)
    assert n > 1000
    assert estimated(result)["heading_noise"] == pytest.approx(
        math.radians(5.0), rel=5 / math.sqrt(2 * n)
    )


def test_noise_is_taken_from_the_part_before_noise_until(turns):
    """The second half's heading is three times as noisy: seen only if that half may speak."""
    recording, noise = turns
    known = {k: v for k, v in noise.items() if k != "heading_noise"}
    heading = recording.streams["heading"]
    late = heading.t > 15.0
    more = np.random.default_rng(0).normal(0, math.radians(5.0) * math.sqrt(8.0), late.sum())
    value = heading.value.copy()
    value[late, 0] = np.angle(np.exp(1j * (value[late, 0] + more)))
    spoilt = replace(recording, streams={"heading": Series(heading.t, value)})

    def level(until):
        result = calibrate(spoilt, assume="fixed-point", noise=known, noise_until=until, only=True)
        return math.degrees(estimated(result)["heading_noise"])

    # 500 headings or more in the first half: 3.2 %
    assert level(15.0) == pytest.approx(5.0, rel=0.16)
    assert level(None) == pytest.approx(5.0 * math.sqrt((1 + 9) / 2), rel=0.16)


# --- the Earth ----------------------------------------------------------------------------------


@pytest.mark.parametrize("latitude_deg", [0.0, 48.0, -60.0])
def test_latitude_takes_the_earth_off_the_gyro_and_gravity_off_the_accelerometer(latitude_deg):
    """The same recording with and without: estimates differ by just what the Earth adds.

    On a table, body at a known yaw. Without a latitude the Earth's rate is a bias.
    """
    latitude = math.radians(latitude_deg)
    world = simulate("static", seed=0, phone=paper_phone(), earth=earth_at(latitude, 300.0))
    recording, noise = recording_of(world, "heading"), true_levels(world)
    # a table that does not sway: then rates are known to a few millionths of a radian a second
    noise |= {"sway": 1e-4, "sway_per_rate": 1e-4, "position_noise": 2e-5, "heading_noise": 0.01}
    value = np.full_like(recording.streams["heading"].value, world.parameters["start"]["heading"])
    recording = replace(
        recording, streams={"heading": Series(recording.streams["heading"].t, value)}
    )
    options = {"assume": "fixed-point", "noise": noise, "only": True}
    without = calibrate(recording, **options)
    given = calibrate(recording, **options, latitude=latitude, height=300.0)
    difference = [
        a.value - b.value for a, b in zip(without.parameters, given.parameters, strict=True)
    ]
    g_n, rate = local_earth(latitude, 300.0)
    C = world.truth.C_nb[0]
    np.testing.assert_allclose(difference[:3], C.T @ rate, atol=0.1 * EARTH_RATE)
    # gravity and bias along the vertical cannot be told apart at rest
    assert (C @ difference[3:])[2] == pytest.approx(-g_n[2] - 9.80665, abs=2e-4)


def test_at_rest_the_gyro_feels_the_earth():
    """Rest-only with a latitude: what the gyro reads on a table is bias and Earth."""
    latitude = math.radians(48.0)
    world = simulate("static", seed=0, phone=paper_phone(), earth=earth_at(latitude))
    noise = true_levels(world) | {"rest_rate_noise": 1e-4, "heading_noise": 0.01}
    recording = recording_of(world, "heading")
    without, given = (
        calibrate(recording, assume="rest-only", noise=noise, latitude=x, only=True)
        for x in (None, latitude)
    )
    difference = [
        a.value - b.value for a, b in zip(without.parameters, given.parameters, strict=True)
    ]
    _, rate = local_earth(latitude)
    expected = (world.truth.C_nb[0].T @ rate)[2]
    assert difference[2] == pytest.approx(expected, rel=0.2)


# --- the magnetometer ---------------------------------------------------------------------------


def compass(iron, seed=0):
    def phone(rng):
        made = replace(consumer_phone(rng), heading=None)
        return replace(made, mag=replace(consumer_magnetometer(rng), hard_iron=np.array(iron)))

    world = simulate("three-turns", seed=seed, phone=phone)
    return recording_of(world, "mag"), true_levels(world)


@pytest.mark.parametrize("seed", [0, *proved(1)])
def test_a_clean_magnetometer_is_used(seed):
    recording, noise = compass([0.0, 0.0, 0.0], seed)
    result = calibrate(recording, assume="fixed-point", noise=noise)
    assert "magnetometer" in result.innovations
    assert result.observed_heading is not None
    assert not any("magnetometer" in w.lower() for w in result.warnings)


@pytest.mark.parametrize(
    "iron",
    [
        [0.0, 1e-4, -5e-5],
        *proved([5e-5, 0.0, 0.0], [3e-4, 3e-4, 0.0]),
    ],
)
def test_a_hard_iron_is_estimated_without_being_asked_for(iron):
    """Nobody has none; strong ones too, from where the readings lie around."""
    recording, noise = compass(iron)
    result = calibrate(recording, assume="fixed-point", noise=noise)
    assert not result.warnings
    for axis, true in zip("xyz", iron, strict=True):
        got = result.parameter("mag_hard_iron", axis)
        assert abs(got.value - true) < 4.0 * got.sigma
        assert got.shown


def test_a_magnetometer_in_other_units_is_left_out_and_that_is_said():
    """Milligauss taken for microtesla are a field of ten Earths."""
    recording, noise = compass([0.0, 0.0, 0.0])
    mag = recording.streams["mag"]
    streams = {"mag": replace(mag, value=10.0 * mag.value)}
    result = calibrate(replace(recording, streams=streams), assume="fixed-point", noise=noise)
    assert set(result.innovations) == {"fixed_position"}
    (said,) = [w for w in result.warnings if "magnetometer" in w]
    assert "not the Earth's" in said


# --- the result ---------------------------------------------------------------------------------


def bits(x):
    """A result as nested tuples of bytes, so that equal means bit by bit."""
    if hasattr(x, "__dataclass_fields__"):
        return tuple(bits(getattr(x, f.name)) for f in fields(x))
    if isinstance(x, dict):
        return tuple((k, bits(v)) for k, v in x.items())
    if isinstance(x, tuple):
        return tuple(bits(v) for v in x)
    return x.tobytes() if isinstance(x, np.ndarray) else x


def test_the_same_call_gives_the_same_bits():
    world = simulate("three-turns", seed=0, duration_s=8.0)
    recording, noise = recording_of(world, "heading"), true_levels(world)
    known = {k: v for k, v in noise.items() if k != "heading_noise"}
    first, second = (
        calibrate(recording, ["gyro_scale"], assume="fixed-point", noise=known) for _ in range(2)
    )
    assert bits(first) == bits(second)


def test_the_order_of_effects_does_not_matter(turns):
    recording, noise = turns
    a = calibrate(
        recording, ["gyro_scale", "lever_arm"], assume="fixed-point", noise=noise, only=True
    )
    b = calibrate(
        recording, ["lever_arm", "gyro_scale"], assume="fixed-point", noise=noise, only=True
    )
    assert a.log_evidence == pytest.approx(b.log_evidence, abs=0.01)
    for p in a.parameters:
        q = b.parameter(p.effect, p.name)
        assert q.value == pytest.approx(p.value, abs=1e-2 * p.sigma)
        assert q.sigma == pytest.approx(p.sigma, rel=1e-4)


def test_both_engines_lead_to_the_same_result(turns):
    """The slow one only finds the first trajectory."""
    recording, noise = turns
    a, b = (
        calibrate(recording, assume="fixed-point", noise=noise, engine=e, only=True)
        for e in ("compiled", "filterpy")
    )
    assert a.log_evidence == pytest.approx(b.log_evidence, abs=1e-4)


# What every device has, and an IMU with a heading could show.
COMMON = (
    "accel_delay", "accel_misalignment", "accel_scale", "gyro_g_sensitivity", "gyro_misalignment",
    "gyro_scale", "heading_delay", "heading_hard_iron", "heading_soft_iron", "lever_arm",
)  # fmt: skip


@pytest.mark.parametrize(
    ("asked", "only", "estimated"),
    [
        (("gyro_scale", "lever_arm"), True, ("gyro_scale", "lever_arm")),
        # (errors of the IMU come before those of what is observed)
        (("gyro_quadratic",), False, (*COMMON[:6], "gyro_quadratic", *COMMON[6:])),
    ],
    ids=["only", "beside what every device has"],
)
def test_a_result_holds_together(turns, asked, only, estimated):
    """Shapes, order and units: parameters, covariance and history speak of the same."""
    recording, noise = turns
    seen = []
    result = calibrate(
        recording, asked, assume="fixed-point", noise=noise, progress=seen.append, only=only
    )
    listed = [
        (effect, p.name, p.unit)
        for effect in ("gyro_bias", "accel_bias", *estimated)
        for p in known()[effect].parameters
    ]
    assert [(p.effect, p.name, p.unit) for p in result.parameters] == listed
    sigma = np.array([p.sigma for p in result.parameters])
    assert result.covariance.shape == (len(listed), len(listed))
    np.testing.assert_allclose(np.sqrt(np.diag(result.covariance)), sigma)
    # (what is shown is filtered reading by reading, what is told with headings folded; and what is
    # told is the wider where scores scatter, and by wider scales of priors)
    ratio = result.history.parameter_sigma[-1] / sigma
    assert np.all(ratio < 1.02)
    if only:
        assert np.all(ratio > 0.98)
    value = np.array([p.value for p in result.parameters])
    assert np.all(np.abs(result.history.parameters[-1] - value) < 0.02 * sigma)
    np.testing.assert_allclose(result.smoothed.parameters[-1], result.history.parameters[-1])
    for kind in result.innovations.values():
        assert len(kind.t) == len(kind.residual) == len(kind.sigma) == len(kind.nis)
        assert np.all(np.diff(kind.t) >= 0)
        assert kind.residual.shape[1] == len(kind.channels)
    assert result.observations == sum(i.residual.size for i in result.innovations.values())
    # body x passes the vertical twice in the turn about y, and that is told
    skipped = result.innovations["heading"].skipped
    assert skipped > 0
    assert any(str(skipped) in w and "heading" in w for w in result.warnings)
    assert seen[-1] == 1.0
    assert seen == sorted(seen)
    with pytest.raises(KeyError):
        result.parameter("gyro_scale", "w")


def test_evidence_is_that_of_the_innovations(turns):
    """A prior start may be given; an absurd one is punished by the evidence."""
    recording, noise = turns
    level = calibrate(recording, assume="fixed-point", noise=noise, only=True)
    begin = from_rest(recording, 0.0, math.radians(100.0), level.rests)
    tilted = so3.matrix_exp(np.array([math.radians(30.0), 0.0, 0.0])) @ begin.C_nb
    wrong = replace(begin, C_nb=tilted, force=None, tilt_sigma=math.radians(2.0))
    other = calibrate(recording, assume="fixed-point", noise=noise, start=wrong, only=True)
    assert other.log_evidence < level.log_evidence - 100.0


# --- what a reviewer found --------------------------------------------------------------------


def with_stream(recording, name, count):
    series = recording.streams[name]
    few = Series(series.t[:count], series.value[:count])
    return replace(recording, streams=dict(recording.streams) | {name: few})


def test_a_few_headings_are_left_out_with_a_word(turns):
    found = calibrate(with_stream(turns[0], "heading", 1), assume="fixed-point", only=True)
    assert any("'heading' was left out" in w for w in found.warnings)
    assert "heading" not in found.innovations


@pytest.mark.parametrize("sigma", [0.0, 1e308])
def test_an_impossible_heading_sigma_is_refused(turns, sigma):
    with pytest.raises(InputError, match="sigma"):
        calibrate(turns[0], heading_sigma=sigma)


def test_an_effect_that_nothing_observes_is_refused(turns):
    with pytest.raises(InputError, match="pose_delay"):
        calibrate(turns[0], ["pose_delay"], assume="fixed-point")


def test_a_clockwise_heading_is_suspected(turns):
    series = turns[0].streams["heading"]
    mirrored = Series(series.t, so3.wrap(-series.value))
    recording = replace(turns[0], streams={"heading": mirrored})
    for given, suspected in ((recording, True), (turns[0], False)):
        said = calibrate(given, assume="fixed-point", only=True).warnings
        assert any("clockwise" in w for w in said) == suspected
