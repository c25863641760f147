"""The places of the accelerometers as JSON, as a page and in the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from handcal.design.poses import MOUNTING
from handcal.earth import STANDARD_GRAVITY
from handcal.lab.size import ARMS, Sized, force_of
from handcal.lab.spins import SPINNING
from handcal.show import words
from handcal.show.calibration import summary
from handcal.show.drawing import MUTED, RC, XYZ, Plot, canvas, legend, svg
from handcal.show.lab.sheet import Sheet, Table
from handcal.types import CALIBRATION_SCHEMA, Array, BoolArray
from handcal.units import DEG, Shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MM = 1000.0
MG = 1000.0 / STANDARD_GRAVITY
BINS = 8
FEWEST = 12
EXAMPLE = 200.0


def size_json(result: Sized, file: Path) -> dict[str, Any]:
    """``lab size --json``: what ``calibrate --json`` has, and what the arms explain.

    handcal apply takes it as it takes that.
    """
    lever, sigma = result.lever
    recording = result.recording
    return {
        "schema": CALIBRATION_SCHEMA,
        "method": f"size-effect from {result.way}",
        "recording": {"path": str(file)} if recording is None
        else summary.recording_json(recording, "rest-only"),
        "parameters": [summary.parameter_json(p) for p in result.parameters
                       if p.effect != MOUNTING.id],
        "covariance": result.covariance.tolist(),
        "noise": [],
        "fit": {"log_evidence": None, "observations": int(result.after.size),
                "nis": {}, "whiteness": {}},
        "mounting": [summary.parameter_json(p) for p in result.parameters
                     if p.effect == MOUNTING.id],
        "mean_place": {"value": lever.tolist(), "sigma": sigma.tolist(), "unit": "m"},
        "residual_rms": {"before": _rms(result.before[_turning(result)]).tolist(),
                         "after": _rms(result.after[_turning(result)]).tolist(), "unit": "m/s^2"},
        "warnings": _warnings(result),
    }  # fmt: skip


def size_sheet(result: Sized, name: str, pictures: bool) -> Sheet:
    """What a person sees; name: of the file."""
    before, after = (_rms(x[_turning(result)]) for x in (result.before, result.after))
    largest = float(np.abs(result.arms).max())
    felt = force_of(EXAMPLE, largest)
    return Sheet(
        title=f"Size effect of {name}",
        sub=_from(result),
        facts=(
            (f"{MM * largest:.1f} mm", "longest arm"),
            (f"{MM * float(result.arm_sigma.max()):.2g} mm", "± at worst"),
            (f"{_mg(felt)} mg", f"of force at {EXAMPLE:.0f} deg/s"),
            (f"{_less(before, after):.3g} times", "less is left of the readings"),
        ),
        sentences=_sentences(result, before, after),
        parameters=tuple(p for p in result.parameters if p.effect != ARMS[0].id),
        tables=(_places(result), _left(before, after, result.way)),
        plots=tuple(_plots(result)) if pictures else (),
        warnings=tuple(_warnings(result)),
    )


def _from(result: Sized) -> str:
    turning = int(_turning(result).sum())
    if result.way == "spins":
        return f"{words.counted(turning, 'steady spin')} and {len(result.rate) - turning} rests"
    return f"{turning} readings in fast turns, beside those of the reference"


def _turning(result: Sized) -> BoolArray:
    return np.asarray(result.rate > SPINNING)


def _sentences(result: Sized, before: Array, after: Array) -> tuple[str, ...]:
    lever, sigma = result.lever
    whence = (
        "from the accelerometer of the reference with the same axis"
        if result.way == "reference"
        else "from the axis of the table"
    )
    middle = ", ".join(
        f"{MM * v:.2f} ± {MM * s:.2g}".replace("-", "−") for v, s in zip(lever, sigma, strict=True)
    )
    return (
        f"Each accelerometer has its place, measured {whence}; the mean of the three is "
        f"({middle}) mm.",
        f"While it turns, {_mg(before.max())} mg of the worst axis are left without "
        f"arms, {_mg(after.max())} mg with them (root mean square).",
    )


def _places(result: Sized) -> Table:
    rows = []
    for axis, place, sigma in zip("xyz", result.arms, result.arm_sigma, strict=True):
        cells = [f"{MM * v:+.2f} ± {MM * s:.2g}".replace("-", "−")
                 for v, s in zip(place, sigma, strict=True)]  # fmt: skip
        rows.append((f"accelerometer {axis}", *cells))
    return Table("Places", ("mm", "x", "y", "z"), tuple(rows))


def _left(before: Array, after: Array, way: str) -> Table:
    rows = tuple((f"accelerometer {a}", _mg(b), _mg(c))
                 for a, b, c in zip("xyz", before, after, strict=True))  # fmt: skip
    note = (
        "Sampling misses part of a shake's angular acceleration, which acts across an arm, never "
        "along it."
        if way == "reference"
        else ""
    )
    columns = ("mg, root mean square while it turns", "without", "with arms")
    return Table("What is left of the readings", columns, rows, note=note)


def _rms(x: Array) -> Array:
    return np.asarray(np.sqrt((x**2).mean(axis=0)))


def _mg(force: float) -> str:
    return Shown("mg", MG).value(float(force))


def _less(before: Array, after: Array) -> float:
    return float(np.linalg.norm(before) / max(float(np.linalg.norm(after)), 1e-12))


def _warnings(result: Sized) -> list[str]:
    more = () if result.recording is None else result.recording.warnings
    return list(dict.fromkeys((*more, *result.warnings)))


# --- pictures -----------------------------------------------------------------------------------


def _plots(result: Sized) -> list[Plot]:
    import matplotlib as mpl

    with mpl.rc_context(RC):
        return [_map(result), _by_rate(result)]


def _map(result: Sized) -> Plot:
    """The three places from above and from the front."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.6, 4.2), layout="constrained")
    reach = 1.25 * MM * float(np.abs(result.arms).max() + result.arm_sigma.max())
    for ax, (i, j) in zip(figure.subplots(1, 2), ((0, 1), (0, 2)), strict=True):
        ax.plot([0.0], [0.0], "+", color=MUTED, markersize=12)
        for n, (axis, colour) in enumerate(zip("xyz", XYZ, strict=True)):
            place, sigma = MM * result.arms[n], MM * result.arm_sigma[n]
            ax.errorbar(place[i], place[j], sigma[j], sigma[i], fmt="o", color=colour,
                        markersize=5, lw=1.4, label=f"accelerometer {axis}")  # fmt: skip
        ax.set(aspect="equal", xlim=(-reach, reach), ylim=(-reach, reach),
               xlabel=f"{'xyz'[i]}, mm", ylabel=f"{'xyz'[j]}, mm")  # fmt: skip
    figure.legend(*ax.get_legend_handles_labels(), loc="outside upper right", ncols=3)
    middle = "the reference's own" if result.way == "reference" else "the axis of the table"
    return Plot("Places", f"With one sigma; the cross is {middle}.", svg(figure, "lab-places"))


