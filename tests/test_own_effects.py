"""Effects from elsewhere: a folder, an installed package; and laws written out as such files."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from handcal import cli, effects, own_effects, so3
from handcal.effects import TIME, Z_DIM, catalogue, observed_error, with_effects
from handcal.estimate.beside import side_by_side
from handcal.explain import law_file, shapes, terms
from handcal.explain.curve import channel_of, drivers_of
from handcal.explain.explanation import Unnamed
from handcal.signals import probe, some
from handcal.types import HandcalError, InputError
from handcal_sim import simulate
from handcal_sim.commands import simulate as simulate_command
from handcal_sim.mcap_writer import write
from handcal_sim.prove_workers import Workers

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
    GOOD.replace("p[0] *", "np.nan *"): "a.py: imu_error has to give finite numbers",
}
TERMS = [f"{c} += k * {f}" for c in ("gyro_y", "accel_z") for f in terms.features(True)]
HEADINGS = [f"heading += k * {f}" for f in terms._HEADING]
# A course of each family, as in 80 s.
NUMBERS = {"bump": (30.0, 6.0), "while": (2.01, 5.13), "swing": (25.0, 0.7), "decay": (12.0,),
           "lobe": (0.4, 5.0)}  # fmt: skip
COURSES = [(c, n) for c in ("gyro_x", "accel_y", "heading") for n in NUMBERS
           if c == "heading" or n != "lobe"]  # fmt: skip


def folder_with(tmp_path, **files):
    for name, text in files.items():
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    return tmp_path


# --- a folder ------------------------------------------------------------------------------------


def test_a_folder_joins_the_catalogue_and_leaves_it_again(tmp_path):
    folder = folder_with(tmp_path, a=GOOD, _helper="raise RuntimeError")
    (folder / "notes.txt").write_text("no effect")
    before = catalogue()
    with own_effects.effects_from(folder):
        assert set(catalogue()) - set(before) == {"own_law"}
        assert effects.select(["own_law"])[0].title == "Own law"
        # threads have the catalogue of whoever began them
        seen = side_by_side((lambda: catalogue()) for _ in range(3))
        assert all("own_law" in known for known in seen)
    assert catalogue() is before
    with pytest.raises(InputError, match="come with --effects-from"):
        effects.select(["own_law"])
    with own_effects.effects_from(None):
        assert catalogue() is before
    assert sorted(p.name for p in folder.iterdir()) == ["_helper.py", "a.py", "notes.txt"]


def test_what_the_catalogue_covers_is_that_of_the_context(tmp_path):
    """Another file of the same name may hold another law."""
    cube = GOOD.replace("np.hstack([signals.gyro, signals.accel])", "np.hstack([signals.gyro**3, 0 "
                        "* signals.accel])")  # fmt: skip
    square = cube.replace("**3", " * np.abs(signals.gyro)")
    formulas = "omega_y^3", "omega_y * abs(omega_y)"
    for k, text in enumerate((cube, square)):
        with own_effects.effects_from(folder_with(tmp_path, a=text)):
            # (all axes together are one law: of one alone there is still more to know)
            assert not any(terms.named(1, f) for f in formulas)
        alone = text.replace("p[0] * np", "p[0] * np.eye(6)[1] * np")
        with own_effects.effects_from(folder_with(tmp_path, a=alone)):
            assert [terms.named(1, f) for f in formulas] == [k == 0, k == 1]
    assert not any(terms.named(1, f) for f in formulas)


@pytest.mark.parametrize("text", WRONG)
def test_a_file_that_is_none_is_named(tmp_path, text):
    known = catalogue()
    with (
        pytest.raises(InputError, match=WRONG[text]),
        own_effects.effects_from(folder_with(tmp_path, a=text)),
    ):
        pass
    assert catalogue() is known


def test_two_files_with_one_id(tmp_path):
    folder = folder_with(tmp_path, a=GOOD, b=GOOD)
    with (
        pytest.raises(InputError, match=r"b\.py has an effect 'own_law', and so has .*a\.py"),
        own_effects.effects_from(folder),
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
        done = CliRunner().invoke(cli.app, [*call, "--effects-from", str(folder)])
        assert done.exit_code == 2, call
        first, second = done.stderr.splitlines()
        assert first.startswith("handcal: running the code of "), call
        assert "own.py is no effect file" in second
    for empty, said in ((tmp_path / "none", "there is no such folder"), (folder, "no effect file")):
        (folder / "own.py").unlink(missing_ok=True)
        done = CliRunner().invoke(cli.app, [*calls[0], "--effects-from", str(empty)])
        assert done.exit_code == 2
        assert said in done.stderr


def test_simulate_hands_the_folder_on(tmp_path):
    assert "effects_from" in simulate_command.__annotations__
    folder, out = folder_with(tmp_path, own_law=GOOD), tmp_path / "a.mcap"
    given = ["simulate", "z-turn", "--duration", "3", "--seed", "0", "--effect", "own_law=0.5"]
    done = CliRunner().invoke(cli.app, [*given, "-o", str(out)])
    assert done.exit_code == 2
    done = CliRunner().invoke(cli.app, [*given, "-o", str(out), "--effects-from", str(folder)])
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
    own = own_effects.read(folder_with(tmp_path, a=GOOD) / "a.py")
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


def unnamed(effect, value=0.0123456):
    """As an explanation has it."""
    return Unnamed(effect.id, value, abs(value) / 50, effect.parameters[0].unit, 52.3, effect.story,
                   (channel_of(effect.id),), drivers_of(effect.id), None, effect.made)  # fmt: skip


def again(effect, tmp_path):
    """The effect, written out and read in."""
    (path,) = law_file.write([unnamed(effect)], tmp_path / "odd.py", ["a.mcap"], catalogue())
    own = own_effects.read(path)
    assert own.id == path.stem
    assert "a.mcap" in own.source
    assert [(p.name, p.unit) for p in own.parameters] == [("k", effect.parameters[0].unit)]
    assert own.parameters[0].prior_sigma == 0.012
    assert own.parameters[0].positive == effect.parameters[0].positive
    assert max(len(line) for line in path.read_text().splitlines()) <= 100
    return own


def same_on_the_imu(one, other, signals, atol=0.0):
    k = np.array([0.7])
    wanted = one.imu_error(k, signals)
    assert np.abs(wanted).max() > 0.0
    np.testing.assert_allclose(other.imu_error(k, signals), wanted, rtol=1e-9, atol=atol)


def same_on_the_heading(one, other):
    s = probe(200)
    nav, z = np.zeros((200, 21)), np.zeros((200, Z_DIM))
    nav[:, 6:15], z[:, TIME] = s.C_nb.reshape(200, 9), s.t
    wanted, found = (observed_error(e, "heading", [0.7], nav, z, 1) for e in (one, other))
    assert np.abs(wanted).max() > 0.0
    np.testing.assert_allclose(found, wanted, rtol=1e-9)
    assert so3.yaw_of(s.C_nb).std() > 0.5


@pytest.mark.parametrize("formula", TERMS)
def test_a_term_written_out_is_the_term(formula, tmp_path):
    effect = terms.again(formula, 1.0)
    own = again(effect, tmp_path)
    same_on_the_imu(effect, own, probe(200))
    assert (own.needs == ("temperature",)) == ("T" in drivers_of(formula))
    cold = some(probe(200), np.arange(50))
    cold.streams.pop("temperature")
    assert own.needs == () or not own.imu_error(np.array([0.7]), cold).any()
    assert not own.of_one_day


@pytest.mark.parametrize("formula", HEADINGS)
def test_a_term_of_the_heading_written_out_is_the_term(formula, tmp_path):
    effect = terms.again(formula, 1.0)
    same_on_the_heading(effect, again(effect, tmp_path))


@pytest.mark.parametrize(("channel", "kind"), COURSES)
def test_a_course_written_out_is_the_course(channel, kind, tmp_path):
    effect = shapes.again(channel, (kind, NUMBERS[kind]))
    own = again(effect, tmp_path)
    assert own.of_one_day == (kind in ("bump", "while", "swing"))
    if channel == "heading":
        same_on_the_heading(effect, own)
    else:
        # (a while begins between two samples, on a slope for the search's sake)
        same_on_the_imu(effect, own, probe(400), 0.71 if kind == "while" else 1e-12)


def test_every_course_that_there_is_has_a_writer():
    families = {f.name for f in (*shapes.OVER_TIME, *shapes.OVER_YAW)}
    assert families == set(law_file.WRITERS) == set(NUMBERS)
    odd = dataclasses.replace(
        unnamed(terms.again("gyro_x += k * t", 1.0)), made=("something else", ())
    )
    with pytest.raises(HandcalError, match="cannot be written"):
        law_file.law_of(odd)


def test_several_laws_are_several_files_and_none_is_overwritten(tmp_path):
    both = [unnamed(terms.again(f"{c} += k * omega_x^3", 1.0)) for c in ("gyro_x", "accel_x")]
    (tmp_path / "odd_2.py").write_text("mine")
    found = law_file.write(both, tmp_path / "odd.py", ["a.mcap", "b.mcap"], [*catalogue(), "odd_3"])
    assert [p.name for p in found] == ["odd.py", "odd_4.py"]
    assert (tmp_path / "odd_2.py").read_text() == "mine"
    one, other = (own_effects.read(p) for p in found)
    assert (one.id, other.id) == ("odd", "odd_4")
    assert one.title == "gyro_x: k * omega_x^3"
    assert "found in a.mcap, b.mcap" in other.source


def test_a_recordings_name_is_no_code(tmp_path):
    """Whoever names a recording must not be able to write what is run."""
    name = 'a"""\nraise RuntimeError\n"""' + "'); raise RuntimeError(\\" + "\udcff\u2713.mcap"
    law = unnamed(terms.again("gyro_x += k * t", 1.0))
    (path,) = law_file.write([law], tmp_path / "odd.py", [name], catalogue())
    own = own_effects.read(path)
    assert own.source == f"found in {name} by handcal explain".replace("\n", " ")


@pytest.mark.parametrize(
    ("name", "said"),
    [("odd.txt", "expected a name such as"), ("2nd.py", "expected a name such as"),
     ("_odd.py", "expected a name such as"), ("gyro_scale.py", "there is an effect gyro_scale"),
     ("there.py", "that file exists"), ("none/odd.py", "there is no folder")],
)  # fmt: skip
def test_a_file_that_cannot_be_written_is_said_before_the_work(name, said, tmp_path):
    (tmp_path / "there.py").write_text("mine")
    given = ["explain", "x.mcap", "--write-effect", str(tmp_path / name)]
    done = CliRunner().invoke(cli.app, given)
    assert done.exit_code == 2
    assert said in done.stderr
    assert (tmp_path / "there.py").read_text() == "mine"


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
