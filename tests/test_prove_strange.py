"""The suite `strange`: what its laws are, how they are drawn, and how an explanation is judged."""

import dataclasses
import io
import itertools
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import schemas
from prove_help import parameter, said
from rich.console import Console

from handcal.effects import Signals, catalogue
from handcal.laws import grammar
from handcal.laws.compositions import composed, composed_headings
from handcal.laws.courses import OVER_TIME, Family
from handcal.laws.curve import drivers_of
from handcal.laws.drivers import DRIVERS, HEADING, LINE
from handcal.laws.law_effect import Law
from handcal.laws.vocabulary import further
from handcal_sim.effects import EFFECTS
from handcal_sim.mcap_writer import write
from handcal_sim.prove import draw, draw_strange, score, score_strange
from handcal_sim.prove.further import worked_out
from handcal_sim.prove.given import Circumstances, Ticket, simulated
from handcal_sim.prove.show import show
from handcal_sim.prove.suites import SUITES, Answer
from handcal_sim.prove.told import told
from handcal_sim.prove.trial import Trial
from handcal_sim.strange import known, law
from handcal_sim.strange.device import LATEST, LAWS, MOST, SIZES, own_scene, with_laws
from handcal_sim.strange.formulas import value_of
from handcal_sim.strange.left import curves, left_share
from handcal_sim.strange.memory import lagged
from handcal_sim.strange.words import core, same
from handcal_sim.strangers import scene_of

# A tenth of a law's size that no known effect takes is one in a hundred of its power: below that,
# who names the known effect has described the device.
DISTINCT = 0.1
KNOTS = ((0.0, 20.0), (17.0, 26.0), (34.0, 35.0), (50.0, 33.0), (67.0, 22.0), (84.0, 30.0))


def warm_and_cold(phone):
    return dataclasses.replace(
        phone, thermometer=dataclasses.replace(phone.thermometer, knots=KNOTS)
    )


@pytest.fixture(scope="module")
def world():
    given = Circumstances(
        "free-hand", 84.0, rate_hz=100.0, sway=1.0, noise=1.0, heading_sigma_deg=3.0,
        heading_hz=50.0, mag=False, pose=False, thermometer=True, warming_K=15.0, seed=0,
    )  # fmt: skip
    return simulated(given, {}, refit=warm_and_cold)


@pytest.fixture(scope="module")
def scene(world):
    return scene_of(world)


@pytest.fixture(scope="module")
def errors(scene):
    """By law and seed: the sensor, the error, and what no known effect takes of it."""
    found = {}
    for name, seed in itertools.product(LAWS, range(2)):
        strange = law.drawn(LAWS[name], 0, seed)
        at = own_scene(scene, strange.channel)
        error = strange.error_of(at)
        left = known.remainder(at, strange.channel, error)
        found[name, seed] = (LAWS[name].sensor, error, left)
    return found


# ---- the laws -------------------------------------------------------------------------------


def test_there_are_more_laws_than_a_full_trial_asks_for():
    assert len(LAWS) >= SUITES["strange"].full >= 150
    assert all(one.why.endswith(".") and len(one.why) > 15 for one in LAWS.values())


def test_the_latest_laws_are_drawn_in_turn_and_judged_like_the_others():
    tickets = [Ticket("latest", number, 3) for number in range(SUITES["latest"].full)]
    firsts = [draw_strange.case_of(t).laws[0][0].strange.law for t in tickets[:4]]
    assert set(firsts) < set(LATEST) < set(LAWS)
    assert len(set(firsts)) == 4
    assert len(LATEST) == SUITES["latest"].full


@pytest.mark.prove
def test_every_law_is_finite_and_the_same_for_the_same_seed(scene, errors):
    for (name, seed), (_, error, _) in errors.items():
        strange = law.drawn(LAWS[name], 0, seed)
        at = own_scene(scene, strange.channel)
        assert error.shape == at.t.shape, name
        assert np.all(np.isfinite(error)), name
        assert law.rms(error) > 0.0, name
        np.testing.assert_array_equal(error, strange.error_of(at), err_msg=name)


