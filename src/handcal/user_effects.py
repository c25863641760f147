"""Effect files of the user's own: a folder whose files are run and join the catalogue.

A file is written like those in ``effects/`` (``explain --write-effect`` writes them): it defines
``EFFECT``. Files that begin with an underscore are left alone. Nothing is read that was not asked
for, since reading such a file is running it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from handcal.effects import ATTITUDE, Effect, Signals, with_effects
from handcal.output import not_over
from handcal.signals import probe
from handcal.types import Array, InputError

# Samples of the motion on which a file's error is tried: enough for any difference or filter.
TRIED = 20
# Usual sizes within which an error has to be a number, whatever the motion. (A fit may ask for
# more on its way, and turns back where that is none.)
USUAL = 3.0


def files(folder: Path) -> list[Path]:
    """The effect files of a folder, by name. Raises InputError if there is none."""
    if folder.is_file():
        raise InputError(f"--effects-from {folder}: that is a file; name the folder it is in.")
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
    return _watched(path, effect)


def _watched(path: Path, effect: Effect) -> Effect:
    """The effect with functions that say what is wrong with what they give, here of a short motion
    (a typing error shows at once, not in a long fit) and later of any recording. Raises InputError
    as ``effects_from`` does."""
    if not effect.parameters:
        raise InputError(f"{path}: the effect has no parameter, so there is nothing to find.")
    for p, size in zip(effect.parameters, effect.prior_sigma, strict=True):
        if not (np.isfinite(size) and size > 0.0):
            raise InputError(f"{path}: the usual size of {p.name} has to be a number above zero.")
    watched = effect
    if effect.imu_error is not None:
        error = partial(_error, path, effect.imu_error, effect.prior_sigma)
        watched = replace(watched, imu_error=error)
    if effect.seen:
        wide = len(effect.parameters)
        seen = {k: partial(_seen, path, f"seen[{k!r}]", f, wide) for k, f in effect.seen.items()}
        watched = replace(watched, seen=seen)
    signals = probe(TRIED)
    if watched.imu_error is not None and set(effect.needs) <= {ATTITUDE, *signals.streams}:
        watched.imu_error(effect.prior_sigma, signals)
    return watched


def _error(
    path: Path, function: Callable[[Array, Signals], Any], usual: Array, p: Array, signals: Signals
) -> Array:
    """What ``imu_error`` gives, (n, 6). Raises InputError where it is none."""
    what = f"{path}: imu_error"
    out = _array(what, lambda: function(p, signals), (len(signals.t), 6))
    if not np.isfinite(out).all() and np.all(np.abs(p) <= USUAL * usual) and _told(signals):
        k, channel = np.argwhere(~np.isfinite(out))[0]
        where = f"{('gyro', 'accelerometer')[channel // 3]} {'xyz'[channel % 3]}"
        raise InputError(
            f"{what} has to give finite numbers, and gives {out[k, channel]} of "
            f"{where} {signals.t[k] - signals.t[0]:.3g} s after the start."
        )
    return out


def _seen(
    path: Path, name: str, function: Callable[[Signals], Any], wide: int, signals: Signals
) -> Array:
    """What a function of ``seen`` gives, (n, parameters). Raises InputError where it is none."""
    return _array(f"{path}: {name}", lambda: function(signals), (len(signals.t), wide))


def _array(what: str, make: Callable[[], Any], shape: tuple[int, int]) -> Array:
    """An array of this shape. Raises InputError where it is none."""
    try:
        out = np.asarray(make(), dtype=np.float64)
    except Exception as problem:
        raise InputError(
            f"{what} fails, {_said(problem)}. (signals.temperature is None without a thermometer, "
            "signals.C_nb is there for an effect with needs=(ATTITUDE,).)"
        ) from problem
    if out.shape != shape:
        raise InputError(
            f"{what} has to give an array {shape} of {shape[0]} samples, and gives {out.shape}."
        )
    return out


def _told(signals: Signals) -> bool:
    """Whether the motion itself is known (that of a fit which diverges is not)."""
    return bool(np.isfinite(signals.gyro).all() and np.isfinite(signals.accel).all())


def _said(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".rstrip(".")
