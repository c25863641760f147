"""The process beside a first run compiles just what that needs, in its types, and never lasts."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from proved import proved

from handcal.compiled import disk_cache
from handcal_sim import simulate, write

# Says what is asked of the folder of compiled functions, and in which types.
ASKED = """
import json
import sys

asked = []


def load(cache, sig, target):
    asked.append([cache._name.split()[1], str(sig)])
    return found(cache, sig, target)


from handcal.compiled import disk_cache

found = disk_cache._WholeCache.load_overload
disk_cache._WholeCache.load_overload = load
{}
json.dump(asked, sys.stdout)
"""
AHEAD = "from handcal.estimate.precompile import compile_ahead\ncompile_ahead()"
FIT = "import handcal\nhandcal.calibrate(handcal.load(sys.argv[1]))"
# What the process that fits compiles itself.
OWN = {"_run", "_linearise_rows", "preintegrate", "turn_noise", "_turned"}


def _asked(code: str, *arguments: Path) -> dict[str, set[str]]:
    command = [sys.executable, "-c", ASKED.format(code), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    out: dict[str, set[str]] = {}
    for name, signature in json.loads(done.stdout):
        out.setdefault(name, set()).add(signature)
    return out


@pytest.mark.prove
def test_what_is_compiled_ahead_is_what_a_fit_needs(tmp_path: Path) -> None:
    path = tmp_path / "turns.mcap"
    write(simulate("three-turns", seed=0, duration_s=12.0), path)
    ahead, fit = _asked(AHEAD), _asked(FIT, path)
    assert set(fit) >= OWN
    assert not OWN & set(ahead)
    missed = {name: types for name, types in fit.items() if not types <= ahead.get(name, set())}
    assert set(missed) == OWN


# Says when it has compiled or has to wait; keeps what it compiled when it is told to.
HOLDS = """
import sys

sys.path.insert(0, sys.argv[1])
import one
from handcal.compiled import disk_cache
from handcal.compiled.jit import njit


def slow(cache, sig, data):
    print("compiled", flush=True)
    sys.stdin.readline()
    return save(cache, sig, data)


def locked(file):
    have = lock(file)
    if not have and not said:
        said.append(print("waits", flush=True))
    return have


said = []
save, disk_cache._Cache.save_overload = disk_cache._Cache.save_overload, slow
lock, disk_cache._locked = disk_cache._locked, locked
print(njit(one.twice)(2), flush=True)
"""


@pytest.mark.skipif(disk_cache.fcntl is None, reason="no locks that end with a process")
@pytest.mark.parametrize("killed", [True, *proved(False)])
def test_one_compiles_and_the_other_waits_while_it_lives(tmp_path: Path, killed: bool) -> None:
    (tmp_path / "one.py").write_text("def twice(x):\n    return x + x\n")
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}

    def begun() -> subprocess.Popen[str]:
        command = [sys.executable, "-c", HOLDS, str(tmp_path)]
        pipe = subprocess.PIPE
        return subprocess.Popen(command, env=env, stdin=pipe, stdout=pipe, text=True)

    with begun() as first:
        assert first.stdout is not None
        assert first.stdout.readline() == "compiled\n"
        with begun() as second:
            assert second.stdout is not None
            assert second.stdout.readline() == "waits\n"
            if killed:
                first.kill()
            else:
                first.communicate("\n")
            said, _ = second.communicate("\n")
    assert said == ("compiled\n4\n" if killed else "4\n")
    assert not list(tmp_path.rglob("*.busy"))