def test_every_declared_driver_counts_and_no_other(scene, monkeypatch):
    plain, asked = law.signal, []

    def backwards(of):
        def signal(at, name):
            asked.append(name)
            return plain(at, name)[::-1].copy() if name == of else plain(at, name)

        return signal

    for one in LAWS.values():
        strange = law.drawn(one, 1, 0)
        at = own_scene(scene, strange.channel)
        drivers = [law.bare(driver) for driver in strange.drivers]
        before = strange.error_of(at)
        for driver in drivers:
            monkeypatch.setattr(law, "signal", backwards(driver))
            asked.clear()
            after = strange.error_of(at)
            assert asked == drivers, one.name
            assert law.rms(after - before) > 0.01 * law.rms(before), one.name
            monkeypatch.setattr(law, "signal", plain)


def test_only_the_past_may_count_where_it_is_said_to(scene):
    """At an instant, a law without past gives the same whatever came before."""
    for one in LAWS.values():
        strange = law.drawn(one, 2, 1)
        at = own_scene(scene, strange.channel)
        whole = strange.error_of(at)
        alone = all(
            np.allclose(whole[cut:][5:], strange.error_of(later(at, cut))[5:], rtol=1e-9, atol=1e-9)
            for cut in range(1000, 4000, 300)
        )
        assert alone != any(d.startswith("past ") for d in strange.drivers), one.name


def later(at, cut):
    names = [f.name for f in dataclasses.fields(at) if f.name != "at_heading"]
    return dataclasses.replace(at, at_heading=None, **{n: getattr(at, n)[cut:] for n in names})


@pytest.mark.prove
def test_no_law_is_what_the_catalogue_knows(errors):
    """However much of all its effects together is taken, with the best numbers."""
    shares = {key: law.rms(left) / law.rms(error) for key, (_, error, left) in errors.items()}
    assert {key: share for key, share in shares.items() if share < DISTINCT} == {}


@pytest.mark.prove
def test_no_two_laws_are_alike(errors):
    """Beyond the catalogue, each leaves a tenth of itself when the other is taken."""
    unit = {key: (s, left / np.linalg.norm(left)) for key, (s, _, left) in errors.items()}
    alike = [
        (one, other)
        for (one, (a, x)), (other, (b, y)) in itertools.combinations(unit.items(), 2)
        if a == b and one[0] != other[0] and 1.0 - np.dot(x, y) ** 2 < DISTINCT**2
    ]
    assert alike == []


def test_the_columns_hold_every_effect_of_the_catalogue(world, scene):
    """Of all effects on the IMU, as the program on trial has them, next to nothing is left."""
    rng = np.random.default_rng(0)
    signals = Signals(
        scene.t, scene.omega, scene.f, C_nb=world.truth.C_nb, alpha=scene.alpha,
        streams={"temperature": scene.warm[:, None] + 25.0},
    )  # fmt: skip
    seen = set()
    for effect in catalogue().values():
        if effect.imu_error is None or effect.process is not None:
            continue
        values = rng.uniform(0.5, 1.5, len(effect.parameters)) * [
            p.prior_sigma for p in effect.parameters
        ]
        if "at" in [p.name for p in effect.parameters]:
            values[-1] = 42.0
        adds = effect.imu_error(values, signals)
        for column, channel in enumerate([f"{s}_{a}" for s in ("gyro", "accel") for a in "xyz"]):
            if law.rms(adds[:, column]) > 1e-9:
                seen.add(effect.id)
                left = known.seen(scene, channel, adds[:, column])
                # Delays and low passes are of more than first order, which tremor shows most.
                assert law.rms(left) < 0.07 * law.rms(adds[:, column]), (effect.id, channel)
    assert {"gyro_scale", "size_effect", "accel_delay", "gyro_bandwidth", "gyro_temperature",
            "gyro_quadratic", "accel_asymmetry", "gyro_g_sensitivity"} <= seen  # fmt: skip


# ---- how they are drawn -------------------------------------------------------------------


def test_only_the_declared_channels_err(monkeypatch):
    monkeypatch.setattr(draw_strange, "with_laws", lambda world, _: world)
    for number in range(8):
        ticket = Ticket("strange", number, 1)
        case = draw_strange.case_of(ticket)
        (added, *_) = case.laws
        changed = with_laws(case.world, added)
        names = [f"{s}_{a}" for s in ("gyro", "accel") for a in "xyz"]
        off = (changed.imu.values != case.world.imu.values).any(axis=0)
        erring = {name for name, differs in zip(names, off, strict=True) if differs}
        if np.any(changed.streams["heading"].values != case.world.streams["heading"].values):
            erring.add("heading")
        assert erring == {one.strange.channel for one in added}


