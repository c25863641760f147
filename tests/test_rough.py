"""Commands that are ended, or cannot write: a status, one sentence, old outputs whole."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pairs
import pytest

from handcal_sim import simulate, write

HANDCAL = (sys.executable, "-m", "handcal")
# (what may write but little would keep half a module)
NO_BYTECODE = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
OLD = b"what was there before"
SIMULATE = ("simulate", "three-turns", "--seed", "5", "--duration", "20", "-o", "out.mcap")
LONG = {
    "simulate": (*SIMULATE,),
    "calibrate": ("calibrate", "x.mcap", "--effects", "gyro_scale", "--json", "out.json"),
    "explain": ("explain", "x.mcap", "--json", "out.json"),
    "conceal": ("conceal", "x.mcap", "--effect", "gyro_scale=0.01,0,0", "-o", "out.mcap"),
    "replay": ("replay", "x.mcap", "--no-viewer", "--speed", "1", "--rrd", "out.rrd"),
    "sweep": ("sweep", "--seeds", "5", "--jobs", "1", "--json", "out.json"),
    "prove": ("prove", "--n", "1", "--seed", "0", "--json", "out.json"),
}


def small_files() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for ending in ("mcap", "json", "rrd"):
        (tmp_path / f"out.{ending}").write_bytes(OLD)
    return tmp_path


def whole(folder: Path) -> None:
    assert [p.name for p in folder.iterdir() if p.name.endswith(".part")] == []
    assert {p.read_bytes() for p in folder.glob("out.*")} == {OLD}


def test_a_file_that_grows_too_large_leaves_the_old_one(folder: Path) -> None:
    done = subprocess.run([*HANDCAL, *SIMULATE], cwd=folder, preexec_fn=small_files,
                          env=NO_BYTECODE, capture_output=True, text=True, check=False)  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "File too large" in done.stderr
    whole(folder)


FULL = """
import resource
from itertools import islice

from fake_result import fake_frames, fake_result
from handcal.show import dashboard, frames
from handcal.types import HandcalError

resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
result = fake_result()
some = islice(fake_frames(result), 200)
layout = frames.layout_of(result, live=True)
for write in (
    lambda: dashboard.save_rrd(result, "out.rrd"),
    lambda: dashboard.replay(some, layout, speed=0.0, rrd="out.rrd", show=False),
):
    try:
        write()
    except HandcalError as error:
        print(error)
"""


@pytest.mark.prove
def test_a_full_disk_is_the_reason_for_a_missing_rrd(folder: Path) -> None:
    """Rerun's own writer waited for ever, or ended early without the reason."""
    path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    env, command = {**NO_BYTECODE, "PYTHONPATH": path}, [sys.executable, "-c", FULL]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True, env=env,
                          timeout=60)  # fmt: skip
    assert done.stdout.splitlines() == ["out.rrd could not be written: File too large."] * 2
    assert done.stderr == ""
    whole(folder)


# ends the program while it imports what reads its command line
EARLY = """
import os, sys

class Ends:
    def find_spec(self, name, *_):
        if name == "handcal.commands._app":
            os.kill(os.getpid(), int(sys.argv[1]))

sys.meta_path.insert(0, Ends())
from handcal.__main__ import main
main()
"""


def _ended(program: str, by: signal.Signals) -> subprocess.CompletedProcess[str]:
    """(What a shell begins in the background is deaf to SIGINT, and so is all that it begins.)"""
    heard = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    command = [sys.executable, "-c", heard + program, str(int(by))]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("ended", [signal.SIGINT, signal.SIGTERM])
def test_what_ends_the_program_is_heard_before_it_imports(ended: signal.Signals) -> None:
    done = _ended(EARLY, ended)
    assert done.returncode == 128 + ended
    assert done.stderr in ("", "handcal: interrupted\n")


# a compiler's callback swallows what the signal raises, and something else comes of it
SWALLOWED = """
import os, sys

from handcal.commands import _registry

class Swallows:
    def __del__(self):
        os.kill(os.getpid(), int(sys.argv[1]))

def hurt(*_, **__):
    Swallows()
    raise RuntimeError("no compiled object yet")

_registry.typer.main.get_command = hurt
_registry.run(None)
"""
# Python notes a plain KeyboardInterrupt in an exec() and ends by the signal, whatever is asked for
IN_EXEC = """
import os, sys

from handcal.commands import _registry

def import_like(*_, **__):
    exec("os.kill(os.getpid(), int(sys.argv[1]))")

_registry.typer.main.get_command = import_like
_registry.run(None)
"""


@pytest.mark.parametrize("program", [SWALLOWED, IN_EXEC], ids=["swallowed", "in exec"])
@pytest.mark.parametrize("ended", [signal.SIGINT, signal.SIGTERM])
def test_what_ends_the_program_is_its_status(program: str, ended: signal.Signals) -> None:
    done = _ended(program, ended)
    assert done.returncode == 128 + ended
    assert done.stderr in ("", "handcal: interrupted\n")


# while Python takes down what is left, after the last of its exit handlers
LATE = """
import os, sys

class Ends:
    def __del__(self, kill=os.kill, pid=os.getpid(), number=int(sys.argv[1])):
        kill(pid, number)

sys.modules["last"] = Ends()
sys.argv[1:] = ["--version"]
from handcal.__main__ import main
main()
"""


