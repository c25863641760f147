"""The options of ``calibrate`` and ``explain``, by name, and the sentences where one is wrong."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from numbers import Real
from typing import Any, TypedDict

from handcal.did_you_mean import did_you_mean
from handcal.estimate.start import Start
from handcal.types import InputError, Prior


class Options(TypedDict, total=False):
    """What ``calibrate`` and ``explain`` both take."""

    assume: str
    heading_sigma: float | None
    latitude: float | None
    height: float
    ignore: Sequence[str] | str
    reference_exact: bool
    before: Prior | None


class CalibrateOptions(Options, total=False):
    """What ``calibrate`` takes besides."""

    observations: Sequence[str] | str | None
    noise: Mapping[str, float] | None
    noise_until: float | None
    start: Start | None
    engine: str
    only: bool
    progress: Callable[[float], None] | None


class ExplainOptions(Options, total=False):
    """What ``explain`` takes besides."""

    budget: float | None
    stop: Callable[[], bool] | None
    progress: Callable[[float, str], None] | None


_NUMBERS = {"heading_sigma": "rad", "latitude": "rad", "height": "m", "noise_until": "s",
            "budget": "s"}  # fmt: skip
_NAMES = ("ignore", "observations")


def checked(caller: str, given: Mapping[str, Any], known: type) -> dict[str, Any]:
    """The options as the functions behind take them. Errors: InputError for one that is unknown
    or no such thing."""
    names, out = known.__annotations__, dict(given)
    for name, value in given.items():
        if name not in names:
            raise InputError(
                f"{caller} has no option '{name}'.{did_you_mean(name, names)} It has: "
                f"{', '.join(names)}."
            )
        if name in _NUMBERS and value is not None:
            number(name, value, f" ({_NUMBERS[name]})")
        if name in _NAMES and value is not None:
            out[name] = ids(name, value)
        if name == "noise" and value is not None:
            for level, size in mapping(name, value, '{"gyro_noise": 1e-4}').items():
                number(f"noise: {level}", size, " (SI)")
    return out


def number(name: str, value: Any, unit: str = "") -> None:
    """Errors: InputError where a value is no number."""
    if not isinstance(value, Real) or isinstance(value, bool):
        raise InputError(f"{name} takes a number{unit}, no {type(value).__name__}.")


def ids(name: str, value: Iterable[str] | str) -> list[str]:
    """Names as a list, also of "a,b". Errors: InputError where they are none."""
    if isinstance(value, str):
        return [part.strip() for part in value.split(",") if part.strip()]
    if not isinstance(value, Iterable):
        raise InputError(f"{name} takes names, no {type(value).__name__}.")
    wrong = next((v for v in value if not isinstance(v, str)), None)
    if wrong is not None:
        raise InputError(f"{name} takes names, and {wrong!r:.40} is none.")
    return list(value)


def mapping(name: str, value: Any, example: str) -> Mapping[str, Any]:
    """Errors: InputError where a value is no mapping by names."""
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise InputError(f"{name} takes a dict, as {example}, no {type(value).__name__}.")
    return value


def show(function: Any, known: type, core: Callable[..., Any]) -> None:
    """Let the signature of a function have the options by name, with the defaults of the function
    behind it, so that they are shown and completed."""
    own, theirs = inspect.signature(function), inspect.signature(core).parameters
    first = [p for p in own.parameters.values() if p.kind is not p.VAR_KEYWORD]
    more = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=theirs[name].default,
                          annotation=annotation if isinstance(annotation, str) else
                          getattr(annotation, "__forward_arg__", annotation))
        for name, annotation in known.__annotations__.items()
    ]  # fmt: skip
    function.__signature__ = own.replace(parameters=[*first, *more])
