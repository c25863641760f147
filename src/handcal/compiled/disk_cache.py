"""Compiled functions kept on disk, by numba's means, made safe for what can befall a disk.

Numba numbers its data files after a look at an index that another process may be changing: two
that compile at once can take one number for two signatures, and a third then runs the wrong one.
Here a data file has the name of what is in it, and is whole before the index knows of it. A disk
that is full, read-only or damaged costs time, not the command.

Of processes that need one function at once, one compiles it and the others wait for it, where the
system has locks on files that end with their process (not Windows).
"""
# mypy: disallow-untyped-calls=False

from __future__ import annotations

import contextlib
import hashlib
import inspect
import os
import pickle
import sys
import time
from collections.abc import Callable
from functools import cache
from typing import Any

from llvmlite import binding
from numba.core import caching, environment, event
from numba.core.runtime import _nrt_python  # type: ignore[attr-defined]

from handcal.compiled import shipped
from handcal.compiled.linking import LINKED, readable, rebuilt

fcntl: Any
try:
    import fcntl
except ImportError:  # (Windows)
    fcntl = None

# What reading a damaged pickle ends in.
_DAMAGED = (OSError, EOFError, pickle.UnpicklingError, ValueError, TypeError, AttributeError,
            ImportError, IndexError, KeyError)  # fmt: skip

# Longer than this no function takes; then a process that waits compiles it itself.
LONGEST_S, LOOK_S = 60.0, 0.02


def _environment(module: str, constants: list[Any], name: str) -> Any:
    """Numba's environment of a compiled function, without importing its module: what only
    compiling needs of numba would be (a tenth of a second), for globals that no machine code reads.
    """
    if module in sys.modules or environment.lookup_environment(name) is not None:
        return environment._rebuild_env(module, constants, name)
    made = environment.Environment({"__name__": module})
    made.consts[:] = constants
    made.env_name = name
    environment.Environment._memo[name] = made
    return made


class _Reader(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        """As Python's, but for environments."""
        found = super().find_class(module, name)
        return _environment if found is environment._rebuild_env else found


class _Files(caching.IndexDataCacheFile):
    shipped: _Files | None = None

    def save(self, key: Any, data: Any) -> None:
        """Keep what was compiled for a signature."""
        name = self._name(key)
        self._save_data(name, data)
        try:
            overloads = self._load_index()
        except _DAMAGED:
            overloads = {}
        self._save_index({**overloads, key: name})

    def load(self, key: Any) -> Any:
        """What was kept for a signature, or else shipped, or None; of another naming it is none."""
        try:
            if key in self._load_index():
                return self._load_data(self._name(key))
        except _DAMAGED:
            pass
        return None if self.shipped is None else self.shipped.load(shipped.key_of(key))

    def _load_data(self, name: str) -> Any:
        with open(self._data_path(name), "rb") as file:
            return _Reader(file).load()

    @property
    def empty(self) -> bool:
        """Whether nothing is kept of the source as it is now."""
        try:
            none = not self._load_index()
        except _DAMAGED:
            none = True
        return none and (self.shipped is None or self.shipped.empty)

    def _name(self, key: Any) -> str:
        digest = hashlib.sha256(repr(key).encode()).hexdigest()[:16]
        return f"{self._index_name.removesuffix('.nbi')}.{digest}.nbc"


class _Results(caching.CompileResultCacheImpl):
    def rebuild(self, target_context: Any, payload: Any) -> Any:
        """The result of what was kept; None where another version of handcal or numba kept it."""
        if readable(payload) != LINKED:
            return None
        return (
            rebuilt(target_context, payload) if LINKED else super().rebuild(target_context, payload)
        )


class _Parts(_Results):
    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        """A name of its own: the function itself may be kept as well."""
        return f"part-{super().get_filename_base(fullname, abiflags)}"


class _Cache(caching.FunctionCache):
    _impl_class = _Results

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        files = self._cache_file
        self._cache_file: _Files = _Files.__new__(_Files)
        self._cache_file.__dict__.update(files.__dict__)
        if shipped.runs_here():
            folder = shipped.folder_of(inspect.getfile(function))
            if folder is not None:
                base, stamp = self._impl.filename_base, self._impl.locator.get_source_stamp()
                self._cache_file.shipped = _Files(str(folder), base, stamp)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """As numba's, but what only compiling needs (every operator of every type, half a second)
        is loaded only where nothing is kept."""
        if LINKED:
            _name_runtime()
            with self._guard_against_spurious_io_errors():
                found = self._load_overload(sig, target_context)
            if found is not None:
                return found
        return super().load_overload(sig, target_context)

    def save_overload(self, sig: Any, data: Any) -> None:
        """As numba's; where nothing can be kept, nothing is."""
        with contextlib.suppress(OSError):
            super().save_overload(sig, data)

    @property
    def empty(self) -> bool:
        """Whether nothing is kept of the function as its source is now."""
        return self._cache_file.empty


class _WholeCache(_Cache):
    """Compiled by one process at a time: numba loads, and if there is nothing compiles and saves,
    all under one lock of its own, so there is never more than one turn to a process."""

    _turn: tuple[str, int] | None = None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """As numba's; waits where another process compiles the same, else takes the turn."""
        found = super().load_overload(sig, target_context)
        if found is not None or fcntl is None:
            return found
        self._end_turn()
        key = self._index_key(sig, target_context.codegen())
        path = os.path.join(self._cache_path, f"{self._cache_file._name(key)}.busy")
        try:
            self._impl.locator.ensure_cache_path()
            file = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
        except OSError:
            return None
        self._turn = path, file
        if _locked(file):
            return None
        with event.trigger_event("numba:compile", data={"dispatcher": self, "args": sig}):
            end = time.monotonic() + LONGEST_S
            while not _locked(file) and time.monotonic() < end:
                time.sleep(LOOK_S)
        found = super().load_overload(sig, target_context)
        if found is not None:
            self._end_turn()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """As numba's, and the next may look."""
        try:
            super().save_overload(sig, data)
        finally:
            self._end_turn()

    def _end_turn(self) -> None:
        if self._turn is not None:
            (path, file), self._turn = self._turn, None
            with contextlib.suppress(OSError):
                os.unlink(path)
            # (a process that was forked meanwhile has the file open, too)
            with contextlib.suppress(OSError):
                fcntl.flock(file, fcntl.LOCK_UN)
            os.close(file)


@cache
def _name_runtime() -> None:
    """Tell the linker where numba's runtime is."""
    for name, address in _nrt_python.c_helpers.items():
        binding.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


def _locked(file: int) -> bool:
    """Whether a lock on the file is had, or cannot be had on this system at all."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


class _PartCache(_Cache):
    _impl_class = _Parts


def kept(function: Callable[..., Any], part: bool = False) -> Any:
    """Where machine code of a function is kept: beside its source, in the user's own cache or
    where NUMBA_CACHE_DIR says; nowhere, if nothing can be written to any of them.

    part: as it is linked into others, in files of its own."""
    try:
        return _PartCache(function) if part else _WholeCache(function)
    except RuntimeError:  # (numba's word for it)
        return caching.NullCache()


def nothing_kept(function: Callable[..., Any]) -> bool:
    """Whether a compiled function has a place on disk that others wait at, and nothing there."""
    cache = getattr(function, "_cache", None)
    return fcntl is not None and isinstance(cache, _WholeCache) and cache.empty
