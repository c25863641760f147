"""The command line from outside: statuses, one-line errors, files written."""

import io
import json
import os
import subprocess
import sys
from dataclasses import replace
from importlib import import_module
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from fake_explanation import fake_explanation
from fake_result import fake_frames, fake_result
from lab_world import command

import handcal
from handcal import output
from handcal.commands import _app, _registry
from handcal.commands._progress import progress
from handcal.estimate import calibration
from handcal.types import HandcalError, InputError


def run(*arguments: str, **options) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "handcal", *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, check=False, timeout=60, **options
    )


@pytest.fixture
def main(monkeypatch, capsys, no_figures):  # noqa: ARG001
    """The command line in this process, loading and calibrating nothing."""
    monkeypatch.setitem(handcal.__dict__, "load", lambda *_, **__: fake_result().recording)
    calls = []

    def together(recordings, effects, **settings):
        calls.append(settings | {"effects": effects})
        settings["progress"](0.5)
        return tuple(fake_result() for _ in recordings)

    monkeypatch.setattr(calibration, "calibrate_together", together)

    def call(*arguments: str):
        monkeypatch.setattr(sys, "argv", ["handcal", *arguments])
        with pytest.raises(SystemExit) as stop:
            _app.main()
        captured = capsys.readouterr()
        return stop.value.code, captured.out, captured.err

    call.calls = calls
    return call


def test_version_and_help():
    assert run("--version").stdout == f"handcal {handcal.__version__}\n"
    shown = run("--help")
    assert shown.returncode == 0
    for name in ("calibrate", "import", "replay"):
        assert name in shown.stdout
    assert run().stdout == shown.stdout


@pytest.mark.parametrize(
    "arguments",
    [
        ["calibrate", "nothing-there.mcap"],
        ["calibrate"],
        ["calibrate", "x", "--assume", "nonsense"],
        ["calibrate", "x", "--latitude", "91"],
        ["calibrate", "x", "--units", "accel"],
        ["calibrate", "x", "--report", "no-folder/x.html"],
        ["calibrate", "x", "--json", "no-folder/x.json"],
        ["import", "x", "-o", "no-folder/x.mcap"],
        ["replay", "x", "--no-viewer", "--rrd", "no-folder/x.rrd"],
        ["calibrate", "."],
        ["import", "x"],
        ["replay", "x", "--no-viewer"],
        ["nonsense"],
        ["--nonsense"],
    ],
)
def test_wrong_use_is_status_2_and_one_line(arguments, monkeypatch, capsys):
    status, out, err = command(monkeypatch, capsys, *arguments)
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert err.startswith("handcal: ")


@pytest.mark.parametrize("name", ["x.mcap", "x.csv", "x.zip"])
def test_an_empty_file_is_unreadable_input(tmp_path, name, monkeypatch, capsys):
    (tmp_path / name).touch()
    status, out, err = command(monkeypatch, capsys, "calibrate", tmp_path / name)
    assert (status, out) == (2, "")
    assert "empty" in err
    assert len(err.splitlines()) == 1


def test_a_report_that_cannot_be_written_is_a_sentence(main, tmp_path):
    status, _, err = main("calibrate", "x", "--report", str(tmp_path))
    assert status == 1
    assert "could not be written" in err
    assert len(err.splitlines()) == 1


def test_a_reader_that_has_had_enough_is_no_error():
    command = f"{sys.executable} -m handcal calibrate --help | head -n 1"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert done.stderr == ""


def test_calibrate_writes_what_it_is_asked_for(main, tmp_path):
    names = {"--json": "x.json", "--report": "x.html", "--rrd": "x.rrd"}
    options = [s for option, name in names.items() for s in (option, str(tmp_path / name))]
    status, out, err = main("calibrate", "x.mcap", *options)
    assert (status, err) == (0, "")
    assert "Gyro bias x" in out
    assert json.loads((tmp_path / "x.json").read_text())["schema"] == "handcal/calibration/1"
    assert all((tmp_path / name).stat().st_size > 1000 for name in names.values())


class Closed(io.StringIO):
    """An output whose reader has had enough at once."""

    def write(self, _):
        raise HandcalError("closed")


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("calibrate x", ("json", "report", "rrd")),
        ("explain x", ("json", "report")),
        ("explain x --json -", ("report",)),
        ("calibrate x --json -", ("report",)),
        ("design motion --reduce gyro_bias", ("json", "report", "picture")),
        ("design poses --n 4 --known pose --seed 0", ("json", "report", "picture")),
        ("effects", ("json",)),
    ],
)
def test_files_are_written_before_anything_is_shown(main, monkeypatch, tmp_path, command, options):
    endings = {"report": "html", "picture": "png"}
    files = {o: tmp_path / f"x.{endings.get(o, o)}" for o in options}
    found = fake_explanation("explained", recordings=1)
    monkeypatch.setattr(import_module("handcal.explain"), "explain", lambda *_, **__: found)
    monkeypatch.setattr(sys, "stdout", Closed())
    asked = [word for o, path in files.items() for word in (f"--{o}", str(path))]
    status, _, err = main(*command.split(), *asked)
    assert status == 1
    assert "closed" in err  # (it came to writing there)
    assert all(path.stat().st_size > 500 for path in files.values())


