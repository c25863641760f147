"""Compiled functions kept on disk, by numba's means, made safe for what can befall a disk.

Numba numbers its data files after a look at an index that another process may be changing: two
that compile at once can take one number for two signatures, and a third then runs the wrong one.
Here a data file has the name of what is in it, and is whole before the index knows of it. A disk
that is full, read-only or damaged costs time, not the command.
"""
# mypy: disallow-untyped-calls=False

from __future__ import annotations

import contextlib
import hashlib
import pickle
from collections.abc import Callable
from typing import Any

from numba.core import caching

from handcal.compiled.inside import rebuilt

# What reading a damaged pickle ends in.
_DAMAGED = (OSError, EOFError, pickle.UnpicklingError, ValueError, TypeError, AttributeError,
            ImportError, IndexError, KeyError)  # fmt: skip


class _Files(caching.IndexDataCacheFile):
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
        """What was kept for a signature, or None; of another naming it is none."""
        try:
            return self._load_data(self._name(key)) if key in self._load_index() else None
        except _DAMAGED:
            return None

    def _name(self, key: Any) -> str:
        digest = hashlib.sha256(repr(key).encode()).hexdigest()[:16]
        return f"{self._index_name.removesuffix('.nbi')}.{digest}.nbc"


class _Results(caching.CompileResultCacheImpl):
    def rebuild(self, target_context: Any, payload: Any) -> Any:
        """The result of what was kept."""
        return rebuilt(target_context, payload)


class _Parts(_Results):
    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        """A name of its own: the function itself may be kept as well."""
        return f"part-{super().get_filename_base(fullname, abiflags)}"


class _Cache(caching.FunctionCache):
    _impl_class = _Results

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        files = self._cache_file
        self._cache_file = _Files.__new__(_Files)
        self._cache_file.__dict__.update(files.__dict__)

    def save_overload(self, sig: Any, data: Any) -> None:
        """As numba's; where nothing can be kept, nothing is."""
        with contextlib.suppress(OSError):
            super().save_overload(sig, data)


class _PartCache(_Cache):
    _impl_class = _Parts


def kept(function: Callable[..., Any], part: bool = False) -> Any:
    """Where machine code of a function is kept: beside its source, in the user's own cache or
    where NUMBA_CACHE_DIR says; nowhere, if nothing can be written to any of them.

    part: as it is linked into others, in files of its own."""
    try:
        return _PartCache(function) if part else _Cache(function)
    except RuntimeError:  # (numba's word for it)
        return caching.NullCache()