@pytest.mark.prove
def test_laws_come_in_turn_beside_up_to_two_effects():
    counts, kinds, sensors, first = set(), [], [], set()
    for number in range(14):
        _, answer = draw.draw("strange", number, 2)
        laws = answer.stranger["laws"]
        counts.add(len(set(answer.effects) - {"lever_arm"}))
        kinds.append(len(laws))
        first.add(laws[0]["law"])
        sensors.append({c.partition("_")[0] for one in laws for c in one["channels"]})
        for one in laws:
            sensor = one["channels"][0].partition("_")[0]
            assert max(one["rms"]) <= MOST[sensor] * (1.0 + 1e-6)
            assert max(one["left"]) > 0.5 * SIZES[sensor][0] or max(one["rms"]) > 0.1 * MOST[sensor]
            assert len(one["drivers"]) == len(one["channels"])
    assert {0, 1, 2} <= counts
    assert len(first) == 14
    assert 1 <= kinds.count(2) <= 7
    assert all(len(s) == n for s, n in zip(sensors, kinds, strict=True))


# ---- how an explanation is judged -----------------------------------------------------------


def entry(channels, drivers, curve=None):
    return {"formula": f"{channels[0]} += ...", "channels": channels, "drivers": drivers,
            "curve": curve, "constants": []}  # fmt: skip


def unexplained(*unnamed, missing=()):
    return {**said(*missing, verdict="unexplained"), "unnamed": list(unnamed)}


PLAY = {"law": "play", "channels": ["accel_y"], "drivers": [["past f_y"]], "formula": "", "k": 1.0}
SHAFT = {"law": "size", "channels": ["gyro_x", "gyro_y"], "drivers": [["|omega|"], ["|omega|"]],
         "formula": "", "k": 1.0}  # fmt: skip

OWN = {"law": "own", "channels": ["gyro_x", "gyro_z"], "drivers": [["alpha_x"], ["alpha_z"]],
       "formula": "", "k": 1.0}  # fmt: skip


def judged(document, *laws, effects=()):
    truth = {name: {"x": 1.0} for name in effects}
    answer = Answer("strange", "", truth, {"kind": "k", "laws": list(laws)})
    return Trial("r0001", answer, document, 1.0)


RIGHT = entry(["accel_y"], ["f_y"])


@pytest.mark.parametrize(
    ("document", "laws", "effects", "expected"),
    [
        (unexplained(RIGHT), [PLAY], [], "exact"),
        (unexplained(RIGHT, missing=["gyro_scale"]), [PLAY], ["gyro_scale"], "exact"),
        (unexplained(entry(["accel_y"], ["t"])), [PLAY], [], "right_set"),
        (unexplained(RIGHT, missing=["gyro_scale"]), [PLAY], [], "false"),
        (unexplained(entry(["accel_x"], ["f_y"])), [PLAY], [], "wrong"),
        (unexplained(), [PLAY], [], "wrong"),
        (said("accel_scale"), [PLAY], [], "wrong"),
        (said("accel_scale"), [PLAY], ["accel_scale"], "missed"),
        (said(), [PLAY], [], "missed"),
        ({**unexplained(RIGHT), "verdict": "explained"}, [PLAY], [], "missed"),
        ({"error": "x"}, [PLAY], [], "failed"),
        (unexplained(entry(["gyro_x"], ["|omega|"])), [SHAFT], [], "wrong"),
        (unexplained(entry(["gyro_x", "gyro_y"], ["|omega|"])), [SHAFT], [], "exact"),
        (unexplained(RIGHT), [PLAY, SHAFT], [], "wrong"),
        (unexplained(entry(["gyro_x", "gyro_y", "gyro_z"], ["alpha_i"])), [OWN], [], "exact"),
        (unexplained(entry(["gyro_x", "gyro_y", "gyro_z"], ["alpha_j"])), [OWN], [], "right_set"),
    ],
)
def test_outcomes(document, laws, effects, expected):
    assert score.outcome(judged(document, *laws, effects=effects)) == expected