def test_json_on_standard_output_is_nothing_but_json(main):
    status, out, _ = main("calibrate", "x.mcap", "--json", "-")
    assert status == 0
    assert len(json.loads(out)["parameters"]) == 13


def test_several_files_get_a_page_each(main, tmp_path):
    status, _, _ = main("calibrate", "a", "b", "--json", str(tmp_path / "x.json"))
    assert status == 0
    assert len(json.loads((tmp_path / "x.json").read_text())["recordings"]) == 2
    recording = fake_result().recording
    assert output.beside(Path("out/x.html"), [recording]) == [Path("out/x.html")]
    two = output.beside(Path("out/x.html"), [recording, replace(recording, path="b/c.mcap")])
    assert two == [Path("out/x-hand-motion.html"), Path("out/x-c.html")]


def test_options_reach_the_filter_in_si(main):
    main("calibrate", "x", "--effects", "gyro_scale, lever_arm", "--heading-sigma", "180",
         "--latitude", "90", "--assume", "rest-only", "--ignore", "mag", "--ignore", "pose",
         "--noise-until", "10", "--engine", "filterpy", "--reference-exact", "--only")  # fmt: skip
    (settings,) = main.calls
    del settings["progress"]
    assert settings == {
        "effects": ("gyro_scale", "lever_arm"), "heading_sigma": pytest.approx(3.14159265),
        "latitude": pytest.approx(1.57079633), "height": 0.0, "assume": "rest-only",
        "ignore": ("mag", "pose"), "noise_until": 10.0, "engine": "filterpy",
        "reference_exact": True, "before": None, "only": True,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (HandcalError("The motion shows\nnothing."), 1),
        (InputError("No such effect."), 2),
        (KeyboardInterrupt(), 130),
        (PermissionError(13, "Permission denied", "x.mcap"), 1),
    ],
)
def test_errors_are_one_line_and_a_status(main, monkeypatch, error, status):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr(calibration, "calibrate_together", fail)
    code, out, err = main("calibrate", "x.mcap")
    assert (code, out) == (status, "")
    assert len(err.splitlines()) == 1


def test_a_number_that_is_none_is_wrong_use(main):
    assert main("calibrate", "x", "--noise-until", "nan")[0] == 2


def test_replay_into_a_file(main, tmp_path, monkeypatch):
    path = tmp_path / "x.rrd"
    monkeypatch.setattr(
        "handcal.estimate.live.live_frames", lambda result, **_: fake_frames(result)
    )
    status, _, _ = main("replay", "x", "--no-viewer", "--speed", "0", "--rrd", str(path))
    assert status == 0
    assert path.stat().st_size > 10_000


def test_replay_without_a_display_says_so(main, monkeypatch):
    if not sys.platform.startswith("linux"):
        pytest.skip("other systems always have a display")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    status, _, err = main("replay", "x")
    assert status == 1
    assert "--web" in err


def plugin(monkeypatch, tmp_path, source: str):
    (tmp_path / "some_plugin.py").write_text(source)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "some_plugin", raising=False)
    entry = EntryPoint("extra", "some_plugin:extra", "handcal.commands")
    all_of_them = _registry._plugins() | {"extra": entry}
    monkeypatch.setattr(_registry, "_plugins", lambda: all_of_them)


def test_a_command_of_another_package_is_listed_unloaded_and_runs(main, monkeypatch, tmp_path):
    source = '''
import typer
print("loaded")
def extra(n: int, twice: bool = False) -> None:
    """Adds something.

    More about it.
    """
    print("extra", n * (1 + twice))
    if n > 5:
        raise typer.Exit(1)
'''
    plugin(monkeypatch, tmp_path, source)
    status, out, _ = main("--help")
    assert status == 0
    assert "Adds something." in out
    assert "loaded" not in out
    assert main("extra", "3", "--twice") == (0, "loaded\nextra 6\n", "")
    assert main("extra", "7")[0] == 1
    assert main("extra", "x")[0] == 2
    assert main("extra", "--help")[0] == 0


