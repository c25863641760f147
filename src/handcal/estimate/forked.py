"""Work that does not depend on each other, such as fits, on two cores; the results come in their
order.

A copy of the process does the next piece of work while this one does its own (or the next few,
where each takes less time than is worth a copy): it has all that it needs, and nothing has to be
sent to it. What it found is sent back, and what that shares with what
the work was given (readings, effects) is referred to, not copied. Effects and observations, which
hold functions and addresses of compiled ones, are only ever referred to: work whose result holds
new ones is done once more, here.
"""

from __future__ import annotations

import ctypes
import gc
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import partial
from itertools import islice
from types import FunctionType, MethodType
from typing import Any, Generic, NoReturn, TypeVar, cast

import numpy as np

from handcal.compiled import memory
from handcal.effects import Effect, catalogue
from handcal.estimate.assemble import addresses
from handcal.estimate.linear import About
from handcal.estimate.parallel import BUSY, two_cores
from handcal.estimate.problem import Problem
from handcal.observations import Observation
from handcal.types import Markov

T = TypeVar("T")
# What is never sent, only referred to.
REFERRED = (Effect, Observation)
# What is not worth referring to.
PLAIN = (str, bytes, int, float, complex, np.generic, type(None), type)
# Seconds of work for which a copy is made: to make one, and what it costs this process afterwards,
# takes some 15 ms.
WORTH_S = 0.15
# Calls that it does at the most, of which the first may be a bad guess of how long the others take.
MOST = 8
# Linux' number of what a process is told when its parent is gone (prctl).
_PARENT_GONE = 1


def in_parallel(calls: Iterable[Callable[[], T]]) -> Iterator[T]:
    """What the calls return, in their order; two run at a time where this is a program of its own
    with two cores and nothing else of it does so.

    Calls must change nothing: with the copy that does some of them this is lost. Whoever stops
    asking leaves those that have not begun undone.
    """
    waiting = enumerate(calls)
    if not _two_at_once():
        yield from (call() for _, call in waiting)
        return
    known = _reached(catalogue())
    done: dict[int, Callable[[], T]] = {}
    begun: list[_Beside[T]] = []
    beside: _Beside[T] | None = None
    wanted, took = 0, WORTH_S
    try:
        while True:
            if beside is not None and beside.over():
                done |= enumerate(beside.results(), beside.first)
                beside = None
            if wanted in done:
                yield done.pop(wanted)()
                wanted += 1
            elif (mine := next(waiting, None)) is not None:
                many = max(1, min(MOST, round(WORTH_S / took)))
                later = list(islice(waiting, many)) if beside is None else []
                if later:
                    beside = _Beside(later[0][0], [call for _, call in later], known)
                    begun.append(beside)
                began = time.perf_counter()
                done[mine[0]] = _ready(mine[1])
                took = max(time.perf_counter() - began, 1e-6)
            elif beside is not None:
                beside.wait()
            else:
                return
    finally:
        for one in begun:
            one.stop()


def _two_at_once() -> bool:
    """Whether a copy of this process may work beside it. (Of a thread that is not the first a copy
    would lack the others, a process of several has no core for another, and where nobody waits for
    processes nothing is known of how they end.)"""
    return (
        sys.platform == "linux"
        and two_cores()
        and signal.getsignal(signal.SIGCHLD) is not signal.SIG_IGN
        and threading.current_thread() is threading.main_thread()
        and multiprocessing.parent_process() is None
        and not BUSY.get()
    )


def _ready(call: Callable[[], T]) -> Callable[[], T]:
    """What says what the call returns. (What it raises is raised in its turn, and never where
    nobody asks so far.)"""
    try:
        found = _busy(call)
    except Exception:
        return partial(_busy, call)
    return partial(_same, found)


def _busy(call: Callable[[], T]) -> T:
    """What the call returns, on one core."""
    before = BUSY.set(True)
    try:
        return call()
    finally:
        BUSY.reset(before)


