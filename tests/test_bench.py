"""``handcal bench``: what surrounds the measuring. No test looks at a time."""

import json
import os
import sys
import time
from dataclasses import asdict

import numpy as np
import pytest
import schemas
import typer
from numba.core import event
from typer.testing import CliRunner

from handcal.bench import explaining, filter, program, sampler, timing
from handcal.bench.timing import Figure, Missing, Skipped, Spent, Target, in_turns, peer
from handcal.commands import _progress
from handcal.commands import bench as bench_command
from handcal.commands._app import app
from handcal.recordings.inputs import load
from handcal.types import HandcalError

SERVE = """
import sys
print("a library says hello")
print("ready fake")
sys.stdout.flush()
for n, _ in enumerate(sys.stdin):
    print(4, 2.0 + n, 8.0, flush=True)
"""


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("bench") / "turn.mcap"
    program.simulated("z-turn", path)
    return load(path)


def test_sides_take_turns_and_are_run_once_beforehand():
    calls, ticks = [], []

    def made(name):
        def one():
            calls.append(name)
            return Spent(float(len(calls)), 0.5)

        return one

    cpu, wall = in_turns([made("a"), made("b")], 3, lambda: ticks.append(1))
    assert calls == ["a", "b", "a", "b", "b", "a", "a", "b"]
    np.testing.assert_array_equal(cpu, [[3, 4], [6, 5], [7, 8]])
    np.testing.assert_array_equal(wall, np.full((3, 2), 0.5))
    assert len(ticks) == 3


def test_the_middle_round_is_held_against_what_is_asked():
    one = Figure("g", "t", "x", np.array([1.0, 9.0, 2.0]), "cpu", Target(2.0, at_most=True))
    assert one.value == 2.0
    assert one.met
    assert not Figure("g", "t", "x", one.rounds, "cpu", Target(1.9, at_most=True)).met
    assert Figure("g", "t", "x", one.rounds, "cpu", Target(2.0, at_most=False)).met
    assert Figure("g", "t", "x", one.rounds).met is None


def test_a_peer_answers_for_every_line_it_is_sent(tmp_path):
    script = tmp_path / "fake.py"
    script.write_text(SERVE)
    with peer([sys.executable, script]) as side:
        assert side() == Spent(0.5, 2.0)
        assert side() == Spent(0.75, 2.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("print('missing gtsam')", "pip install gtsam"),
        ("raise SystemExit('no more disc')", "no more disc"),
        ("print('ready x', flush=True); input(); print('1 2')", "fake.py broke off"),
    ],
)
def test_a_peer_that_cannot_run_is_missing_and_says_why(tmp_path, text, said):
    script = tmp_path / "fake.py"
    script.write_text(text)
    with pytest.raises(Missing, match=said), peer([sys.executable, script]) as side:
        side()


def test_a_program_that_is_not_there_is_missing(tmp_path):
    with pytest.raises(Missing, match="could not be started"), peer([tmp_path / "nothing"]):
        pass


def test_a_command_that_fails_says_so(tmp_path):
    with pytest.raises(HandcalError, match=r"failed: handcal: .*nothing"):
        timing.run_handcal("calibrate", tmp_path / "nothing.mcap")


def test_the_case_has_fifteen_states_and_seven_scalars_at_every_sample(recording):
    problem = filter.case_of(recording).problem
    assert problem.size == 15
    n = len(recording.imu.t)
    assert len(problem.nodes.t) == n
    np.testing.assert_array_equal(np.diff(problem.nodes.first), 3)
    dims = problem.tables.dim[problem.nodes.kind]
    assert dims.sum() == 7 * n


def test_a_recording_repeated_goes_on_turning(recording):
    long = filter.repeated(recording, 100.0)
    n = len(recording.imu.t) - 1
    assert long.duration_s == pytest.approx(100.0, abs=1.0 / recording.rate_hz)
    np.testing.assert_allclose(np.diff(long.imu.t), 1.0 / recording.rate_hz, rtol=1e-9)
    np.testing.assert_array_equal(long.imu.gyro[n : 2 * n], recording.imu.gyro[:n])
    yaw = long.streams["heading"].value
    assert yaw.shape == (len(long.imu.t), 1)
    assert np.all(np.abs(yaw) <= np.pi)


def test_without_peers_the_reason_is_given(recording, tmp_path):
    found = filter.against_dense(filter.case_of(recording), tmp_path, tmp_path, 1, lambda: None)
    assert isinstance(found[0], Figure)
    assert isinstance(found[1], Skipped)
    assert "--peers" in found[1].reason