@pytest.mark.parametrize(
    ("found", "true", "right"),
    [
        (["omega_x"], ["past omega_x"], True), (["omega_x"], ["omega_y"], False),
        (["|omega|"], ["past |omega|"], True), (["size of omega"], ["|omega|"], True),
        (["omega_x", "omega_y", "omega_z"], ["|omega|"], True), (["omega_x"], ["|omega|"], False),
        (["pitch of x"], ["up_x"], True), (["f_x"], ["up_x"], True), (["f_y"], ["up_x"], False),
        (["yaw"], ["heading"], True), (["temperature"], ["past T"], True),
        (["past of T"], ["past T"], True), (["t"], ["T"], False),
        (["omega_x", "f_y"], ["f_y", "omega_x"], True), (["omega_x"], ["omega_x", "f_y"], False),
        (["omega_x", "f_y", "t"], ["omega_x", "f_y"], False), (["f_z"], ["tilt"], True),
        (["tilt"], ["up_y"], True), (["heading", "tilt"], ["north_x"], True),
        (["past heading"], ["past turn"], True), (["|omega_x|"], ["omega_x"], True),
        (["something else"], ["omega_x"], False), (["time since a turn"], ["past |omega|"], True),
        (["time since a turn"], ["t"], False), (["yaw rate"], ["turn"], True),
        (["alpha_x"], ["past omega_x"], True), (["alpha_x"], ["omega_x"], False),
        (["jerk_y"], ["past up_y"], True), (["alpha_y"], ["past omega_x"], False),
        (["alpha_x"], ["alpha_x"], True), (["yaw rate"], ["past heading"], True),
        (["yaw rate"], ["heading"], False),
    ],
)  # fmt: skip
def test_drivers_are_the_same_whatever_they_are_called(found, true, right):
    assert same(found, true) is right


@pytest.mark.parametrize("axis", range(3))
def test_a_law_of_all_axes_is_driven_on_each_by_its_own(axis):
    """What is called omega_i is omega_y on y, omega_j there is omega_z."""
    channel, (i, j, k) = f"accel_{'xyz'[axis]}", ("xyz" * 2)[axis : axis + 3]
    assert same(["omega_i"], [f"omega_{i}"], channel)
    assert same(["omega_j", "f_k"], [f"omega_{j}", f"f_{k}"], channel)
    assert not same(["omega_i"], [f"omega_{j}"], channel)
    assert same(["T"], ["past T"], channel)


def test_every_law_has_the_drivers_that_it_has():
    """No two drivers of different laws fall together, but where one describes the other."""
    for one in LAWS.values():
        drivers = law.drawn(one, 0, 0).drivers
        assert same(drivers, drivers)
        assert all(core(core(driver)) == core(driver) for driver in drivers)


def test_a_true_curve_leaves_nothing_and_none_everything(scene):
    """Of a law of one driver, its own curve at 2000 points, beside its device's other errors."""
    case = draw_strange.case_of(ticket_of("gyro_cubic_of_omega_i"))
    scene, (added, *_) = scene_of(case.world), case.laws
    true = [
        parameter(effect, p["name"], p["value"])
        for effect, given in case.world.parameters["effects"].items()
        for p in given
    ]
    nothing = said(parameters=true)
    assert left_share(added, case.world, nothing) == pytest.approx(1.0)
    told = []
    for one in added:
        u = np.linspace(-4.0, 4.0, 2000)
        channel, (driver,) = one.strange.channel, one.strange.drivers
        told.append(entry([channel], [driver], {"x": u.tolist(), "y": (one.k * u**3).tolist()}))
    assert left_share(added, case.world, {**nothing, "unnamed": told}) < 1e-3
    wrong = [p for p in true if p["effect"] != "gyro_bias"]
    assert left_share(added, case.world, {**said(parameters=wrong), "unnamed": told}) < 1e-3
    scaled = [*true, *(parameter("gyro_scale", axis, 0.01) for axis in "xyz")]
    worse = left_share(added, case.world, {**said(parameters=scaled), "unnamed": told})
    assert worse > 0.05 or "gyro_scale" in case.effects
    odd = {
        **nothing,
        "unnamed": [entry([added[0].strange.channel], ["zeal"], {"x": [0], "y": [0]})],
    }
    assert left_share(added, case.world, odd) is None
    assert curves([], "gyro_x", scene).tolist() == [0.0] * len(scene.t)