class _Beside(Generic[T]):
    """Calls that a copy of this process does. first: the number of the first of them."""

    def __init__(
        self, first: int, calls: list[Callable[[], T]], known: Mapping[int, object]
    ) -> None:
        self.first, self._calls = first, calls
        self._known = {**known, **_reached(calls)}
        self._sent, self._status = -1, cast(int | None, None)
        try:
            self._sent = os.memfd_create("handcal")
            process = _copied()
        except OSError:  # (no room for another: all is done here)
            self._status = 1
            return
        if process == 0:
            _work(calls, self._sent, self._known)
        self._process = process

    def over(self) -> bool:
        """Whether it is done."""
        return self._status is not None or self._ended(os.WNOHANG)

    def wait(self) -> None:
        """Until it is done."""
        if self._status is None:
            self._ended(0)

    def results(self) -> list[Callable[[], T]]:
        """What say what each call returned; where the copy could not, what it returns here."""
        try:
            if self._status != 0:
                return [partial(_busy, call) for call in self._calls]
            with open(self._sent, "rb", closefd=False) as sent:
                sent.seek(0)
                found = cast(list[T], _Receiver(sent, self._known).load())
            return [partial(_same, x) for x in found]
        finally:
            self._close()

    def stop(self) -> None:
        """Nobody wants the result any more."""
        if self._status is None:
            os.kill(self._process, signal.SIGKILL)
            self._ended(0)
        self._close()

    def _close(self) -> None:
        if self._sent >= 0:
            os.close(self._sent)
        self._sent = -1

    def _ended(self, how: int) -> bool:
        try:
            process, status = os.waitpid(self._process, how)
        except ChildProcessError:  # (somebody else has waited for it)
            process, status = self._process, 1
        if process:
            self._status = status
        return process != 0


def _same(found: T) -> T:
    return found


def _copied() -> int:
    """The process of a copy of this one; in the copy 0. Raises OSError where there is no room."""
    memory.emptied()
    with warnings.catch_warnings():
        # (that other threads are not copied; none of them has to do with fits)
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def _work(calls: Iterable[Callable[[], object]], to: int, known: Mapping[int, object]) -> NoReturn:
    """In the copy: the calls, their results written to this file; ends with status 0 if that is
    so."""
    status = 1
    try:
        # (what Ctrl-C means the first process decides; when that is gone, so is this one)
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        for number in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, signal.SIG_DFL)
        ctypes.CDLL(None).prctl(_PARENT_GONE, signal.SIGKILL)
        gc.freeze()  # (what is only read stays one for both)
        found = [_busy(call) for call in calls]
        with open(to, "wb", closefd=False) as out:
            _Sender(out, known).dump(found)
        status = 0
    finally:
        # (what is raised here is raised again where somebody hears of it)
        os._exit(status)


class _Sender(pickle.Pickler):
    """Writes a result, with numbers for what was there before."""

    def __init__(self, file: Any, known: Mapping[int, object]) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self._known = known

    def persistent_id(self, obj: object) -> int | None:
        if id(obj) in self._known:  # (these are kept: nothing new has their addresses)
            return id(obj)
        # (processes are compared by identity)
        if isinstance(obj, REFERRED) or hasattr(type(obj), Markov.transition.__name__):
            raise pickle.PicklingError(f"a new {type(obj).__name__}")
        return None

    def reducer_override(self, obj: object) -> Any:
        if isinstance(obj, About):
            return About, (obj.problem, obj.start, obj.trajectory)
        if isinstance(obj, Problem):
            return _problem, tuple(getattr(obj, f.name) for f in fields(obj))
        return NotImplemented


def _problem(*parts: Any) -> Problem:
    """A problem that another process made, with addresses as they are in this one."""
    made = Problem(*parts)
    jacobian, function = addresses(made.observations, made.effects)
    tables = made.tables._replace(jacobian=jacobian, function=function)
    object.__setattr__(made, "tables", tables)
    return made


class _Receiver(pickle.Unpickler):
    """Reads what a ``_Sender`` wrote."""

    def __init__(self, file: Any, known: Mapping[int, object]) -> None:
        super().__init__(file)
        self._known = known

    def persistent_load(self, number: int) -> object:
        return self._known[number]


def _reached(what: object) -> dict[int, object]:
    """All that this holds, by its address. (It is kept: no other thing has these addresses.)"""
    found: dict[int, object] = {}
    left = [what]
    while left:
        x = left.pop()
        if isinstance(x, PLAIN) or id(x) in found:
            continue
        found[id(x)] = x
        if isinstance(x, Mapping):
            left += [*x.keys(), *x.values()]
        elif isinstance(x, tuple | list | set | frozenset):
            left += x
        elif isinstance(x, partial):
            left += [x.func, *x.args, *x.keywords.values()]
        elif isinstance(x, MethodType):
            left += [x.__func__, x.__self__]
        elif isinstance(x, FunctionType):
            left += [c.cell_contents for c in x.__closure__ or ()]
        elif is_dataclass(x):
            left += [getattr(x, f.name) for f in fields(x)]
    return found
