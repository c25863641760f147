"""What is written: whole or not at all, and never over what was read."""

import os
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import pytest
from fake_result import fake_result
from typer.testing import CliRunner

from handcal.commands._app import app
from handcal.output import beside, check_outputs, whole, write_text
from handcal.types import HandcalError, InputError

GOOD = """
import numpy as np
from handcal.effects import Effect, Param

EFFECT = Effect(
    id="own_law", title="Own law", parameters=(Param("k", "1", 0.01),), story="Odd.",
    source="this test", motion="Any.", validated="this test",
    imu_error=lambda p, signals: p[0] * np.hstack([signals.gyro, signals.accel]),
)
"""


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"recorded")
    return path


def linked(path: Path, kind: str) -> Path:
    """The same file by another name."""
    if kind == "itself":
        return path
    other = path.with_name("other.html")
    if kind == "symbolic":
        other.symlink_to(path)
    elif kind == "hard":
        os.link(path, other)
    else:
        return path.parent / "." / ".." / path.parent.name / path.name
    return other


@pytest.mark.parametrize("kind", ["itself", "symbolic", "hard", "roundabout"])
def test_an_output_is_no_input(recording: Path, kind: str) -> None:
    with pytest.raises(InputError, match="is what is read"):
        check_outputs([None, linked(recording, kind)], [recording])


def test_an_output_is_no_file_of_a_folder_that_is_read(recording: Path) -> None:
    with pytest.raises(InputError, match="is what is read"):
        check_outputs([recording], [recording.parent])
    check_outputs([recording.with_name("new.html")], [recording.parent])


@pytest.mark.parametrize("options", ["--effects-from eff", "--config c.toml"])
def test_nor_is_it_what_an_option_of_every_command_reads(
    options: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "eff").mkdir()
    read = {"eff/own_law.py": GOOD, "c.toml": "[effects]\n"}
    for name, text in read.items():
        Path(name).write_text(text)
    target = next(n for n in read if n.split("/")[0] in options)
    words = ["effects", "--json", target]
    place = 0 if "config" in options else 1
    words[place:place] = options.split()
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 2
    assert "is what is read" in done.stderr
    assert Path(target).read_text() == read[target]
    check_outputs([Path("c.toml")])  # (of the next command it is no input)


COMMANDS = {
    "sweep --grid READ --seeds 1 --out OUT": "grid.toml",
    "sweep --grid READ --seeds 1 --json OUT": "grid.toml",
    "sweep --grid READ --seeds 1 --csv OUT": "grid.toml",
    "sweep --grid READ --seeds 1 --report OUT": "grid.toml",
    "bench --only start --against READ --json OUT": "earlier.json",
    "bench --only devices --recordings DIR --json OUT": "real.mcap",
    "bench --only start --peers DIR --json OUT": "peer.py",
    "prove --n 1 --suite one --effects-from DIR --json OUT": "own_law.py",
    "prove --n 1 --suite one --against READ --json OUT": "older.sh",
    "live --from READ --out NEW --speed 0 --rrd OUT": "a.mcap",
    "live --from READ --out DIR --speed 0": "recording.mcap",
    "live --follow READ --out DIR": "recording.mcap",
    "live --from other.mcap --out DIR --device READ": "calibration.json",
    "live --from other.mcap --out DIR --priors READ": "exports/ros2.yaml",
    "live --phyphox 127.0.0.1:9 --out DIR --device READ": "report.html",
}


