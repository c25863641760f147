"""Modules that handcal's dependencies import, and that handcal hardly ever needs: loaded on first
use."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from types import ModuleType

# Imported by scipy, which looks through all that numpy has; by numba, in case there are settings
# of it to be read; by scipy.spatial, of which scipy.interpolate needs something else.
LATER = frozenset({"numpy.f2py", "yaml", "scipy.spatial.transform"})


class _Later(MetaPathFinder):
    """Finds these modules where they are, and loads each when it is first asked for something."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        spec = PathFinder.find_spec(fullname, path, target) if fullname in LATER else None
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec


def put_off() -> None:
    """Let these modules be loaded where one is used, from now on."""
    sys.meta_path.insert(0, _Later())