def test_the_table_as_json_gives_every_round(capsys, tmp_path, monkeypatch):
    figure = Figure("start", "help", "s", np.array([0.1, 0.2, 0.4]), "wall", Target(0.3, True))
    left_out = Skipped("gtsam", "GTSAM", "there is none.")
    monkeypatch.setattr(bench_command, "_measured", lambda *_: [figure, left_out])
    bench_command.bench(rounds=3, json=tmp_path / "b.json")
    document = json.loads((tmp_path / "b.json").read_text())
    assert document["schema"] == "handcal/bench/1"
    (one,) = document["figures"]
    assert one["rounds"] == [0.1, 0.2, 0.4]
    assert one["median"] == 0.2
    assert one["met"] is True
    assert document["skipped"] == [{"group": "gtsam", "title": "GTSAM", "reason": "there is none."}]
    shown = capsys.readouterr().out
    assert "met" in shown
    assert "Left out: GTSAM: there is none." in shown


def one_figure(group):
    return Figure(group, f"figure of {group}", "s", np.array([1.0]), "wall")


def groups(monkeypatch, **measured):
    """The command with these groups alone, each a function that yields its rows."""
    known = {name: bench_command.Group(f"what {name} is", "1 s") for name in measured}
    monkeypatch.setattr(bench_command, "GROUPS", known)
    monkeypatch.setattr(bench_command, "_measurements", lambda *_: measured)


def test_each_figure_is_shown_and_kept_before_the_next_is_measured(monkeypatch, tmp_path, capfd):
    kept, seen = tmp_path / "b.json", []

    def look(tick):
        tick("something")
        for n in range(2):
            yield one_figure(f"look {n}")
            document = json.loads(kept.read_text())
            schemas.check(document)
            seen.append([len(document["figures"]), document["complete"], document["skipped"]])
            seen[-1].append(capfd.readouterr())

    groups(monkeypatch, look=look, last=lambda _: [one_figure("last")])
    bench_command.bench(rounds=1, json=kept)
    left = [
        {"group": name, "title": f"what {name} is", "reason": bench_command.CUT_OFF}
        for name in ("look", "last")
    ]
    assert [one[:3] for one in seen] == [[1, False, left], [2, False, left]]
    assert "figure of look 0" in seen[0][3].out
    assert "look (1 of 2): what look is\n" in seen[0][3].err
    assert "look (1 of 2): something\n" in seen[0][3].err
    assert seen[1][3].err == ""
    document = json.loads(kept.read_text())
    assert [f["group"] for f in document["figures"]] == ["look 0", "look 1", "last"]
    assert document["complete"] is True
    assert document["skipped"] == []


@pytest.mark.parametrize("to", ["b.json", "-"])
@pytest.mark.parametrize(
    ("raised", "status"), [(KeyboardInterrupt(), 130), (SystemExit(143), 143)], ids=["int", "term"]
)
def test_interrupted_it_keeps_what_was_measured(monkeypatch, tmp_path, raised, status, to):
    def cut_off(_tick):
        yield one_figure("b")
        raise raised

    groups(monkeypatch, a=lambda _: [one_figure("a")], b=cut_off, c=lambda _: [one_figure("c")])
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["bench", "--json", to])
    assert done.exit_code == status
    assert "interrupted; 2 figures are measured" in done.stderr
    assert done.stderr.endswith("not measured to their end: b, c\n")
    assert ("figure of a" in done.stdout.split("{")[0]) == (to != "-")
    document = json.loads(done.stdout if to == "-" else (tmp_path / to).read_text())
    schemas.check(document)
    assert [f["group"] for f in document["figures"]] == ["a", "b"]
    assert document["complete"] is False
    assert [s["group"] for s in document["skipped"]] == ["b", "c"]


def test_an_earlier_result_stays_until_there_is_a_figure(monkeypatch, tmp_path):
    def cut_off(_tick):
        raise KeyboardInterrupt

    groups(monkeypatch, a=cut_off)
    (tmp_path / "b.json").write_text("earlier")
    done = CliRunner().invoke(app, ["bench", "--json", str(tmp_path / "b.json")])
    assert done.exit_code == 130
    assert "nothing is measured yet" in done.stderr
    assert (tmp_path / "b.json").read_text() == "earlier"


def test_who_no_longer_waits_for_a_program_ends_it(monkeypatch):
    children = []

    def interrupted(child, _begin):
        children.append(child)
        raise KeyboardInterrupt

    monkeypatch.setattr(timing, "_ended", interrupted)
    with pytest.raises(KeyboardInterrupt):
        timing.run_python("import time; time.sleep(30)")
    assert children[0].returncode