def test_a_heading_is_counted_from_where_an_explanation_has_north():
    """The law of a compass, told of headings that count from 0.3 rad off the true north."""
    case = draw_strange.case_of(ticket_of("heading_rectified_wave_of_heading"))
    (added, *_) = case.laws
    north, x = 0.3, np.linspace(-np.pi, np.pi, 4000)
    at = scene_of(case.world).at_heading
    there = dataclasses.replace(at, t=x, heading=x - north)
    curve = {"x": x.tolist(), "y": (added[0].k * added[0].strange.error_of(there) - north).tolist()}
    true = [
        parameter(effect, p["name"], p["value"])
        for effect, given in case.world.parameters["effects"].items()
        for p in given
    ]
    told = {**entry(["heading"], ["heading"], curve), "formula": "heading += g(yaw)"}
    one = {**said(parameters=true), "unnamed": [told]}
    assert left_share(added, case.world, one) < 0.02


@pytest.mark.prove
@pytest.mark.parametrize(
    "channel",
    ["gyro_y", "accel_z", "heading"],
)
def test_what_a_formula_adds_is_known_here(world, scene, channel):
    """Of each driver, in the words of its formula: only the law itself is not the same."""
    signals = Signals(
        scene.t, scene.omega, scene.f, C_nb=world.truth.C_nb,
        streams={"temperature": scene.warm[:, None] + 25.0},
    )  # fmt: skip
    sensor = ("gyro", "accel", "heading").index(channel.partition("_")[0])
    axis = "xyz".index(channel[-1]) if sensor < HEADING else 0
    form = grammar.formula([("line", ())])
    usual = DRIVERS.values() if sensor < HEADING else ()
    made = list((composed if sensor < HEADING else composed_headings)(signals))[::40]
    # (what has steps, or remembers how it began, makes one of the least difference between two
    # rates of change)
    steps = "(side", "(stick", "(steps", "(friction", "(play", "(memory"
    made = [
        d
        for d in made
        if not (d.kind.startswith(steps) and ("alpha" in d.kind or "jerk" in d.kind))
    ]
    for driver in (*usual, *further(signals, sensor), *made):
        told = Law(sensor, (axis,), False, driver, form, (1.0,))
        true = told.values(signals, axis)[:, 0]
        one = {**entry([channel], []), "formula": told.said,
               "constants": [{"name": "k", "value": 1.0}]}  # fmt: skip
        found = curves([one], channel, scene)
        # (the program on trial has rates of change by differences; of an app's map of north the
        # simulator has the true one)
        close = 0.15 if driver.kind.startswith(("(swing", "(sway", "(slew")) else 0.1
        assert law.rms(found - true) <= close * law.rms(true), told.said


def test_every_function_of_a_formula_is_known_here(world, scene):
    signals = Signals(scene.t, scene.omega, scene.f, C_nb=world.truth.C_nb)
    for each in (False, True):
        for part in grammar.parts_for(grammar.Range(-3.0, 3.0, 0.2), signed=True, round_=False):
            own = grammar.formula([part, ("square", ())])
            waves = grammar.formula([("sine", (0.7,)), ("cosine", (0.7,))], same=True)
            form = waves if part[0] == "sine" else own
            told = Law(0, (0, 1, 2), each, DRIVERS["omega_{i}"], form, (1.0, 1.0))
            true = told.values(signals, 1) @ [0.7, -0.2]
            names = ("k1_y", "k2_y") if each else ("k1", "k2")
            constants = [{"name": n, "value": v} for n, v in zip(names, (0.7, -0.2), strict=True)]
            one = {**entry(list(told.channels), []), "formula": told.said, "constants": constants}
            found = curves([one], "gyro_y", scene)
            # (a formula has four digits, and there are samples beside a step)
            assert law.rms(found - true) < 0.2 * law.rms(true), told.said


