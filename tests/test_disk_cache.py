"""Compiled functions on disk: two processes, a damaged, full or missing folder cost time alone."""

from __future__ import annotations

import errno
import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from handcal.compiled import so3
from handcal.compiled.disk_cache import _Files
from handcal.compiled.jit import njit, residual_function

SOURCE = "def twice(x):\n    return x + x\n\n\ndef status(nav, theta, z, out):\n    return 7\n"


@pytest.fixture
def anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], Any]:
    """A function as a new process finds it, compiled or not."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    (tmp_path / "one.py").write_text(SOURCE)

    def module() -> Any:
        spec = importlib.util.spec_from_file_location("one", tmp_path / "one.py")
        made = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, "one", made)  # (what is kept knows its module by name)
        spec.loader.exec_module(made)
        return made

    return lambda: njit(module().twice)


def test_two_that_compile_at_once_take_different_files(
    anew: Callable[[], Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    first, second = anew(), anew()
    with monkeypatch.context() as patched:
        # neither sees in the index what the other is about to write
        patched.setattr(_Files, "_load_index", lambda _: {})
        assert first(2) == 4
        assert second(2.5) == 5.0
    assert len(list(tmp_path.rglob("*.nbc"))) == 2
    third = anew()
    assert third(2.5) == 5.0
    assert third.stats.cache_hits
    assert third(2) == 4


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
@pytest.mark.parametrize("left", [0.0, 0.5, 0.99])
def test_a_damaged_file_is_compiled_again(
    anew: Callable[[], Any], tmp_path: Path, ending: str, left: float
) -> None:
    assert anew()(2) == 4
    (path,) = tmp_path.rglob(f"*.{ending}")
    content = path.read_bytes()
    path.write_bytes(content[: int(left * len(content))])
    assert anew()(2) == 4
    again = anew()
    assert again(2) == 4
    assert again.stats.cache_hits


def test_a_full_disk_costs_time_alone(
    anew: Callable[[], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(_Files, "_open_for_write", full)
    assert anew()(2) == 4


def test_no_folder_to_write_to_costs_time_alone(
    anew: Callable[[], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    # (of numba's places one for modules in zip files alone: there is none for this function)
    monkeypatch.setattr(numba.config, "CACHE_LOCATOR_CLASSES", "ZipCacheLocator")
    assert anew()(2) == 4
    assert int(residual_function(anew().py_func.__globals__["status"]))


CALLS = """
import sys

sys.path.insert(0, sys.argv[1])
import one
from handcal.compiled.jit import njit

one.twice = njit(one.twice)
outer = njit(one.outer)
print(outer(2), outer.stats.cache_hits, one.twice(3))
"""


@pytest.mark.prove
def test_a_function_that_others_call_is_also_called_from_python(tmp_path: Path) -> None:
    (tmp_path / "one.py").write_text(SOURCE + "\n\ndef outer(x):\n    return twice(x) + 1\n")
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    said = [
        subprocess.run([sys.executable, "-c", CALLS, str(tmp_path)], env=env,
                       capture_output=True, text=True, check=True).stdout.split()
        for _ in range(2)
    ]  # fmt: skip
    assert said[0] == ["5", "Counter()", "6"]
    assert said[1][0] == "5"
    assert said[1][-1] == "6"
    assert "1})" in said[1]
    names = sorted(path.name.split("-")[0] for path in tmp_path.rglob("*.nbc"))
    assert names == ["one.outer", "one.twice", "part"]


ALONE = """
import sys

sys.path.insert(0, sys.argv[1])
import one
from handcal.compiled.jit import njit

print(njit(one.outer)(3), "numba.np.arrayobj" in sys.modules)
"""


@pytest.mark.prove
def test_what_is_kept_runs_without_what_compiled_it(tmp_path: Path) -> None:
    """Of functions of numba's own modules, here those that make an array."""
    text = "import numpy as np\n\ndef outer(x):\n    return np.full((x, x), 2.0).sum()\n"
    (tmp_path / "one.py").write_text(text)
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    command = [sys.executable, "-c", ALONE, str(tmp_path)]
    said = [
        subprocess.run(command, env=env, capture_output=True, text=True, check=True).stdout.split()
        for _ in range(2)
    ]
    assert said == [["18.0", "True"], ["18.0", "False"]]