def test_what_was_begun_ends_with_who_no_longer_waits(monkeypatch, tmp_path):
    def interrupted(_child, _begin):
        while not (tmp_path / "begun").exists():
            time.sleep(0.01)
        raise KeyboardInterrupt

    monkeypatch.setattr(timing, "_ended", interrupted)
    said = f"open({str(tmp_path / 'now')!r}, 'w').write(str(os.getpid()))"
    late = f"open({str(tmp_path / 'late')!r}, 'w')"
    moved = f"os.rename({str(tmp_path / 'now')!r}, {str(tmp_path / 'begun')!r})"
    with pytest.raises(KeyboardInterrupt):
        timing.run_python(f"import os, time; {said}; {moved}; time.sleep(20); {late}")
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "begun").read_text()), 0)
    assert not (tmp_path / "late").exists()


@pytest.mark.prove
@pytest.mark.skipif(not hasattr(os, "wait4"), reason="this system does not tell.")
def test_the_memory_of_who_measures_is_not_counted():
    mine = np.ones(25_000_000)  # (200 MB)
    assert timing.run_python("pass").memory < 60.0
    assert timing.run_python("x = bytearray(100_000_000)").memory > 100.0
    assert mine.all()


def test_the_smallest_recordings_come_first_and_one_that_fails_is_left_out(monkeypatch, tmp_path):
    """Where the folder of all recordings is, a variable says."""
    for name, size in {"a.mcap": 30, "b.mcap": 20, "c.mcap": 10, "no.txt": 1}.items():
        (tmp_path / name).write_bytes(b"x" * size)
    wall = {"c": 50.0, "b": None, "a": 9.0}
    ran = []

    def run(command, path, whole, sampled):
        assert (command, whole, sampled) == ("explain", True, True)
        ran.append(path.stem)
        if wall[path.stem] is None:
            raise HandcalError("it cannot be read.")
        told = "searching; so far gyro_scale" if path.stem == "a" else "searching"
        said = (2.5, "reading"), (3.0, f"handcal: {told}"), (8.0, "handcal: judging")
        return timing.Ran(1.0, wall[path.stem], 100.0, said)

    monkeypatch.setattr(explaining, "run_handcal", run)
    done = CliRunner().invoke(
        app,
        ["bench", "--only", "devices", "--json", "-"],
        env={"HANDCAL_RECORDINGS": str(tmp_path)},
    )
    assert done.exit_code == 0, (done.output, done.exception)
    document = json.loads(done.stdout)
    assert ran == ["c", "b", "a"]
    assert "a.mcap (3 of 3)" in done.stderr
    (left_out,) = document["skipped"]
    assert left_out["title"] == "explain: b"
    assert left_out["reason"] == "it cannot be read."
    times = {f["title"]: (f["median"], f["met"]) for f in document["figures"] if f["unit"] == "s"}
    assert times == {
        "explain: c": (50.0, False), "explain: a": (9.0, True),
        "explain: a, found what it says by": (3.0, None),
        "explain: median of 2 recordings": (29.5, False),
        "explain: worst of 2 recordings": (50.0, False),
    }  # fmt: skip


def test_interrupted_recordings_have_a_median_of_which_nothing_is_asked(monkeypatch, tmp_path):
    for n in range(4):
        (tmp_path / f"{n}.mcap").write_bytes(b"x" * (9 - n))
    times = iter([1.0, 5.0])

    def run(*_, whole, sampled):  # noqa: ARG001
        try:
            return timing.Ran(1.0, next(times), np.nan)
        except StopIteration:
            raise KeyboardInterrupt from None

    monkeypatch.setattr(explaining, "run_handcal", run)
    measured = explaining.devices(tmp_path, lambda _="": None)
    rows = [next(measured) for _ in range(4)]
    with pytest.raises(KeyboardInterrupt):
        next(measured)
    assert [(r.title, r.value, r.target is None) for r in rows] == [
        ("explain: 3", 1.0, False), ("explain: 2", 5.0, False),
        ("explain: median of the smallest 2 of 4 recordings", 3.0, True),
        ("explain: worst of the smallest 2 of 4 recordings", 5.0, True),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("slower", "fewer", "status"),
    [(1.29, 1.0, 0), (1.31, 1.0, 1), (1.0, 1.29, 0), (1.0, 1.31, 1), (0.2, 0.2, 0)],
)
def test_a_ratio_that_is_a_third_worse_than_it_was_fails(
    slower, fewer, status, monkeypatch, tmp_path
):
    """Ours over theirs may not grow, theirs over ours may not shrink; seconds do not count."""

    def run(ours, theirs, seconds, **options):
        figures = [
            Figure("a", "ours over theirs", "x", np.array([ours])),
            Figure("a", "theirs over ours", "x", np.array([theirs]), "", Target(1.0, False)),
            Figure("a", "seconds", "s", np.array([seconds])),
        ]
        monkeypatch.setattr(bench_command, "_measured", lambda *_: figures)
        bench_command.bench(rounds=1, **options)

    kept = tmp_path / "kept.json"
    run(2.0, 3.0, 1.0, json=kept)
    if status:
        with pytest.raises(typer.Exit) as ended:
            run(2.0 * slower, 3.0 / fewer, 9.0, against=kept)
        assert ended.value.exit_code == status
    else:
        run(2.0 * slower, 3.0 / fewer, 9.0, against=kept)


