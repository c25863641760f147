"""``handcal bench``: what surrounds the measuring. No test looks at a time."""

import json
import sys

import numpy as np
import pytest
import typer
from numba.core import event

from handcal.bench import filter, program, timing
from handcal.bench.timing import Figure, Missing, Skipped, Spent, Target, in_turns, peer
from handcal.commands import _progress
from handcal.commands import bench as bench_command
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
    with pytest.raises(HandcalError, match="there are filter"):
        bench_command.bench(only=["nonsense"])


def test_a_bar_says_that_it_compiles(monkeypatch):
    monkeypatch.setattr(_progress, "PATIENCE_S", 0.0)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    with _progress.progress("calibrating") as bar:
        with event.trigger_event("numba:compile"):
            assert bar.text == "calibrating: compiling, only this once"
            assert bar.shown is not None
        assert bar.text == "calibrating"