@pytest.mark.parametrize("kind", ["itself", "symbolic", "hard", "roundabout"])
@pytest.mark.parametrize("words", COMMANDS)
def test_nor_what_a_command_reads_beside_a_recording(
    words: str, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where a session's own names are the outputs, what is read is one of them by a link."""
    monkeypatch.chdir(tmp_path)
    target = tmp_path / "dir" / COMMANDS[words]
    target.parent.mkdir(parents=True)
    target.write_text(GOOD)
    target.chmod(0o755)
    other = linked(target, kind)
    names = {"READ": other, "OUT": target, "DIR": tmp_path / "dir", "NEW": tmp_path / "new"}
    if words.endswith("OUT"):
        names |= {"READ": target, "OUT": other}
        if "DIR" in words and kind != "itself":  # (one in the folder that is read, by a way round)
            names["OUT"] = other.parent / ".." / "dir" / other.name
    done = CliRunner().invoke(app, [str(names.get(w, w)) for w in words.split()])
    assert done.exit_code == 2, done.output
    assert "is what is read" in done.stderr
    assert target.read_text() == GOOD
    assert not (tmp_path / "new").exists()


def test_a_fleet_does_not_replace_the_priors_that_it_reads(tmp_path: Path) -> None:
    """Nor its manifest: nothing runs before that is known."""
    (tmp_path / "out" / "recordings").mkdir(parents=True)
    (tmp_path / "a.mcap").write_bytes(b"")
    for option, name in (("--priors", "priors.toml"), ("--manifest", "fleet.json")):
        file = tmp_path / "out" / name
        file.write_text("path,device,model\n../a.mcap,d,m\n")
        words = ["fleet", str(tmp_path / "a.mcap"), "--out", str(tmp_path / "out"), option]
        done = CliRunner().invoke(app, [*words, str(file)])
        assert done.exit_code == 2
        assert "is what is read" in done.stderr


def test_two_outputs_are_two_files(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="asked for twice"):
        check_outputs([tmp_path / "x", tmp_path / "x"])
    check_outputs([Path("-"), tmp_path / "x", tmp_path / "y"])


def test_recordings_of_one_name_get_files_of_their_own() -> None:
    one = fake_result().recording
    three = [replace(one, path=p) for p in ("a/x.mcap", "b/x.mcap", "b/y.mcap")]
    names = beside(Path("out/p.html"), three)
    assert len(set(names)) == 3
    assert names[2] == Path("out/p-y.html")


def test_what_is_broken_off_leaves_the_old_file(recording: Path) -> None:
    def broken_off() -> None:
        with whole(recording) as place:
            place.write_bytes(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        broken_off()
    assert recording.read_bytes() == b"recorded"
    assert [p.name for p in recording.parent.iterdir()] == ["a.mcap"]


def test_a_link_stays_a_link_and_rights_stay(recording: Path) -> None:
    link = recording.with_name("link")
    link.symlink_to(recording)
    recording.chmod(0o640)
    write_text(link, "new")
    assert link.is_symlink()
    assert recording.read_text() == "new"
    assert recording.stat().st_mode & 0o777 == 0o640


def test_a_new_file_has_the_usual_rights(tmp_path: Path) -> None:
    write_text(tmp_path / "ours", "x")
    (tmp_path / "usual").write_text("x")
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "usual").stat().st_mode


def test_a_pipe_is_written_to_as_it_is(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    got: list[str] = []
    reader = threading.Thread(target=lambda: got.append(pipe.read_text()))
    reader.start()
    write_text(pipe, "through")
    reader.join(10.0)
    assert got == ["through"]
    assert pipe.is_fifo()


def test_what_cannot_be_written_is_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(HandcalError, match="could not be written"):
        write_text(tmp_path, "x")


KILLED = """
import os, signal
from handcal.output import whole
with whole("out") as place:
    place.write_bytes(b"half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_process_left_goes_with_the_next_file(tmp_path: Path) -> None:
    """And what another process is writing, however long it takes, does not."""
    subprocess.run([sys.executable, "-c", KILLED], cwd=tmp_path, check=False)
    (left,) = tmp_path.iterdir()
    assert left.name.endswith(".part")
    write_text(tmp_path / "out", "just begun by another, for all one knows")
    assert left.exists()
    os.utime(left, (0, 0))
    with whole(tmp_path / "out") as slow:
        os.utime(slow, (0, 0))
        write_text(tmp_path / "out", "first")
        assert not left.exists()
        slow.write_text("last")
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    assert (tmp_path / "out").read_text() == "last"


WRITES = """
import sys
from handcal.output import write_text
for _ in range(100):
    write_text("out", sys.argv[1] * 200_000)
"""


def test_two_that_write_one_file_leave_a_whole_one(tmp_path: Path) -> None:
    """A hundred times each, read all the while."""
    write_text(tmp_path / "out", "a" * 200_000)
    running = [subprocess.Popen([sys.executable, "-c", WRITES, c], cwd=tmp_path) for c in "ab"]
    seen: set[str] = set()
    while any(child.poll() is None for child in running):
        seen.add((tmp_path / "out").read_text())
    assert [child.returncode for child in running] == [0, 0]
    assert seen == {"a" * 200_000, "b" * 200_000}
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
