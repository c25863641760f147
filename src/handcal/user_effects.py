"""Effect files of the user's own: a folder whose files are run and join the catalogue.

A file is written like those in ``effects/`` (``explain --write-effect`` writes them): it defines
``EFFECT``. Files that begin with an underscore are left alone. Nothing is read that was not asked
for, since reading such a file is running it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import numpy as np

from handcal.effects import ATTITUDE, Effect, with_effects
from handcal.output import not_over
from handcal.signals import probe
from handcal.types import InputError

# Samples of the motion on which a file's error is tried: enough for any difference or filter.
TRIED = 20


def files(folder: Path) -> list[Path]:
    """The effect files of a folder, by name. Raises InputError if there is none."""
    if not folder.is_dir():
        raise InputError(f"--effects-from {folder}: there is no such folder.")
    found = [p for p in sorted(folder.glob("*.py")) if not p.name.startswith("_")]
    if not found:
        raise InputError(f"--effects-from {folder}: there is no effect file (*.py) in it.")
    return found


@contextmanager
def effects_from(folder: Path | str | None) -> Iterator[None]:
    """Inside, the catalogue has the effects of a folder too, and no output takes the place of one
    of its files; of no folder, all is as it was.

    Raises InputError, naming the file, where one cannot be run, defines no effect or one of which
    there is one already, or where its error is not what an error has to be.
    """
    if folder is None:
        yield
        return
    found = files(Path(folder))
    with with_effects([(str(path), read(path)) for path in found]), not_over(found):
        yield


def read(path: Path) -> Effect:
    """The effect of a file, which is run. Raises InputError as ``effects_from`` does."""
    module = ModuleType(path.stem)
    module.__file__ = str(path)
    try:
        # (neither found by `import` nor kept beside the file: somebody is editing it)
        exec(compile(path.read_bytes(), str(path), "exec"), module.__dict__)
    except SyntaxError as error:
        raise InputError(f"{path}, line {error.lineno}: {error.msg}.") from None
    except Exception as error:
        raise InputError(f"{path} cannot be run: {_said(error)}.") from error
    effect = getattr(module, "EFFECT", None)
    if not isinstance(effect, Effect):
        raise InputError(f"{path} is no effect file: it defines no EFFECT = Effect(...).")
    _check(path, effect)
    return effect


def _check(path: Path, effect: Effect) -> None:
    """Whether its error of the readings is one: a typing error shows here, not in a long fit."""
    signals = probe(TRIED)
    if effect.imu_error is None or not set(effect.needs) <= {ATTITUDE, *signals.streams}:
        return
    try:
        error = np.asarray(effect.imu_error(effect.prior_sigma, signals))
    except Exception as problem:
        raise InputError(f"{path}: imu_error fails, {_said(problem)}.") from problem
    if error.shape != (TRIED, 6) or not np.isfinite(error).all():
        raise InputError(
            f"{path}: imu_error has to give finite numbers, six a sample; of {TRIED} samples it "
            f"gave an array {error.shape}."
        )


def _said(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".rstrip(".")
