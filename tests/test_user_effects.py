"""Effects from elsewhere: a folder, an installed package; and laws written out as such files."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from proved import proved
from typer.testing import CliRunner

from handcal import effects, user_effects
from handcal.commands import _app
from handcal.compiled import so3
from handcal.effects import (
    ROOM,
    TIME,
    WARMTH,
    Z_DIM,
    Param,
    catalogue,
    observed_error,
    with_effects,
)
from handcal.estimate.forked import in_parallel
from handcal.explanation import Unnamed
from handcal.laws import (
    compositions,
    courses,
    grammar,
    law_effect,
    law_file,
    operators,
    shapes,
    terms,
    vocabulary,
)
from handcal.laws.curve import channel_of, drivers_of
from handcal.laws.drivers import DRIVERS, HEADING, LINE
from handcal.laws.grammar import range_of
from handcal.laws.law_effect import Law
from handcal.laws.vocabulary import driver_of
from handcal.signals import probe
from handcal.types import HandcalError, InputError, Parameter
from handcal_sim import simulate
from handcal_sim.commands.simulate import simulate as simulate_command
from handcal_sim.mcap_writer import write
from handcal_sim.prove.workers import Workers

GOOD = """
import numpy as np
from handcal.effects import Effect, Param

def imu_error(p, signals):
    return p[0] * np.hstack([signals.gyro, signals.accel])

EFFECT = Effect(
    id="own_law", title="Own law", parameters=(Param("k", "1", 0.01),), story="Odd.",
    source="this test", motion="Any.", validated="this test", imu_error=imu_error,
)
"""
# What may be wrong with a file, and what is said of it.
WRONG = {
    "def f(:": "a.py, line 1: invalid syntax",
    "import no_such_module": "a.py cannot be run: ModuleNotFoundError: No module",
    "EFFECT = 3": "a.py is no effect file: it defines no EFFECT = Effect",
    GOOD.replace("own_law", "gyro_scale"): "a.py has an effect 'gyro_scale', and so has the cata",
    GOOD.replace("own_law", "k * omega"): "a.py: an effect's id is one word, not 'k . omega'",
    GOOD.replace("signals.accel", "signals.force"): "a.py: imu_error fails, AttributeError",
    GOOD.replace("hstack", "vstack"): r"a.py: imu_error has to .* \(40, 3\)",
    GOOD.replace("p[0] *", "np.nan *"): "a.py: imu_error has to give finite numbers, and gives nan",
    GOOD.replace('"1", 0.01', '"1", 0.0'): "a.py: the usual size of k has to be a number above",
    GOOD.replace('"1", 0.01', '"1", float("nan")'): "a.py: the usual size of k has to be a number",
    GOOD.replace('(Param("k", "1", 0.01),)', "()"): "a.py: the effect has no parameter",
}
HEADINGS = [f"heading += {f}" for f in terms._HEADING]
# A law's ways: its axes, and whether each has its own constants.
WAYS = [((1,), False), ((0, 1, 2), False), ((0, 1, 2), True)]
CUBE = grammar.formula([("cube", ())])
# A course of each family, as in 80 s, and what comes again.
NUMBERS = (
    ("bump", (30.0, 6.0)), ("bump", (3.0, 1.1, 1.2, 30.0)), ("while", (2.01, 5.13)),
    ("while", (2.01, 3.13, 0.4, 1.1)), ("swing", (25.0, 0.7)), ("decay", (12.0,)),
    ("chirp", (0.05, 0.004, 0.7)), ("fade", (1.71, 3.0)), ("fade", (1.71, 3.0, 0.83)),
    ("ring", (9.0, 7.0, 0.4)),
    ("switched", (1.7, 0.3, 0.6)), ("saw", (1.7, 0.3)), ("lobe", (0.4, 5.0)),
)  # fmt: skip
COURSES = [(c, *n) for c in ("gyro_x", "accel_y", "heading") for n in NUMBERS
           if c == "heading" or n[0] != "lobe"]  # fmt: skip
EDGED = {"while": 0.71, "switched": 0.71, "fade": 0.71}


def folder_with(tmp_path, **files):
    tmp_path.mkdir(exist_ok=True)
    for name, text in files.items():
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    return tmp_path


# Wrong with a recording alone, which is longer than what a file is tried on: after so many samples.
LATE = """
    if len(signals.t) > 100:
        {late}
    return p[0] * np.hstack([signals.gyro, signals.accel])
