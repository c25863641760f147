"""handcal calibrates cheap inertial sensors while somebody turns them in the hand.

Conventions, decided once (everything else in the package relies on them):

- Navigation frame ``n``: local level, ENU, z up. Body frame ``b``: the IMU's own
  axes (phone: x right, y up, z out of the screen).
- ``C_nb`` takes body vectors to navigation; ``q_nb`` is the same as a quaternion
  w x y z. ``omega_ib_b``: rate of b against inertial space, in b. ``f_b``: specific
  force in b; at rest it reads +g on the axis that points up.
- Attitude error ``psi`` is a rotation vector in n: ``C_nb = exp([psi x]) C_nb_estimated``.
  Every error is true minus estimated.
- Heading (yaw) is ``atan2(C_nb[1, 0], C_nb[0, 0])``: of body x, counter-clockwise
  from east, rad, in (-pi, pi].
- A sensor reads truth plus error: ``gyro_reading = omega_ib_b + error``.
- A sample is the value at its stamp. The gyro's stamps define time; a delay is
  signed: the reading at t is the value at ``t - delay``.
- SI inside (m, s, rad, tesla; degC for temperature); other units only at the edges,
  and named (``_deg``, ``_mg``). Gravity is 9.80665 m/s^2 and the Earth does not turn
  unless a latitude is given.
- Book letters: P covariance, Q process noise, R observation noise, H observation
  matrix, Phi transition.

From Python:

    import handcal as hc

    rec = hc.read("my.mcap")                  # or hc.Recording.from_arrays(t, gyro, accel, ...)
    result = hc.calibrate(rec, ["gyro_scale"])    # also a path, also several of one device
    why = hc.explain(rec)                     # which physics is missing
    hc.conceal(rec, {"gyro_scale": [0.01, 0, 0]}).write("worse.mcap")
    hc.apply(rec, why).write("corrected.mcap")
    hc.allan("still.mcap")                    # noise of a device at rest: N, B, K
    why.save("why.json")                      # and another day:
    why = hc.open_result("why.json")
    hc.export(why, "kalibr", "imu.yaml")      # for another program
    hc.simulate("free-hand", seed=0, effects={"gyro_scale": [0.01, 0, 0]})
    hc.sweep("turns", seeds=10)               # Monte Carlo over noise and settings
    with hc.effects_from("my-effects"): ...   # inside, with effects of your own

``help(hc.explain)`` and so on say more of each. What they give back shows itself as a table:

- ``Recording``: ``imu``, ``streams``, ``warnings``; ``write("file.mcap")``
- ``Calibration``: ``parameters``, ``noise``, ``innovations``; ``plot()``, ``report("page.html")``,
  ``rrd("viewer.rrd")``, ``save("numbers.json")``
- ``Explanation``: ``verdict``, ``missing``, ``unnamed``, ``parameters``; the same four
- ``Saved``: ``parameters``, ``covariance``, ``verdict``, ``missing``, ``warnings``, ``trust``;
  ``plot()``, ``document``
- ``Allan``: ``channels`` (``tau``, ``deviation``, ``terms``), ``suggested``; ``to_pandas()``,
  ``report``, ``save``
- ``Corrected``: ``recording``, ``taken``, ``left``; ``write("file.mcap")``
- ``Parameters``: ``["gyro_scale", "x"]``, ``values``, ``sigmas``, ``to_pandas()``

What cannot be done is a ``HandcalError`` of one sentence, an ``InputError`` where a file or an
argument is wrong.
"""

from __future__ import annotations

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

UNKNOWN = "0+unknown"  # of a copy that was not installed
__all__ = [
    "Allan",
    "Calibration",
    "Corrected",
    "Explanation",
    "HandcalError",
    "InputError",
    "Parameters",
    "Recording",
    "Saved",
    "allan",
    "apply",
    "calibrate",
    "conceal",
    "effects_from",
    "explain",
    "export",
    "load",
    "open_result",
    "read",
    "simulate",
    "sweep",
]

if TYPE_CHECKING:
    __version__: str
    from handcal.api import (
        Allan,
        Calibration,
        Corrected,
        Explanation,
        Parameters,
        Recording,
        Saved,
        allan,
        apply,
        calibrate,
        conceal,
        effects_from,
        explain,
        export,
        open_result,
        read,
    )
    from handcal.recordings.inputs import load
    from handcal.types import HandcalError, InputError

_HOME = {
    "HandcalError": "handcal.types",
    "InputError": "handcal.types",
    "load": "handcal.recordings.inputs",
    # (a program of its own, as behind the commands of these names)
    "simulate": "handcal_sim.commands._from_python",
    "sweep": "handcal_sim.commands._from_python",
}


def __getattr__(name: str) -> Any:
    """Import the heavy parts when first used, so that ``handcal --help`` is instant."""
    if name == "__version__":
        return _version()
    if name in __all__:
        return getattr(import_module(_HOME.get(name, "handcal.api")), name)
    raise AttributeError(f"module 'handcal' has no attribute {name!r}")


def _version() -> str:
    """Of the installed program; git's tags made it when it was built."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("handcal")
    except PackageNotFoundError:
        return UNKNOWN


def __dir__() -> list[str]:
    return sorted({*__all__, "__all__", "__doc__", "__file__", "__name__", "__version__"})


class AlsoAFunction(ModuleType):
    """A package and a function of one name: ``handcal.explain``."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """The function of that name."""
        name = self.__name__.rpartition(".")[2]
        return getattr(import_module("handcal.api"), name)(*arguments, **options)
