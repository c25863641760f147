"""``handcal effects``: all of the catalogue, one effect of it, one's own, and unknown ones."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from handcal.commands import _app
from handcal.effects import catalogue
from handcal.show.catalogue import grouped

OWN = '''"""A law of a device."""

from handcal.effects import Effect, Param, Signals
from handcal.types import Array
import numpy as np


def _error(k: Array, signals: Signals) -> Array:
    return np.zeros((len(signals.t), 6)) + k[0]


EFFECT = Effect(
    id="gyro_sings", title="Gyro sings", parameters=(Param("k", "rad/s", 0.02),),
    story="It hums.", source="nobody", motion="Holding still.", validated="", imu_error=_error,
)
'''


def run(*arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(_app.app, ["effects", *arguments], env={"COLUMNS": "100"})
    return done.exit_code, done.stdout


def test_all_are_listed_once_under_one_heading() -> None:
    status, text = run()
    assert status == 0
    for i in catalogue():
        assert sum(line.split()[:1] == [i] for line in text.splitlines()) == 1, i
    assert sorted(e.id for _, mine in grouped(catalogue()) for e in mine) == sorted(catalogue())


@pytest.mark.parametrize("id", sorted(catalogue()))
def test_one_says_all_that_the_catalogue_does(id: str) -> None:
    status, text = run(id)
    said = " ".join(text.split())
    e = catalogue()[id]
    assert status == 0
    for part in (e.title, e.story, e.motion, e.source):
        # a line may break inside a word with a hyphen or slash
        assert " ".join(part.split()).replace(" ", "") in said.replace(" ", "")
    assert ",".join(p.name for p in e.parameters).replace(" ", "") in said.replace(" ", "")


def test_json_has_the_numbers() -> None:
    _, text = run("gyro_scale", "--json", "-")
    (one,) = json.loads(text)["effects"]
    prior = catalogue()["gyro_scale"].prior_sigma.tolist()
    assert [p["prior_sigma"] for p in one["parameters"]] == prior
    assert len(json.loads(run("--json", "-")[1])["effects"]) == len(catalogue())


def test_effects_of_ones_own_are_in_it(tmp_path: Path) -> None:
    (tmp_path / "gyro_sings.py").write_text(OWN)
    status, text = run("gyro_sings", "--effects-from", str(tmp_path))
    assert status == 0
    assert "Holding still." in text
    assert "1.15 deg/s" in text
    assert run("gyro_sings")[0] == 2
