"""What ``handcal bench`` is made of: figures, rounds in which things take turns, other programs.

A figure is a ratio, wherever it can be: two things take turns, round by round, and their ratio
is taken within each round, so that a machine that is now slow and now fast, or busy with
something else, spoils neither. What runs in one thread is measured in CPU time, which does not
count the waiting for a busy processor; what a person waits for, in wall time.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from handcal.bench.sampler import SAMPLED
from handcal.types import Array, HandcalError

# A side is repeated until it has used this much CPU time: clocks are no finer than 10 ms.
ENOUGH_S = 0.15
MEGA = 1e6
_APART, _SAMPLER = (Path(__file__).with_name(name) for name in ("apart.py", "sampler.py"))


@dataclass(frozen=True)
class Target:
    """What is asked of a figure: at most or at least this."""

    value: float
    at_most: bool

    def met(self, value: float) -> bool:
        """Whether this value is good enough."""
        return value <= self.value if self.at_most else value >= self.value


@dataclass(frozen=True)
class Figure:
    """One line of the table: what it is, its value in every round, what is asked of it.

    clock: "cpu" or "wall" time, or "" where it is no time.
    """

    group: str
    title: str
    unit: str
    rounds: Array
    clock: str = ""
    target: Target | None = None

    @property
    def value(self) -> float:
        """The median over the rounds."""
        return float(np.median(self.rounds))

    @property
    def more_is_better(self) -> bool:
        """Whether a larger value is the better one."""
        return self.target is not None and not self.target.at_most

    @property
    def met(self) -> bool | None:
        """Whether the median is good enough; None where nothing is asked."""
        return None if self.target is None else self.target.met(self.value)


@dataclass(frozen=True)
class Skipped:
    """What could not be measured, and the sentence that says why."""

    group: str
    title: str
    reason: str


@dataclass(frozen=True)
class Profile:
    """Where the time of a command goes: seconds by the module at work, and by what asked for it."""

    group: str
    title: str
    doing: Mapping[str, float]
    asked_by: Mapping[str, float]


class Spent(NamedTuple):
    """CPU and wall time of one step, s."""

    cpu: float
    wall: float


class Tick(Protocol):
    """Told of everything that begins (``what``), and now and then that it goes on."""

    def __call__(self, what: str = "") -> None: ...


Side = Callable[[], Spent]
Row = Figure | Skipped | Profile
Rows = Iterable[Row]
Found = list[Row]


class Missing(HandcalError):
    """Something to compare with is not there."""


def side(work: Callable[[], int]) -> Side:
    """Time of one step of ``work``, which does its steps once and returns how many."""

    def measure() -> Spent:
        cpu, wall, steps = time.process_time(), time.perf_counter(), 0
        while time.process_time() - cpu < ENOUGH_S:
            steps += work()
        return Spent((time.process_time() - cpu) / steps, (time.perf_counter() - wall) / steps)

    return measure


def in_turns(sides: Sequence[Side], rounds: int, tick: Tick) -> tuple[Array, Array]:
    """CPU and wall time (rounds, sides) of a step, s; the order is reversed every other round.

    Each side is run once beforehand: what happens only the first time is not measured.
    """
    for one in sides:
        one()
    spent = np.empty((rounds, len(sides), 2))
    for r in range(rounds):
        order = range(len(sides)) if r % 2 == 0 else reversed(range(len(sides)))
        for k in order:
            spent[r, k] = sides[k]()
        tick()
    return spent[:, :, 0], spent[:, :, 1]


# ---- other programs ---------------------------------------------------------------------------


@contextmanager
def peer(command: Sequence[str | Path]) -> Iterator[Side]:
    """A program that measures itself whenever it is told (see ``benchmarks/peers/_serve.py``).

    Raises Missing where it is not there, or ends before it is ready.
    """
    with tempfile.TemporaryFile("w+") as said:
        try:
            child = subprocess.Popen(
                [str(part) for part in command],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=said,
                text=True,
                env=one_thread(),
            )
        except OSError as problem:
            raise Missing(f"{command[0]} could not be started: {problem.strerror}.") from None
        with child:
            try:
                _wait_until_ready(child)
                yield lambda: _ask(child)
            except BrokenPipeError:
                said.seek(0)
                last = (said.read().strip().splitlines() or ["without a word"])[-1]
                raise Missing(f"{Path(command[1]).name} broke off: {last}.") from None
            finally:
                child.kill()


def _wait_until_ready(child: subprocess.Popen[str]) -> None:
    """Past what is printed by imports, to the line that says ready, or what is missing."""
    assert child.stdout is not None
    for line in child.stdout:
        word, _, rest = line.strip().partition(" ")
        if word == "ready":
            return
        if word == "missing":
            raise Missing(f"pip install {rest} brings it.")
    raise BrokenPipeError


def _ask(child: subprocess.Popen[str]) -> Spent:
    assert child.stdin is not None
    assert child.stdout is not None
    child.stdin.write("\n")
    child.stdin.flush()
    answer = child.stdout.readline().split()
    if len(answer) != 3:
        raise BrokenPipeError
    steps, cpu, wall = map(float, answer)
    return Spent(cpu / steps, wall / steps)


THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def one_thread(more: Mapping[str, str] | None = None) -> dict[str, str]:
    """The environment for a program whose CPU time is to be that of one thread."""
    return {**os.environ, **dict.fromkeys(THREADS, "1"), **(more or {})}


def any_threads(more: Mapping[str, str] | None = None) -> dict[str, str]:
    """The environment of a program as a person runs it, who asks for no number of threads."""
    return {k: v for k, v in os.environ.items() if k not in THREADS} | dict(more or {})


class Ran(NamedTuple):
    """What a program used until it ended: CPU and wall time s, most memory MB (NaN: unknown); and
    the lines that it said on stderr, each with when (s)."""

    cpu: float
    wall: float
    memory: float
    said: tuple[tuple[float, str], ...] = ()


def run_handcal(
    *arguments: str | Path, cache: Path | None = None, whole: bool = False, sampled: bool = False
) -> Ran:
    """Run a command of handcal's in a process of its own. Raises HandcalError if that fails.

    cache: the folder for compiled functions; whole: with all the threads that it may have;
    sampled: with the line at its end that ``profile`` reads.
    """
    own = {"NUMBA_CACHE_DIR": str(cache)} if cache else {}
    environment = any_threads(own) if whole else one_thread(own)
    shown = f"handcal {' '.join(map(str, arguments))}"
    how = ["-P", str(_SAMPLER)] if sampled else ["-m", "handcal"]
    return _run([sys.executable, *how, *map(str, arguments)], shown, environment)


def profile(group: str, title: str, ran: Ran) -> Iterator[Profile]:
    """Where the time of a command that was run ``sampled`` went."""
    for _, line in ran.said:
        if line.startswith(SAMPLED):
            yield Profile(group, title, **json.loads(line.removeprefix(SAMPLED)))


def shares(seconds: Mapping[str, float]) -> list[tuple[str, float]]:
    """The parts of a profile in percent of the whole, the largest first."""
    whole = sum(seconds.values())
    largest = sorted(seconds.items(), key=lambda part: -part[1])
    return [(name, 100.0 * s / whole) for name, s in largest]


def run_python(code: str) -> Ran:
    """Run a line of Python in a process of its own. Raises HandcalError if that fails."""
    return _run([sys.executable, "-c", code], f"python -c {code}", one_thread())


def _run(command: Sequence[str], shown: str, environment: Mapping[str, str]) -> Ran:
    begin = time.perf_counter()
    pipe = subprocess.PIPE
    apart = [sys.executable, "-I", "-S", str(_APART), *command]
    with subprocess.Popen(apart, stdout=pipe, stderr=pipe, env=environment, text=True) as child:
        try:
            ran = _ended(child, begin)
        finally:
            # (the wait was interrupted: the result is not wanted any more)
            if child.returncode is None:
                child.terminate()
                child.wait()
    if child.returncode:
        last = ran.said[-1][1] if ran.said else ""
        raise HandcalError(f"'{shown}' failed: {last}")
    return ran


def _ended(child: subprocess.Popen[str], begin: float) -> Ran:
    """Wait for what runs apart; what it used is known where the system tells (not on Windows)."""
    assert child.stderr is not None
    assert child.stdout is not None
    times = [(time.perf_counter() - begin, line.strip()) for line in child.stderr]
    said = tuple((t, line) for t, line in times if line)
    wall, cpu, most = map(float, child.stdout.read().split() or ["nan"] * 3)
    child.wait()
    # (kilobytes, but for macOS)
    return Ran(cpu, wall, most * (1 if sys.platform == "darwin" else 1024) / MEGA, said)