def _by_rate(result: Sized) -> Plot:
    figure, axes = canvas(3, 5.0)
    for i, ax in enumerate(axes):
        for left, colour, label in ((result.before, MUTED, "without arms"),
                                    (result.after, XYZ[i], "with arms")):  # fmt: skip
            rate, rms = _binned(result.rate, left[:, i])
            ax.plot(DEG * rate, MG * rms, "o-", color=colour, markersize=4, label=label)
        ax.set(ylabel=f"{'xyz'[i]}, mg", ylim=(0.0, None))
        _legend(ax)
    axes[-1].set_xlabel("turning rate, deg/s")
    caption = "What is left of the readings (root mean square), by how fast the device turns."
    return Plot("What the arms explain", caption, svg(figure, "lab-size"))


def _legend(ax: Axes) -> None:
    legend(ax, 2)


def _binned(rate: Array, left: Array) -> tuple[Array, Array]:
    """Mean rates and root mean squares of equally many readings each; of few, each by rate."""
    rate, left = rate[rate > SPINNING], left[rate > SPINNING]
    if len(rate) <= FEWEST * BINS:
        values = np.unique(np.round(rate, 2))
        groups = [np.flatnonzero(np.abs(rate - v) < 0.006) for v in values]
    else:
        groups = np.array_split(np.argsort(rate, kind="stable"), BINS)
    means = np.array([rate[g].mean() for g in groups])
    return means, np.array([np.sqrt((left[g] ** 2).mean()) for g in groups])