@pytest.mark.parametrize("text", ["heading += k * __import__('os')", "heading += k * t.size",
                                  "heading += (lambda: k)()", "heading += k * [t][0]"])  # fmt: skip
def test_a_formula_is_arithmetic_and_nothing_else(scene, text):
    one = {**entry(["heading"], []), "formula": text, "constants": [{"name": "k", "value": 1.0}]}
    assert curves([one], "heading", scene.at_heading or scene) is None


@pytest.mark.parametrize("channel", ["gyro_y", "accel_z"])
def test_what_explain_draws_a_curve_over_is_known_here(world, scene, channel):
    """Each driver of a curve, in the words of its formula."""
    signals = Signals(
        scene.t, scene.omega, scene.f, C_nb=world.truth.C_nb,
        streams={"temperature": scene.warm[:, None] + 25.0},
    )  # fmt: skip
    sensor, axis = int(channel.startswith("accel")), "xyz".index(channel[-1])
    for driver in (*DRIVERS.values(), *further(signals, sensor)):
        if driver.knots == LINE or driver.round:
            continue
        x = driver.of(signals, axis)
        form = grammar.curves(grammar.range_of(x, driver.signed), driver.knots, False)[0]
        told = Law(sensor, (axis,), False, driver, form, (1.0,) * form.constants)
        curve = {"x": [x.min(), x.max()], "y": [0.0, 1.0], "x_unit": driver.unit}
        one = {**entry([channel], list(drivers_of(told.said)), curve), "formula": told.said}
        found = curves([one], channel, scene)
        true = np.interp(x, curve["x"], curve["y"]) * driver.scale(signals, axis)
        assert law.rms(found - true) < 0.03 * law.rms(true), told.said
    each = {**one, "formula": "gyro_xyz += g_i(omega_i)", "channels": ["gyro_x", channel]}
    assert curves([each], channel, scene) is None


def ticket_of(name, seed=0):
    for number in range(len(LAWS)):
        ticket = Ticket("strange", number, seed)
        if draw_strange.in_turn(list(LAWS), ticket) == name:
            return ticket
    raise AssertionError(name)


def test_a_trial_is_worked_out_scored_and_shown():
    # (what is nothing is said below for an IMU's law, not for a heading's)
    ticket = next(
        ticket for n in range(len(LAWS)) for ticket in [Ticket("strange", n, 0)]
        if not draw_strange.in_turn(list(LAWS), ticket).startswith("heading")
    )  # fmt: skip
    world, answer = draw.draw("strange", ticket.number, ticket.seed)
    laws = answer.stranger["laws"]
    right = unexplained(*(
        entry([channel], drivers)
        for one in laws for channel, drivers in zip(one["channels"], one["drivers"], strict=True)
    ))  # fmt: skip
    assert worked_out(ticket, {"error": "x"}) == {}
    further = worked_out(ticket, said())
    assert set(further) == {f"left_{n}" for n in range(1, len(laws) + 1)}
    assert all(0.5 < share < 3.0 for share in further.values())
    nothing = {**said(), "hand": {"id": "held"}, "fit": {"after": {"log_evidence": 100.0}}}
    likelier = {"told_1": 0.02, "form_1": 0.009, "told_log_evidence": 110.0}
    trials = [
        Trial("r0001", answer, right, 1.0, further={"left_1": 0.005}),
        Trial("r0002", answer, nothing, 1.0, further={**further, **likelier}),
        Trial("r0003", answer, {"error": "Traceback\nValueError: odd"}, 1.0),
        Trial("r0004", answer, {**right, **said("mag_gradient"), "unnamed": []}, 1.0),
    ]
    proof = score.score(trials, 0)
    schemas.check(proof)
    figures = proof["further"]["strange"]
    counts = {k: v["count"] for k, v in figures.items() if k != "laws"}
    assert counts == {"told": 1, "driver": 1, "clean": 1, "false": 1, "little_left": 1,
                      "nothing_left": 1, "nothing_left_if_told": 1, "nothing_left_if_form": 2,
                      "truth_is_likelier": 1}  # fmt: skip
    assert figures["nothing_left_if_told"]["n"] == 2
    assert figures["told"]["n"] == 4
    assert figures["laws"][0]["channel"] is figures["laws"][0]["driver"] is True
    assert figures["laws"][-1]["false"] == ["mag_gradient"]
    out = Console(file=io.StringIO(), width=160)
    show(score.score(trials, 0), out)
    printed = out.file.getvalue()
    assert laws[0]["law"] in printed
    assert "25.0 %" in printed
    assert score_strange.score([])["told"]["n"] == 0
    assert set(EFFECTS) >= set(answer.effects)
    assert world.streams["heading"].values.shape[1] == 1


