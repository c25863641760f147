"""`make judge`: rows of explanations, tables that are gone on with, and two tables compared."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from rich.console import Console

from handcal_sim.prove.suites import Answer

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "benchmarks"))

import judge  # noqa: E402
import judge_compare  # noqa: E402
import judge_rows  # noqa: E402
from judge_cases import DRAWN, Case, cases, written  # noqa: E402

BIAS = {"x": 0.01, "y": 0.0, "z": -0.02}
SCALE = {"x": 0.01, "y": -0.01, "z": 0.0}


def parameters(effect, values, sigma):
    return [{"effect": effect, "name": name, "value": value, "sigma": sigma}
            for name, value in values.items()]  # fmt: skip


def document(**more):
    fits = {"before": {"log_evidence": 90.0}, "after": {"log_evidence": 100.0}}
    return {
        "verdict": "explained", "missing": [{"effect": "gyro_scale", "probability": 0.97}],
        "unnamed": [], "fit": fits,
        "held_out": {"log_score_before": 1.0, "log_score_after": 2.0}, "processor_s": 3.0,
        "parameters": parameters("gyro_bias", {"x": 0.012, "y": 0.0, "z": -0.02}, 0.001), **more,
    }  # fmt: skip


def row(name, **more):
    plain = {"name": name, "suite": "one", "outcome": "exact", "right": True, "off": {"a x": 0.5},
             "verdict": "explained", "named": [["gyro_scale"]], "unnamed": [], "seconds": 4.0,
             "processor_s": 4.0, "log_evidence": 100.0, "sha256": name}  # fmt: skip
    return plain | more


def rows_of(*rows):
    return {r["name"]: r for r in rows}


# ---- rows -------------------------------------------------------------------------------


@pytest.fixture
def file(tmp_path):
    (tmp_path / "a.mcap").write_bytes(b"readings")
    return tmp_path / "a.mcap"


def test_parameters_are_held_against_what_was_drawn_true_biases_and_else_zero(file):
    answer = Answer("one", "", {"gyro_scale": SCALE}, baseline={"gyro_bias": BIAS})
    found = document()["parameters"] + parameters("gyro_scale", {"x": 0.013}, 0.001)
    found += parameters("gravity", {"delta": -0.004}, 0.002)
    said = document(parameters=found, untellable=[{"effect": "gyro_bias", "name": "z"}])
    made = judge_rows.row_of(Case("one_0_0", "one", True), file, answer, said, 5.04)
    expected = {"gyro_bias x": 2.0, "gyro_bias y": 0.0, "gyro_scale x": 3.0, "gravity delta": -2.0}
    assert made["off"] == pytest.approx(expected)
    assert (made["outcome"], made["right"], made["named"]) == ("exact", True, [["gyro_scale"]])
    assert (made["log_evidence"], made["log_evidence_before"]) == (100.0, 90.0)
    assert (made["held_out"], made["seconds"]) == ([1.0, 2.0], 5.0)
    assert made["claims"] == [(0.97, True)]


def test_a_real_recording_is_asked_for_what_is_known_of_it(file):
    facts = [
        {"effect": "gyro_bias", "names": "x y", "values": [0.01, 0.01], "within": 0.001},
        {"effect": "gyro_scale", "names": "x y", "values": [0.001, 0.02], "within": 0.002},
        {"effect": "lever_arm", "names": "x", "values": [0.02], "within": 0.001},
    ]
    case = Case("device", "real", True, known={"known": facts})
    places = {f"{row}{axis}": 0.02 for row in "xyz" for axis in "xyz"}
    found = document()["parameters"] + parameters("size_effect", places, 0.001)
    made = judge_rows.row_of(case, file, None, document(parameters=found), 1.0)
    # One sigma and nine beyond the tolerance; small enough for no name; not named; the middle.
    assert made["off"] == pytest.approx({
        "gyro_bias x": 1.0, "gyro_bias y": -9.0, "gyro_scale x": 0.0, "gyro_scale y": None,
        "lever_arm x": 0.0,
    })  # fmt: skip
    assert (made["outcome"], made["right"]) == ("3 and 3 of 5", False)


def test_a_part_that_all_scales_have_in_common_is_nobodys_error(file):
    fact = {"effect": "accel_scale", "names": "x y z", "values": [0.01, 0.02, 0.03],
            "within": 0.001, "common": True}  # fmt: skip
    found = parameters("accel_scale", {"x": 0.11, "y": 0.12, "z": 0.13}, 0.001)
    case = Case("device", "real", True, known={"known": [fact]})
    made = judge_rows.row_of(case, file, None, document(parameters=found), 1.0)
    assert list(made["off"].values()) == [0.0, 0.0, 0.0]


def test_without_a_licence_figures_alone_are_kept(file):
    case = Case("phone", "real", True, known={"known": [], "figures_only": True})
    for said in (document(), {"error": "x", "processor_s": 1.0}):
        made = judge_rows.row_of(case, file, None, said, 1.0)
        assert set(made) == set(judge_rows.FIGURES)


# ---- recordings -------------------------------------------------------------------------


def test_what_a_quick_run_needs_comes_first_and_has_every_suite(tmp_path):
    listed = cases(0, tmp_path)
    quick = [case for case in listed if case.quick]
    assert listed[: len(quick)] == quick
    assert {case.suite for case in quick} == {*DRAWN, "sealed"}
    assert len({case.name for case in listed}) == len(listed)


def test_faint_recordings_do_not_follow_what_the_program_promises(tmp_path, monkeypatch):
    monkeypatch.setattr("judge_cases.promised", None)
    case = next(c for c in cases(0, tmp_path) if c.name == "faint_0_3")
    _, answer = written(case, tmp_path)
    assert answer.effects["accel_scale"]["x"] == pytest.approx(-2.567e-4, rel=1e-3)


# ---- tables -----------------------------------------------------------------------------


def test_a_run_that_broke_off_goes_on_where_it_was(tmp_path, monkeypatch):
    asked = [Case(name, "one", True) for name in "abc"]
    table = tmp_path / "table.json"
    seen, broken = [], ["b", "c"]

    def judged(case, _explain):
        if case.name in broken:
            raise OSError("no room on the disk")
        seen.append(case.name)
        return row(case.name)

    monkeypatch.setattr(judge, "judged", judged)
    explain = judge.Explainer(ROOT, 1.0, 1)
    with pytest.raises(OSError, match="no room"):
        judge.run(asked, explain, 1, table, {})
    assert list(judge.read(table)) == ["a"]
    broken.clear()
    judge.run(asked, explain, 1, table, judge.read(table))
    assert seen == ["a", "b", "c"]
    assert list(judge.read(table)) == ["a", "b", "c"]
    assert len(table.read_text().splitlines()) == 5  # a row a line


def test_a_program_that_fails_or_does_not_end_is_a_row(tmp_path):
    program = tmp_path / "handcal"
    program.write_text("#!/bin/sh\necho at first >&2\necho no sense in $2 >&2\nexit 3\n")
    program.chmod(0o755)
    said, _ = judge.Explainer(program, 60.0, 1)(tmp_path / "a.mcap")
    assert said["error"] == "no sense in a.mcap"
    program.write_text("#!/bin/sh\nsleep 60\n")
    said, taken = judge.Explainer(program, 0.2, 1)(tmp_path / "a.mcap")
    assert said["error"] == "no explanation within 0 s"
    assert taken < 30.0
    program.write_text('#!/bin/sh\necho \'{"verdict": "explained"}\' > $4\n')
    said, _ = judge.Explainer(program, 60.0, 1)(tmp_path / "a.mcap")
    assert said["verdict"] == "explained"
    assert said["processor_s"] > 0.0


def test_two_tables_are_paired_by_recording(capsys):
    failed = {"name": "c", "suite": "one", "outcome": "failed", "right": False, "off": {},
              "verdict": "failed", "processor_s": 900.0, "seconds": 1.0, "sha256": "c"}  # fmt: skip
    before = rows_of(row("a"), row("b"), row("c"), row("d"), row("old"), row("e", suite="real"))
    after = rows_of(
        row("a", processor_s=2.0),
        row("b", named=[["accel_scale"]], outcome="wrong", right=False, off={"a x": 1.5},
            log_evidence=90.0),
        failed, row("d", sha256="other"), row("e", suite="real", right=None, off={"a x": None}),
    )  # fmt: skip
    found = judge_compare.compared(after, before)
    one, real, every = found["suites"]
    assert [one["n"], real["n"], every["n"]] == [3, 1, 4]
    assert [side["right"]["count"] for side in one["sides"]] == [3, 1]
    assert [side["within_1"]["count"] for side in one["sides"]] == [3, 1]
    assert [side["within_2"]["n"] for side in one["sides"]] == [3, 2]
    assert [side["within_2"]["count"] for side in real["sides"]] == [1, 0]
    assert real["sides"][1]["right"]["n"] == 0
    assert one["nats"] == -10.0
    assert one["time_ratio"] == 0.75  # (the failure is not counted)
    assert [change["name"] for change in found["changed"]] == ["b", "c"]
    assert (found["differ"], found["alone"]) == (["d"], ["old"])
    assert json.loads(json.dumps(found)) == found
    judge_compare.show(found, Console(width=120))
    shown = capsys.readouterr().out
    assert "wrong, explained; accel_scale" in shown
    judge_compare.show(judge_compare.compared(after, None), Console(width=120))
    assert "Changed" not in capsys.readouterr().out