@pytest.mark.parametrize("ended", [signal.SIGINT, signal.SIGTERM])
def test_what_ends_the_program_when_all_is_done_does_no_more(ended: signal.Signals) -> None:
    done = _ended(LATE, ended)
    assert done.returncode == 0
    assert done.stdout.startswith("handcal ")
    assert done.stderr == ""


@pytest.mark.prove
def test_a_home_that_cannot_be_written_costs_nothing(tmp_path: Path) -> None:
    env = {k: v for k, v in os.environ.items() if k not in ("MPLCONFIGDIR", "XDG_CACHE_HOME")}
    env |= {"HOME": os.devnull, "XDG_CONFIG_HOME": os.devnull, "TMPDIR": str(tmp_path)}
    command = [*HANDCAL, "design", "poses", "--seed", "0", "--picture", "p.svg"]
    done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True,
                          check=False)  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "handcal: seed 0\n")
    assert [p.name for p in tmp_path.iterdir()] == ["p.svg"]


ORPHAN = """
import os, signal
from handcal.workers import processes

print(processes(1).submit(os.getpid).result(), flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_processes_end_with_their_parent(tmp_path: Path) -> None:
    """Of a sweep that was killed, they waited for ever."""
    script = tmp_path / "x.py"
    script.write_text(f"if __name__ == '__main__':{ORPHAN.replace(chr(10), chr(10) + '    ')}")
    # (which returns when nobody holds the outputs any more)
    done = subprocess.run([sys.executable, script], capture_output=True, timeout=60, check=False)
    assert done.returncode == -signal.SIGKILL
    assert int(done.stdout) > 0


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_a_closed_standard_output_is_no_traceback(folder: Path, closed: str) -> None:
    for arguments, status in (("--version", 0), ("calibrate", 2)):
        program = f'"{sys.executable}" -m handcal {arguments} {closed}'
        done = subprocess.run(program, shell=True, cwd=folder, capture_output=True, text=True,
                              check=False)  # fmt: skip
        assert done.returncode == status
        assert "Traceback" not in done.stderr


def is_whole(file: Path) -> bool:
    """Whether a new output has its end."""
    content = file.read_bytes()
    if file.suffix == ".json":
        return bool(json.loads(content))
    return content.endswith(b"\x89MCAP0\r\n") if file.suffix == ".mcap" else b"RRF2" in content[:4]


@pytest.mark.prove
@pytest.mark.parametrize("name", LONG)
@pytest.mark.parametrize("ended", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_command_that_is_ended_leaves_the_old_files(
    folder: Path, name: str, ended: signal.Signals
) -> None:
    write(simulate("three-turns", seed=5, duration_s=20.0), folder / "x.mcap")
    rng = np.random.default_rng([list(LONG).index(name), ended])
    for wait in rng.uniform(3.0, 8.0, 3):  # (after the imports of a busy machine)
        pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
        child = subprocess.Popen([*HANDCAL, *LONG[name]], cwd=folder, text=True, **pipes)
        time.sleep(wait)
        child.send_signal(ended)
        said = child.communicate(timeout=120)[1]
        assert "Traceback" not in said, said
        if child.returncode == 0:  # it was faster
            for ending in ("mcap", "json", "rrd"):
                (folder / f"out.{ending}").write_bytes(OLD)
            continue
        assert child.returncode == (-9 if ended == signal.SIGKILL else 128 + ended), said
        for file in folder.glob("out.*"):  # old, or new where only the end was still to come
            assert file.read_bytes() == OLD or is_whole(file), file
            file.write_bytes(OLD)
        if ended != signal.SIGKILL:
            whole(folder)


@pytest.mark.prove
def test_two_runs_at_once_leave_whole_files() -> None:
    """One pair of each command; `make pairs` has a hundred."""
    found = pairs.pairs(len(pairs.COMMANDS), seed=0)
    assert found == {kind: [[]] for kind in pairs.COMMANDS}


def test_a_file_of_two_runs_that_is_not_whole_is_seen(tmp_path: Path) -> None:
    right = pairs.Alone({"a.json": {b"{}", b"[]"}}, {"b.html": [40], "c.mcap": [9]}, 1.0)
    page = "<!DOCTYPE html>of 1.mcap</html>"
    (tmp_path / "a.json").write_text("[]")
    (tmp_path / "b.html").write_text(page)
    assert pairs.faults(tmp_path, right) == ["c.mcap: not there"]
    (tmp_path / "a.json").write_text("{]")
    (tmp_path / "b.html").write_text(page.replace("1.mcap", "1.mcap and 2.mcap"))
    (tmp_path / "c.mcap").write_bytes(b"half")
    (tmp_path / ".a.json.x.part").write_bytes(b"")
    said = pairs.faults(tmp_path, right)
    assert [s.split(":")[0] for s in said] == [".a.json.x.part", "a.json", "b.html", "c.mcap"]
    (tmp_path / "b.html").write_text(page[:-3])
    assert "does not end" in " ".join(pairs.faults(tmp_path, right))
