"""--config: options by command from a file; the command line wins, and what is unknown is told."""

import sys

import pytest
from fake_result import fake_result

import handcal
from handcal.commands import _app
from handcal.commands._config import first
from handcal.estimate import calibration


@pytest.fixture
def main(monkeypatch, capsys, tmp_path):
    """The command line in this process with a configuration: status, errors, settings."""
    monkeypatch.setitem(handcal.__dict__, "load", lambda *_, **__: fake_result().recording)
    calls = []

    def together(_, effects, **settings):
        calls.append(settings | {"effects": effects})
        return (fake_result(),)

    monkeypatch.setattr(calibration, "calibrate_together", together)

    def call(config, *arguments):
        (tmp_path / "handcal.toml").write_text(config)
        typed = [a.replace("CONFIG", str(tmp_path / "handcal.toml")) for a in arguments]
        monkeypatch.setattr(sys, "argv", ["handcal", *typed])
        calls.clear()
        with pytest.raises(SystemExit) as stop:
            _app.main()
        return stop.value.code, capsys.readouterr().err, (calls or [None])[0]

    return call


CONFIG = """
[calibrate]
effects = ["gyro_scale", "lever_arm"]
assume = "rest-only"
noise_until = 10
ignore = ["mag", "pose"]
reference-exact = true
[lab.size]
latitude = 48.0
"""


def test_options_come_from_the_file_and_the_command_line_wins(main):
    status, _, settings = main(CONFIG, "calibrate", "x", "--config", "CONFIG", "--assume", "auto")
    assert status == 0
    assert settings["effects"] == ("gyro_scale", "lever_arm")
    assert (settings["noise_until"], settings["ignore"]) == (10.0, ("mag", "pose"))
    assert settings["reference_exact"] is True
    assert settings["assume"] == "auto"
    assert main(CONFIG, "--config=CONFIG", "calibrate", "x")[2]["assume"] == "rest-only"
    assert main(CONFIG, "calibrate", "x")[2]["effects"] == ()


@pytest.mark.parametrize(
    ("config", "said"),
    [
        ("[calibrate]\neffect = 'x'", "Did you mean effects or"),
        ("[calibrat]\neffects = 'x'", "Did you mean calibrate?"),
        ("[lab.sise]\nlatitude = 1", "Did you mean size?"),
        ("effects = 'x'", "write its options below"),
        ("[calibrate]\nassume = true", "needs a value"),
        ("[calibrate]\nreference-exact = 'yes'", "true or false"),
        ("[calibrate.effects]\nx = 1", "neither a number"),
        ("[calibrate]\nassume = 'nonsense'", "nonsense"),
        ("[calibrate]\nlatitude = 91", "latitude"),
        ("[", "not TOML"),
    ],
)
def test_what_is_unknown_is_wrong_use_in_one_line(main, config, said):
    status, err, settings = main(config, "calibrate", "x", "--config", "CONFIG")
    assert (status, settings) == (2, None)
    assert len(err.splitlines()) == 1
    assert said in err


def test_the_option_may_stand_anywhere_before_a_double_dash():
    assert first(["a", "--config", "b", "c"]) == ["--config", "b", "a", "c"]
    assert first(["a", "--", "--config", "b"]) == ["a", "--", "--config", "b"]


def test_the_shell_is_told_what_could_follow(monkeypatch, capsys):
    for words, at, said in (
        ("handcal calib", 1, "calibrate"), ("handcal calibrate --eff", 2, "--effects"),
    ):  # fmt: skip
        monkeypatch.setenv("_HANDCAL_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", words)
        monkeypatch.setenv("COMP_CWORD", str(at))
        monkeypatch.setattr(sys, "argv", ["handcal"])
        with pytest.raises(SystemExit):
            _app.main()
        assert said in capsys.readouterr().out