@pytest.mark.prove
def test_told_the_law_itself_calibrate_leaves_what_the_noise_does(tmp_path):
    """A small part, and not nothing: not more than everything, nor that of a wrong size."""
    for number in range(len(LAWS)):
        ticket = Ticket("strange", number, 0)
        case = draw_strange.case_of(ticket)
        if not case.effects and case.laws[0][0].strange.channel.startswith("gyro"):
            break
    world, answer = draw.draw("strange", ticket.number, ticket.seed)
    file = tmp_path / "x.mcap"
    write(world, file, truth=False)
    names = [f"left_{n}" for n in range(1, len(case.laws) + 1)]
    assert told(ticket, answer, file, dict.fromkeys(names, 0.01)) == {}
    found = told(ticket, answer, file, {})
    assert 1e-5 < found["told_1"] < 0.05
    assert math.isfinite(found["told_log_evidence"])
    true = [
        {"effect": effect, "name": p["name"], "value": p["value"]}
        for effect, given in case.world.parameters["effects"].items()
        for p in given
    ]
    wrong = draw_strange.left_of_sizes(ticket, true, [[0.9]] * len(case.laws), free=False)
    assert wrong == {name: pytest.approx(0.1) for name in names}
    assert 1e-5 < found["form_1"] < 0.3


def test_a_law_changes_by_its_numbers_as_its_formula_says(scene):
    """A low pass, by its time constant of 1.5 to 6 s; a product has no numbers; of bumps at three
    places with one width each number counts."""
    named = {one.name: one for one in LAWS.values()}
    settles = named["gyro_settling_of_past_omega_j"]
    one = law.drawn(settles, 0, 5)
    tau = np.random.default_rng(5).uniform(1.5, 6.0)
    u = law.signal(scene, law.bare(one.drivers[0]))
    by_tau = (lagged(scene.t, u, 1.001 * tau) - lagged(scene.t, u, 0.999 * tau)) / (0.002 * tau)
    columns = one.by_numbers(scene)
    assert columns.shape == (len(scene.t), 1)
    assert law.rms(columns[:, 0] - 4.5 * by_tau) < 1e-3 * law.rms(4.5 * by_tau)
    product = next(one for name, one in named.items() if "_product_of_" in name)
    assert law.drawn(product, 0, 5).by_numbers(scene).shape == (len(scene.t), 0)
    bumps = next(one for name, one in named.items() if "_bursts_of_t" in name)
    assert law.drawn(bumps, 0, 5).by_numbers(scene).shape == (len(scene.t), 4)


@pytest.mark.parametrize("family", OVER_TIME, ids=lambda f: f.name)
def test_the_text_of_a_course_is_the_course(family: Family) -> None:
    """To a half of a percent at any moment, but for the sample in which it jumps."""
    t, rng = np.arange(0.0, 84.0, 0.01), np.random.default_rng(0)
    starts = list(family.starts(84.0))
    at: Any = SimpleNamespace(t=t + 3.0)
    for n in rng.integers(0, len(starts), 20):
        numbers = np.array(starts[n]) * (1.0 + 0.01 * rng.standard_normal(len(starts[n])))
        options = [numbers]
        if family.again is not None:
            beside = np.array(starts)[family.again(numbers, np.array(starts))]
            options += [np.r_[numbers, one[: family.moment]] for one in beside[:1]]
        for some in options:
            course = family.values(some, t)
            entry = {"formula": f"gyro_x += k * {family.formula(some)}",
                     "constants": [{"name": "k", "value": 1.0}]}  # fmt: skip
            wrong = np.abs(value_of(entry, "gyro_x", at) - course) > 0.005
            jumps = int((np.abs(np.diff(course)) > 0.4).sum())
            assert wrong.sum() <= jumps, family.formula(some)