@pytest.mark.parametrize("source", ["import not_installed_anywhere", "x = 1", "def broken("])
def test_a_broken_plugin_harms_nothing_else(main, monkeypatch, tmp_path, source):
    plugin(monkeypatch, tmp_path, source)
    assert main("--help")[0] == 0
    assert main("calibrate", "x")[0] == 0
    status, _, err = main("extra")
    assert status == 1
    assert len(err.splitlines()) == 1


def test_progress_is_silent_where_nobody_watches(capfd):
    with progress("working") as bar:
        bar.started -= 10
        bar(0.5)
    assert capfd.readouterr() == ("", "")


def test_stages_are_lines_where_nobody_watches(capfd):
    with progress("explaining x") as bar:
        bar(0.0, "the plain model")  # (nothing is said of what takes no two seconds)
        bar.started -= 10
        bar(0.1, "searching")
        bar(0.3, "searching")
        bar(0.8, "fitting")
    assert capfd.readouterr().err.splitlines() == [
        "handcal: explaining x: searching", "handcal: explaining x: fitting",
    ]  # fmt: skip


def test_help_needs_neither_numpy_nor_rich_to_start():
    code = (
        "import sys, handcal.commands._app; print({'numpy', 'rich', 'jinja2'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


def test_what_a_command_imports_for_nothing_is_loaded_where_it_is_used():
    """The folder of numpy.f2py holds crackfortran, which takes a tenth of a second to import."""
    code = """
import sys
from handcal.commands._app import main
sys.argv = ["handcal", "calibrate", "not there.mcap"]
try:
    main()
except SystemExit:
    pass
import handcal.estimate.calibration, handcal.explain
print("numpy.f2py.crackfortran" in sys.modules, "scipy.spatial.transform._rotation" in sys.modules)
from scipy.spatial.transform import Rotation
print(Rotation.identity().magnitude(), "scipy.spatial.transform._rotation" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False False\n0.0 True\n"


@pytest.mark.parametrize("encoding", ["ascii", "cp1252", "cp437"])
def test_a_terminal_that_lacks_a_sign_gets_another(encoding):
    text = "x = −1.5 ± 0.2 deg/√h at 20\u00a0°C; ☃"
    shown = f"import codecs; from handcal.commands._registry import say; say({text!r})"
    program = f"from handcal.commands._registry import _show_what_can_be_shown as f; f(); {shown}"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, check=True,
        env={**os.environ, "PYTHONIOENCODING": encoding},
    )  # fmt: skip
    said = done.stderr.decode(encoding)
    assert "-1.5" in said
    assert said.rstrip().endswith("?")
    assert ("+-" in said) == (encoding == "ascii")


def test_wrong_words_are_met_with_the_right_ones():
    near = run("conceal", "x.mcap", "--effect", "gyro_scal=1", "-o", "y.mcap")
    assert near.returncode == 2
    wrong = run("calibrate", "x.mcap", "--assume", "fixed")
    assert wrong.returncode == 2
    assert "Value error" not in wrong.stderr
    assert "fixed-point" in wrong.stderr
    missing = run("replay", "nosuch.mcap")
    assert missing.returncode == 2
    assert "nosuch.mcap" in missing.stderr


def test_what_stands_in_columns_stays_so_and_line_breaks_do_not(capsys):
    from handcal.commands._registry import say, tell

    tell("  gyro bias x    1.5\u00a0deg/s  enough\n")
    tell("a name\n   with\r\nbreaks\x1b[2J\n\n")
    say("  two  spaces")
    out, said = capsys.readouterr()
    assert out == "  gyro bias x    1.5 deg/s  enough\na name with breaks?[2J\n"
    assert said == "handcal:   two  spaces\n"


@pytest.mark.parametrize(
    ("typed", "meant"),
    [(["explian"], "explain"), (["lab", "scalr"], "scalar"), (["alan"], "allan")],
)
def test_a_mistyped_command_is_asked_after(typed, meant, monkeypatch, capsys):
    status, _, said = command(monkeypatch, capsys, *typed)
    assert status == 2
    assert f"Did you mean {meant}" in said
    assert len(said.splitlines()) == 1


def test_a_result_given_as_a_recording_is_recognised(tmp_path, monkeypatch, capsys):
    path = tmp_path / "result.json"
    for kind, remedy in (
        ("calibration", f"handcal apply RECORDING --from {path}"),
        ("explanation", f"handcal apply RECORDING --from {path}"),
        ("allan", "name the recording"),
    ):
        path.write_text(json.dumps({"schema": f"handcal/{kind}/1", "parameters": []}))
        status, _, said = command(monkeypatch, capsys, "calibrate", path)
        assert status == 2
        assert "and no recording: " in said
        assert remedy in said


def test_wrong_input_is_a_value_error(tmp_path):
    with pytest.raises(ValueError, match="does not exist"):
        handcal.read(tmp_path / "nothing.csv")