USE = """
import sys

import handcal

r = handcal.calibrate(handcal.load(sys.argv[1]), ["gyro_scale"])
print([repr(p.value) for p in r.parameters])
"""


@pytest.mark.prove
def test_eight_processes_fill_one_empty_folder(tmp_path: Path) -> None:
    from handcal_sim import simulate, write

    recording = tmp_path / "x.mcap"
    write(simulate("three-turns", seed=5, duration_s=20.0), recording)
    for round_ in range(2):
        env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / f"cache{round_}")}
        command = [sys.executable, "-c", USE, str(recording)]
        running = [subprocess.Popen(command, env=env, stdout=subprocess.PIPE, text=True)
                   for _ in range(8)]  # fmt: skip
        said = [child.communicate()[0] for child in running]
        after = subprocess.run(command, env=env, capture_output=True, text=True, check=True)
        assert [child.returncode for child in running] == [0] * 8
        assert {*said, after.stdout} == {after.stdout}


ANOTHER = """
import numba
numba.__version__ = "0.0"
import numpy as np
from handcal.compiled import linking, so3
assert not linking.LINKED
angles = np.array([0.1, -0.2, 0.3])
print(*so3.matrix_exp(angles).ravel())
"""


@pytest.mark.prove
def test_another_release_of_numba_compiles_as_it_does(tmp_path: Path) -> None:
    """What is private to numba is asked of releases on which it was tried, and of no other."""
    angles = np.array([0.1, -0.2, 0.3])
    for _ in range(2):  # (once compiled, once kept)
        done = subprocess.run(
            [sys.executable, "-c", ANOTHER],
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        )
        got = np.array([float(x) for x in done.stdout.split()]).reshape(3, 3)
        np.testing.assert_allclose(got, so3.matrix_exp(angles), atol=1e-15)


EIGHT = """
import importlib.util, os, sys
import numba
numba.config.CACHE_DIR = ""
from handcal.compiled.jit import njit
rounds = int(sys.argv[2])

def one(folder):
    spec = importlib.util.spec_from_file_location("one", folder + "/one.py")
    made = importlib.util.module_from_spec(spec)
    sys.modules["one"] = made
    spec.loader.exec_module(made)
    twice = njit(made.twice)
    good = twice(21) == 42 and twice(2.5) == 5.0
    os._exit(0 if good else 1)

for k in range(rounds):
    folder = f"{sys.argv[1]}/{k}"
    os.makedirs(folder)
    with open(folder + "/one.py", "w") as file:
        file.write("def twice(x):\\n    return x + x\\n")
    children = []
    for _ in range(8):
        child = os.fork()
        if child == 0:
            one(folder)
        children.append(child)
    ends = [os.waitstatus_to_exitcode(os.waitpid(c, 0)[1]) for c in children]
    assert ends == [0] * 8, (k, ends)
"""


@pytest.mark.prove
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs a system that can fork")
def test_eight_processes_fill_one_empty_folder_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each compiles for itself or takes what another has just written; what is left is whole: a
    process that comes later compiles nothing. (`ROUNDS=100` takes a quarter of an hour.)"""
    rounds = int(os.environ.get("ROUNDS", "10"))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    command = [sys.executable, "-c", EIGHT, str(tmp_path), str(rounds)]
    subprocess.run(command, check=True, timeout=1200)
    for k in range(0, rounds, 10):
        spec = importlib.util.spec_from_file_location("one", tmp_path / str(k) / "one.py")
        made = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, "one", made)
        monkeypatch.setattr(numba.config, "CACHE_DIR", "")
        spec.loader.exec_module(made)
        twice = njit(made.twice)
        assert twice(21) == 42
        assert twice(2.5) == 5.0
        assert sum(twice.stats.cache_hits.values()) == 2