"""
LATER = {
    "return np.zeros((20, 6))": "samples, and gives (20, 6)",
    "return np.full((len(signals.t), 6), np.inf)": "gives inf of gyro x 0 s after the start",
    "raise ValueError('too long')": "imu_error fails, ValueError: too long",
    "signals.temperature - 25.0": "fails, TypeError",
}


# --- a folder ------------------------------------------------------------------------------------


def test_a_folder_joins_the_catalogue_and_leaves_it_again(tmp_path):
    folder = folder_with(tmp_path, a=GOOD, _helper="raise RuntimeError")
    (folder / "notes.txt").write_text("no effect")
    before = catalogue()
    with user_effects.effects_from(folder):
        assert set(catalogue()) - set(before) == {"own_law"}
        assert effects.select(["own_law"])[0].title == "Own law"
        # threads have the catalogue of whoever began them
        seen = in_parallel((lambda: catalogue()) for _ in range(3))
        assert all("own_law" in known for known in seen)
    assert catalogue() is before
    with pytest.raises(InputError, match="come with --effects-from"):
        effects.select(["own_law"])
    with user_effects.effects_from(None):
        assert catalogue() is before
    assert sorted(p.name for p in folder.iterdir()) == ["_helper.py", "a.py", "notes.txt"]


def test_what_the_catalogue_covers_is_that_of_the_context(tmp_path):
    """Another file of the same name may hold another law."""
    cube = GOOD.replace("np.hstack([signals.gyro, signals.accel])", "np.hstack([signals.gyro**3, 0 "
                        "* signals.accel])")  # fmt: skip
    square = cube.replace("**3", " * np.abs(signals.gyro)")
    forms = [grammar.formula([(name, ())]) for name in ("cube", "signed square")]
    alone = [Law(0, (1,), False, DRIVERS["omega_{i}"], form, (1.0,)) for form in forms]
    whole = [dataclasses.replace(law, axes=(0, 1, 2)) for law in alone]
    for k, text in enumerate((cube, square)):
        with user_effects.effects_from(folder_with(tmp_path, a=text)):
            # (all axes together are one law: of one alone there is still more to know)
            assert not any(law_effect.named(law) for law in alone)
            assert [law_effect.named(law) for law in whole] == [k == 0, k == 1]
        one = text.replace("p[0] * np", "p[0] * np.eye(6)[1] * np")
        with user_effects.effects_from(folder_with(tmp_path, a=one)):
            assert [law_effect.named(law) for law in alone] == [k == 0, k == 1]
    assert not any(law_effect.named(law) for law in (*alone, *whole))


@pytest.mark.parametrize("text", WRONG)
def test_a_file_that_is_none_is_named(tmp_path, text):
    known = catalogue()
    with (
        pytest.raises(InputError, match=WRONG[text]),
        user_effects.effects_from(folder_with(tmp_path, a=text)),
    ):
        pass
    assert catalogue() is known


def test_two_files_with_one_id(tmp_path):
    folder = folder_with(tmp_path, a=GOOD, b=GOOD)
    with (
        pytest.raises(InputError, match=r"b\.py has an effect 'own_law', and so has .*a\.py"),
        user_effects.effects_from(folder),
    ):
        pass


def test_commands_say_what_they_run_and_end_with_one_line(tmp_path):
    folder = folder_with(tmp_path, own="EFFECT = 3")
    calls = [["calibrate", "x.mcap"], ["explain", "x.mcap"], ["replay", "x.mcap", "--no-viewer"],
             ["apply", "x.mcap", "--from", "x.json", "-o", str(tmp_path / "y.mcap")],
             ["conceal", "x.mcap", "--effect", "own=1", "-o", str(tmp_path / "y.mcap")],
             ["design", "poses"], ["design", "motion", "--reduce", "own"],
             ["lab", "scalar", "x.mcap"], ["lab", "known-input", "x.mcap"],
             ["prove", "--n", "1"]]  # fmt: skip
    for call in calls:
        done = CliRunner().invoke(_app.app, [*call, "--effects-from", str(folder)])
        assert done.exit_code == 2, call
        first, second = done.stderr.splitlines()
        assert first.startswith("handcal: running the code of "), call
        assert "own.py is no effect file" in second
    file = tmp_path / "none.txt"
    file.touch()
    for empty, said in (
        (tmp_path / "none", "there is no such folder"),
        (file, "that is a file; name the folder it is in"),
        (folder, "no effect file"),
    ):
        (folder / "own.py").unlink(missing_ok=True)
        done = CliRunner().invoke(_app.app, [*calls[0], "--effects-from", str(empty)])
        assert done.exit_code == 2
        assert said in done.stderr


@pytest.mark.parametrize("late", LATER)
@pytest.mark.parametrize("command", ["conceal", "calibrate"])
def test_what_goes_wrong_with_a_recording_is_said(late, command, tmp_path):
    body = LATE.format(late=late)
    code = GOOD.replace("    return p[0] * np.hstack([signals.gyro, signals.accel])\n", body)
    folder, recording = folder_with(tmp_path / "own", a=code), tmp_path / "a.mcap"
    write(simulate("z-turn", seed=0, duration_s=3.0), recording)
    options = {"conceal": ["--effect", "own_law=0.01", "-o", str(tmp_path / "b.mcap")],
               "calibrate": ["--effects", "own_law"]}[command]  # fmt: skip
    given = [command, str(recording), *options, "--effects-from", str(folder)]
    done = CliRunner().invoke(_app.app, given)
    assert done.exit_code == 2
    assert LATER[late] in " ".join(done.stderr.split())
    assert not (tmp_path / "b.mcap").exists()


@pytest.mark.prove
def test_simulate_hands_the_folder_on(tmp_path):
    assert "effects_from" in simulate_command.__annotations__
    folder, out = folder_with(tmp_path, own_law=GOOD), tmp_path / "a.mcap"
    given = ["simulate", "z-turn", "--duration", "3", "--seed", "0", "--effect", "own_law=0.5"]
    done = CliRunner().invoke(_app.app, [*given, "-o", str(out)])
    assert done.exit_code == 2
    done = CliRunner().invoke(_app.app, [*given, "-o", str(out), "--effects-from", str(folder)])
    assert done.exit_code == 0, done.stderr
    assert out.exists()


# --- installed packages --------------------------------------------------------------------------


@pytest.fixture
def packages(monkeypatch):
    """Pretends that packages are installed that bring these."""
    entries = []

    def bring(**found):
        for name, what in found.items():
            load = (lambda what=what: what) if not isinstance(what, Exception) else None
            entries.append(SimpleNamespace(name=name, value=f"{name}:EFFECT", load=load or fails,
                                           dist=SimpleNamespace(name="some-package")))  # fmt: skip
        effects.installed.cache_clear()

    def fails():
        raise ImportError("it is not complete")

    own = importlib.metadata.entry_points
    monkeypatch.setattr(
        effects, "entry_points",
        lambda group: entries if group == "handcal.effects" else own(group=group),
    )  # fmt: skip
    yield bring
    entries.clear()
    effects.installed.cache_clear()


def test_an_installed_package_brings_an_effect(tmp_path, packages):
    own = user_effects.read(folder_with(tmp_path, a=GOOD) / "a.py")
    assert "own_law" not in catalogue()
    packages(own=own)
    assert catalogue()["own_law"] is own
    with (
        pytest.raises(InputError, match=r"a\.py has an effect 'own_law'"),
        with_effects([("a.py", own)]),
    ):
        pass


@pytest.mark.parametrize(
    ("what", "said"),
    [(3, "is no Effect: odd:EFFECT"), (ImportError(), "cannot be loaded: it is not complete")],
)
def test_a_package_that_brings_none_is_named(packages, what, said):
    packages(odd=what)
    with pytest.raises(InputError, match=f"The installed effect 'odd' of some-package {said}"):
        catalogue()


# --- laws written out ----------------------------------------------------------------------------


def unnamed(effect, values=None):
    """As an explanation has it, with these constants."""
    if values is None:
        values = 0.0123456 * np.arange(1, len(effect.parameters) + 1)
    law, smooth = law_effect.law_of(effect), effect.together is not None
    channels = (channel_of(effect.id),) if law is None else law.channels
    own = tuple(Parameter(effect.id, p.name, v, v / 50, p.unit, p.prior_sigma, None)
                for p, v in zip(effect.parameters, values, strict=True))  # fmt: skip
    return Unnamed(
        effect.id, values[0], values[0] / 50, effect.parameters[0].unit, 52.3, effect.story,
        channels, drivers_of(effect.id), None, () if smooth else own, effect.made,
        tuple(values) if smooth else (),
    )  # fmt: skip


def again(effect, tmp_path, values=None):
    """The effect, written out and read in."""
    path = tmp_path / "odd.py"
    path.unlink(missing_ok=True)
    (path,) = law_file.write([unnamed(effect, values)], path, ["a.mcap"], catalogue())
    own = user_effects.read(path)
    assert own.id == path.stem
    assert "a.mcap" in own.source
    assert max(len(line) for line in path.read_text().splitlines()) <= 100
    return own


def moved():
    """The probing motion, with a rest before it and in it."""
    s = probe(200)
    resting = (s.t < 0.5) | ((s.t > 3.0) & (s.t < 5.0))
    return dataclasses.replace(s, gyro=np.where(resting, 0.02, 1.0)[:, None] * s.gyro)


def forms_over(driver, signals):
    """Every function of the grammar for a driver, two together, and its curve."""
    over = range_of(np.stack([driver.of(signals, a) for a in range(3)]), driver.signed)
    parts = {}
    line, gain = driver.knots == LINE, driver.factor is not None
    all_ = grammar.parts_for(over, driver.signed, driver.round, gain)
    for part in [("line", ())] if line else all_:
        parts.setdefault(part[0], []).append(part)
    some = [tried[len(tried) // 3] for tried in parts.values()]
    yield from (grammar.formula([part]) for part in some)
    if driver.knots != LINE:
        yield grammar.formula(some[-2:])
        if some[-1][1] and len(some[-2][1]) == len(some[-1][1]):
            yield grammar.formula([some[-1], (some[-2][0], some[-1][1])], same=True)
        yield grammar.curves(over, driver.knots, driver.round)[0]


def laws_over(driver, sensor, signals):
    for form in forms_over(driver, signals):
        for axes, each in WAYS:
            if driver.own or len(axes) == 1:
                yield Law(sensor, axes, each, driver, form, (1.0,) * form.constants)


@pytest.mark.prove
def test_every_law_written_out_is_the_law(tmp_path):
    """Every driver, form and way: to a millionth of what it adds."""
    s = moved()
    cold, said = dataclasses.replace(s, streams={}, C_nb=None), set()
    changed = [d.at(1.37 * d.number) for d in list(DRIVERS.values())[::5] if d.at]
    gain = driver_of("omega_{i} by f_{j}")
    for n, driver in enumerate((*DRIVERS.values(), *changed, gain)):
        sensor = n % 2 if driver.only is None else driver.only
        for law in laws_over(driver, sensor, s):
            effect = law_effect.effect_of(law)
            values = 0.01 * np.cos(1.0 + np.arange(len(effect.parameters)))
            own = again(effect, tmp_path, values)
            # (of a curve the file has what was found, k times)
            k = np.ones(3 if law.each else 1) if law.form.smooth else values
            wanted, found = effect.imu_error(values, s), own.imu_error(k, s)
            assert np.abs(found - wanted).max() <= 1e-6 * np.abs(wanted).max(), effect.id
            assert np.abs(wanted).max() > 0.0, effect.id
            assert own.needs == driver.needs
            assert not own.needs or not own.imu_error(k, cold).any()
            check_parameters(own, effect, values, law)
            said |= set(re.split(r" [+&] ", law.form.kind))
    assert said == {*grammar.ATOMS, *grammar.ROUND, grammar.LEVEL[0], "curve", "circle"}


def test_what_an_operator_makes_is_told_from_its_name():
    """An echo that comes on top and one that comes instead differ by the signal alone."""
    for operator in operators.OPERATORS:
        name = operators.said(operator, "omega_x", "rad/s", 0.25)
        assert operators.parsed(name) == (operator, 0.25, "omega_x")
    assert operators.parsed("(play(0.25 rad/s) of omega_x)") is None


@pytest.mark.parametrize("sensor", [0, *proved(1)])
def test_a_law_over_a_further_driver_written_out_is_the_law(tmp_path, sensor):
    """Each kind of them, with one of its numbers: to a millionth of what it adds."""
    s, kinds = moved(), {}
    for driver in vocabulary.further(s, sensor):
        kinds.setdefault(driver.kind, driver)
    words = {o.text[1:].partition("(")[0] for o in operators.OPERATORS.values()}
    assert words <= {kind.partition(" ")[0].lstrip("(") for kind in kinds}
    for n, driver in enumerate(kinds.values()):
        assert vocabulary.driver_of(driver.name).name == driver.name
        laws = list(laws_over(driver, sensor, s))
        for law in laws[n % len(laws) :: len(laws)]:
            effect = law_effect.effect_of(law)
            values = 0.01 * np.cos(1.0 + np.arange(len(effect.parameters)))
            own = again(effect, tmp_path, values)
            k = np.ones(3 if law.each else 1) if law.form.smooth else values
            wanted, found = effect.imu_error(values, s), own.imu_error(k, s)
            assert np.abs(found - wanted).max() <= 1e-6 * np.abs(wanted).max(), effect.id
            assert np.abs(wanted).max() > 0.0, effect.id


def test_a_heading_may_be_as_slow_to_warm_through_as_a_sensor() -> None:
    """(A compass whose error came 11 s after the temperature was friction at a temperature.)"""
    slow = {f"(memory({tau:g} s) of (T - 25) - (T - 25))" for tau in (3.0, 10.0, 30.0)}
    assert slow <= set(DRIVERS)
    assert slow <= {d.name for d in vocabulary.further(moved(), HEADING)}


def test_a_heading_that_depends_on_the_past_written_out_is_the_law(tmp_path):
    s, kinds = moved(), {}
    cold = dataclasses.replace(s, streams={}, C_nb=None)
    made = list(compositions.composed_headings(s))
    felt = [d for d in made if d.factor is not None]
    for driver in (*vocabulary.further(s, HEADING), *made[::60], *felt[::8]):
        kinds.setdefault(driver.kind, driver)
    for driver in kinds.values():
        assert vocabulary.driver_of(driver.name).name == driver.name
        law = Law(HEADING, (0,), False, driver, grammar.formula([("line", ())]), (1.0,))
        effect = law_effect.effect_of(law)
        own = again(effect, tmp_path, np.array([0.1]))
        wanted, found = effect.seen["heading"](s), own.seen["heading"](s)
        assert wanted.shape == found.shape == (len(s.t), 1)
        assert np.abs(found - wanted).max() <= 1e-9 * np.abs(wanted).max(), effect.id
        assert np.ptp(wanted) > 0.0, effect.id
        assert own.needs == driver.needs
        assert not own.needs or not own.seen["heading"](cold).any()


@pytest.mark.parametrize(
    "name",
    ["|alpha_{i}|", "omega_{j} by yaw", "(memory(2.5 s) of |omega|) by yaw", "cos(yaw - 1) by t"],
)
def test_a_curve_of_the_heading_over_any_driver_written_out_is_the_curve(name, tmp_path):
    driver, s = vocabulary.driver_of(name), moved()
    x = driver.course(s, 0)
    form = grammar.curves(range_of(x, driver.signed), 7, driver.round)[2]
    law = Law(HEADING, (0,), False, driver, form, (0.1,) * form.constants)
    effect, c = law_effect.effect_of(law), np.linspace(-0.1, 0.2, form.constants)
    own = again(effect, tmp_path, c)
    wanted, found = effect.seen["heading"](s) @ c, own.seen["heading"](s)[:, 0]
    assert np.abs(found - wanted).max() <= 1e-6 * np.abs(wanted).max()
    assert np.ptp(wanted) > 0.0


@pytest.mark.parametrize("driver", vocabulary.CURVED)
@pytest.mark.parametrize("part", [("limit", (0.4,)), ("cube", ()), ("sign", (0.1,))])
def test_a_formula_of_what_drives_the_heading_written_out_is_the_formula(driver, part, tmp_path):
    form = grammar.formula([part])
    law = Law(HEADING, (0,), False, vocabulary.CURVED[driver], form, (1.0,))
    effect, s = law_effect.effect_of(law), moved()
    own = again(effect, tmp_path, np.array([0.1]))
    wanted, found = effect.seen["heading"](s), own.seen["heading"](s)
    assert np.abs(found - wanted).max() <= 1e-6 * np.abs(wanted).max()
    assert np.ptp(wanted) > 0.0
    assert drivers_of(effect.id) == (driver,)


def check_parameters(own, effect, values, law):
    """A formula's are its own, with what was found as their sizes; a curve's, one for each."""
    assert not own.of_one_day
    if law.form.smooth:
        names = ["k_x", "k_y", "k_z"] if law.each else ["k"]
        assert [(p.name, p.unit, p.prior_sigma) for p in own.parameters] == [
            (name, "1", 1.0) for name in names
        ]
        return
    kept = [[(p.name, p.unit, p.positive) for p in e.parameters] for e in (own, effect)]
    assert kept[0] == kept[1]
    np.testing.assert_allclose(own.prior_sigma, np.abs(values), rtol=0.05)


def test_what_is_known_badly_may_be_as_large_as_that():
    """Found 0.03 and 0.04 sigma: the root of 0.03^2 + 0.04^2 is 0.05."""
    effect = terms.again(HEADINGS[0], 1.0)
    odd = unnamed(effect)
    constants = tuple(dataclasses.replace(p, value=-0.03, sigma=0.04) for p in odd.constants)
    law = law_file.law_of(dataclasses.replace(odd, constants=constants))
    assert [p.prior_sigma for p in law.parameters] == [0.05, 0.05]


def navigated(n=200):
    """States (n, 21) of the probing motion, the time and the temperature."""
    s = probe(n)
    nav, z = np.zeros((n, 21)), np.zeros((n, Z_DIM))
    nav[:, 6:15], nav[:, 15:18], z[:, TIME] = s.C_nb.reshape(n, 9), s.gyro, s.t
    z[:, WARMTH] = s.temperature - ROOM
    assert so3.yaw_of(s.C_nb).std() > 0.5
    return nav, z


def same_on_the_heading(effect, values, own, k, states):
    wanted = observed_error(effect, "heading", values, *states, 1)
    found = observed_error(own, "heading", k, *states, 1)
    assert np.abs(wanted).max() > 0.0
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-6 * np.abs(wanted).max())


@pytest.mark.parametrize("formula", HEADINGS)
def test_a_formula_of_the_heading_written_out_is_the_formula(formula, tmp_path):
    effect = terms.again(formula, 1.0)
    own, values = again(effect, tmp_path), np.array([0.7, -0.4])[: len(effect.parameters)]
    assert [(p.name, p.unit) for p in own.parameters] == [
        (p.name, p.unit) for p in effect.parameters
    ]
    same_on_the_heading(effect, values, own, values, navigated())


@pytest.mark.parametrize("driver", terms.CURVES)
def test_a_curve_of_the_heading_written_out_is_the_curve(driver, tmp_path):
    effect = terms.curve(driver, 1.0, 1.0)
    values = np.cos(np.arange(len(effect.parameters)) ** 2)
    nav, z = navigated()
    # (both ends of a circle, faster than any table, and upright)
    more = np.zeros((5, 21))
    more[:, [6, 9]] = [[-1.0, 0.0], [-1.0, -0.0], [-1.0, -1e-9], [1.0, 0.0], [0.0, 1.0]]
    more[:, [14, 17]] = [[1.0, 99.0], [1.0, -99.0], [-1.0, 0.0], [0.5, 20.0], [0.0, 0.0]]
    states = np.vstack([nav, more]), np.vstack([z, z[:5]])
    same_on_the_heading(effect, values, again(effect, tmp_path, values), np.ones(1), states)


@pytest.mark.parametrize(("channel", "kind", "numbers"), COURSES)
def test_a_course_written_out_is_the_course(channel, kind, numbers, tmp_path):
    effect, k = shapes.again(channel, (kind, numbers)), np.array([0.7])
    own = again(effect, tmp_path)
    assert own.of_one_day == (kind not in ("decay", "ring", "lobe"))
    assert [(p.name, p.unit, p.prior_sigma) for p in own.parameters] == [
        ("k", effect.parameters[0].unit, 0.012)
    ]
    if channel == "heading":
        same_on_the_heading(effect, k, own, k, navigated())
        return
    wanted, found = (e.imu_error(k, probe(400)) for e in (effect, own))
    # (a while begins between two samples, on a slope for the search's sake)
    off = EDGED.get(kind, 1e-6 * np.abs(wanted).max())
    assert np.abs(found - wanted).max() <= off
    assert np.mean(np.abs(found - wanted) > 1e-6) < 0.1
    assert np.abs(wanted).max() > 0.0


def test_a_burst_is_written_as_a_while():
    """It has no constants beside its size."""
    burst = Unnamed("heading += k from 2.0 s to 5.1 s", 0.5, 0.02, "rad", 9.0, "", ("heading",),
                    ("t",), None, (), ("while", (2.01, 5.13)))  # fmt: skip
    law = law_file.law_of(burst)
    assert law.of_heading
    assert law.of_one_day
    assert law.parameters == (Param("k", "rad", 0.5),)


def test_every_course_that_there_is_has_a_writer_and_nothing_else_has():
    families = {f.name for f in (*courses.OVER_TIME, *courses.OVER_YAW)}
    assert families == set(law_file.COURSES) == {n[0] for n in NUMBERS}
    known = unnamed(terms.again(HEADINGS[0], 1.0))
    curved = unnamed(terms.curve("tilt", 1.0, 1.0))
    over = law_effect.effect_of(Law(0, (0,), False, DRIVERS["omega_{i}"], CUBE, (1.0,)))
    for odd in (
        dataclasses.replace(known, made=("something else", ())),
        dataclasses.replace(known, formula="heading += k * omega_x"),
        dataclasses.replace(curved, coefficients=()),
        dataclasses.replace(unnamed(over), made=(over.made[0].replace("omega", "zeal"), (1.0,))),
    ):
        with pytest.raises(HandcalError, match="cannot be written"):
            law_file.law_of(odd)


def test_several_laws_are_several_files_and_none_is_overwritten(tmp_path):
    both = [
        unnamed(law_effect.effect_of(Law(sensor, (0,), False, DRIVERS[name], CUBE, (1.0,))))
        for sensor, name in enumerate(("omega_{i}", "f_{i}"))
    ]
    (tmp_path / "odd_2.py").write_text("mine")
    found = law_file.write(both, tmp_path / "odd.py", ["a.mcap", "b.mcap"], [*catalogue(), "odd_3"])
    assert [p.name for p in found] == ["odd.py", "odd_4.py"]
    assert (tmp_path / "odd_2.py").read_text() == "mine"
    one, other = (user_effects.read(p) for p in found)
    assert (one.id, other.id) == ("odd", "odd_4")
    assert one.title == "Law of gyro_x: k * omega_x^3"
    assert "found in a.mcap, b.mcap" in other.source


def test_a_recordings_name_is_no_code(tmp_path):
    """Whoever names a recording must not be able to write what is run."""
    name = 'a"""\nraise RuntimeError\n"""' + "'); raise RuntimeError(\\" + "\udcff\u2713.mcap"
    law = unnamed(shapes.again("gyro_x", ("decay", (12.0,))))
    (path,) = law_file.write([law], tmp_path / "odd.py", [name], catalogue())
    own = user_effects.read(path)
    assert own.source == f"found in {name} by handcal explain".replace("\n", " ")


@pytest.mark.parametrize(
    ("name", "said"),
    [("odd.txt", "expected a name such as"), ("2nd.py", "expected a name such as"),
     ("_odd.py", "expected a name such as"), ("gyro_scale.py", "there is an effect gyro_scale"),
     ("there.py", "that file exists"), ("none/none/odd.py", "there is no folder")],
)  # fmt: skip
def test_a_file_that_cannot_be_written_is_said_before_the_work(name, said, tmp_path):
    (tmp_path / "there.py").write_text("mine")
    given = ["explain", "x.mcap", "--write-effect", str(tmp_path / name)]
    done = CliRunner().invoke(_app.app, given)
    assert done.exit_code == 2
    assert said in done.stderr
    assert (tmp_path / "there.py").read_text() == "mine"


@pytest.mark.prove
def test_the_processes_of_a_trial_have_the_folder_too(tmp_path):
    world = simulate("z-turn", seed=0, duration_s=8.0)
    write(world, tmp_path / "a.mcap", truth=False)
    folder = folder_with(tmp_path, own_law=GOOD)
    workers = Workers([sys.executable, "-m", "handcal_sim.prove", str(folder)], 1)
    try:
        document, _ = workers(tmp_path / "a.mcap")
    finally:
        workers.stop()
    assert "own_law" in {h["effect"] for h in document["hypotheses"]}, document