def test_nothing_to_compare_is_no_pass(monkeypatch, tmp_path):
    kept = tmp_path / "kept.json"
    kept.write_text('{"figures": []}')
    monkeypatch.setattr(bench_command, "_measured", lambda *_: [])
    with pytest.raises(typer.Exit):
        bench_command.bench(rounds=1, against=kept)
    kept.write_text("[]")
    with pytest.raises(HandcalError, match="bench --json"):
        bench_command.bench(rounds=1, against=kept)


def test_unknown_groups_are_refused():
    with pytest.raises(HandcalError, match="Known: filter"):
        bench_command.bench(only=["nonsense"])


def test_a_bar_says_that_it_compiles(monkeypatch):
    monkeypatch.setattr(_progress, "PATIENCE_S", 0.0)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    with _progress.progress("calibrating") as bar:
        with event.trigger_event("numba:compile"):
            assert bar.text == "calibrating: compiling, only this once"
            assert bar.shown is not None
        assert bar.text == "calibrating"


def test_a_bar_that_made_room_is_shown_again_with_its_stage(monkeypatch):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    with _progress.progress("measuring", patience=0.0) as bar:
        bar(stage="one")
        bar.hide()
        assert bar.shown is None
        bar()
        assert bar.shown is not None
        assert bar.shown.tasks[0].description == "measuring: one"
    assert bar.shown is None


def called(*modules):
    """The frame of the innermost of functions in these modules, each called by the one before."""
    inner = None
    for name in reversed(modules):
        scope = {"__name__": name, "inner": inner, "sys": sys}
        body = "inner()" if inner else "sys._getframe()"
        exec(f"def step(): return {body}", scope)
        inner = scope["step"]
    return inner()


@pytest.mark.parametrize(
    ("modules", "expected"),
    [
        (("handcal.search.climb", "handcal.estimate.fit", "numpy.linalg"),
         ("estimate.fit", "search.climb")),
        (("handcal.search.climb", "handcal.laws.survey"), ("laws.survey", "laws.survey")),
        (("handcal.laws.survey", "handcal.compiled.rows", "numba.core.caching", "pickle"),
         (sampler.MACHINE_CODE, "laws.survey")),
        (("__main__", "handcal.types"), ("types", sampler.OTHER)),
    ],
)  # fmt: skip
def test_time_is_that_of_the_innermost_module_and_of_the_step_that_asked(modules, expected):
    assert sampler.where(called(*modules)) == expected


def test_an_import_is_told_by_the_library_that_handcal_asked_for(tmp_path, monkeypatch):
    (tmp_path / "a_library.py").write_text("import a_part\n")
    (tmp_path / "a_part.py").write_text("import sys; sys.modules['seen'] = sys._getframe()\n")
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("a_library", "a_part", "seen"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    exec("import a_library", {"__name__": "handcal.estimate.fit"})
    found = sampler.where(sys.modules.pop("seen"))
    assert found == ("importing a_library", sampler.IMPORTING)


def test_a_command_that_is_looked_at_says_where_its_time_went():
    ran = timing.run_handcal("--help", sampled=True)
    (found,) = timing.profile("start", "help", ran)
    # (its time without that of the interpreter's own start and end; looks are 5 ms apart)
    for seconds in (found.doing, found.asked_by):
        assert 0.2 * ran.wall < sum(seconds.values()) < ran.wall
    assert any(name.startswith("importing") for name in found.doing)
    assert not list(timing.profile("start", "help", timing.run_handcal("--help")))


@pytest.mark.prove
def test_a_command_that_fails_while_it_is_looked_at_says_why():
    with pytest.raises(HandcalError, match=r"failed: .*nowhere\.mcap"):
        timing.run_handcal("info", "nowhere.mcap", sampled=True)


def test_where_time_goes_is_shown_and_kept(tmp_path, monkeypatch, capsys):
    seconds = {"estimate.fit": 6.0, "importing numba": 3.8, "effects": 0.2}
    row = timing.Profile("start", "calibrate 30 s", seconds, {"search": 10.0})
    monkeypatch.setattr(bench_command, "_measured", lambda *_: [row])
    bench_command.bench(rounds=1, json=tmp_path / "b.json")
    document = json.loads((tmp_path / "b.json").read_text())
    schemas.check(document)
    assert document["profiles"] == [asdict(row)]
    assert "estimate.fit 60 %, importing numba 38 %, effects 2 %" in capsys.readouterr().out
