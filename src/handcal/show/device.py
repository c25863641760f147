"""What is known of a device: in the terminal, as a page, as JSON, and in sentences."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

import handcal
from handcal import output
from handcal.device.file import Device, Name, unit_of, usual_of
from handcal.device.history import (
    ALARM,
    DAY_S,
    MEMORY_S,
    Differs,
    State,
    courses,
    disagreements,
    plain,
    surprises,
)
from handcal.effects import catalogue
from handcal.estimate.start import BIASES
from handcal.show import words
from handcal.show.drawing import AXES, RC, XYZ, Plot, canvas, svg
from handcal.show.html_page import page
from handcal.show.terminal import table
from handcal.types import Array, Parameter, Prior
from handcal.units import Shown, shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from rich.console import Console

    from handcal import results

SCHEMA: Final = "handcal/device-shown/1"
DAY = "%Y-%m-%d"
# Before the first session and after the last, as a part of all time between them; days where there
# is but one.
MARGIN, ALONE_DAYS = 0.06, 10.0
# A bias is forgotten when it is known to no less than so much of the usual, and about zero.
FADED = 0.95
# Points of a band, besides the sessions.
STEPS = 60


def difference_sentence(d: Differs, device: Device) -> str:
    """That two sessions disagree, which, about what, how surely."""
    unit = shown(unit_of((d.effect, d.name)), [d.before, d.after])
    first, second = (device.sessions[k - 1] for k in (d.first, d.second))
    away = abs(d.after - d.before) / d.sigmas
    values = [unit.value(v, away, sign=True) for v in (d.before, d.after)]
    return (
        f"Sessions {d.first} ({first.recorded:{DAY}}) and {d.second} ({second.recorded:{DAY}}) "
        f"disagree about the {words.effect_title(d.effect).lower()}: {d.name} was {values[0]} and "
        f"is {values[1]} {unit.unit}, {d.sigmas:.0f} sigma apart (chi-square {d.chi2:.0f} of "
        f"{d.dof}; by chance {_chance(d.chance)}). It changed, or one of them lacks an effect; "
        "until another session tells, it counts as no better known than they are apart."
    )


def _chance(p: float) -> str:
    return "less than 1e-12" if p < 1e-12 else f"{p:.0e}"


def surprise_sentences(
    before: Prior, parameters: Sequence[Parameter], covariance: Array
) -> tuple[str, ...]:
    """Where a recording contradicts what was known of the device."""
    name = before.source.get("name", "the device")
    return tuple(
        f"This recording and what was known of {name} disagree about the "
        f"{words.effect_title(e).lower()} (chi-square {chi2:.0f} of {dof}, level {ALARM:g}): is it "
        "the same device, and was it treated alike? What is said here of it lies between the two; "
        "without --device the recording speaks alone."
        for e, chi2, dof in surprises(before, parameters, covariance)
    )


def forgetting() -> str:
    """How biases are forgotten, in a sentence."""
    rates = []
    for effect in ("gyro_bias", "accel_bias"):
        p = catalogue()[effect].parameters[0]
        day = p.prior_sigma * np.sqrt(2.0 * DAY_S / MEMORY_S)
        unit = shown(p.unit, [1.0])
        rates.append(f"{unit.factor * day:.2g} {unit.unit}")
    return (
        f"Biases wander between sessions, by {rates[0]} and {rates[1]} in a day, and within their "
        f"usual range: after {MEMORY_S / DAY_S:.0f} days a third is remembered, after a year "
        "nothing. What else is kept is taken to stay."
    )


def _groups(names: Sequence[Name]) -> dict[str, list[int]]:
    """Numbers of the parameters of each effect."""
    out: dict[str, list[int]] = {}
    for i, (effect, _) in enumerate(names):
        out.setdefault(effect, []).append(i)
    return out


def _unit(states: Sequence[State], at: Sequence[int]) -> Shown:
    """Friendly unit of an effect's parameters."""
    values = [float(v) for s in states for v in (*s.mean[list(at)], *s.sigma[list(at)])]
    return shown(unit_of(states[0].names[at[0]]), values)


def device_json(device: Device, when: datetime) -> results.device.DeviceShown:
    """``device show --json``."""
    now = courses(device, when)[-1]
    return {
        "schema": SCHEMA, "name": device.name, "sha256": device.sha256, "date": when.isoformat(),
        "sessions": [
            {"recorded": s.recorded.isoformat(), "temperature_degC": s.temperature,
             "recordings": list(s.recordings), "parameters": len(s.names)}
            for s in device.sessions
        ],
        "parameters": [
            {"effect": e, "name": n, "value": float(now.mean[i]), "sigma": float(now.sigma[i]),
             "unit": unit_of((e, n))}
            for i, (e, n) in enumerate(now.names)
        ],
        "covariance": now.covariance.tolist(),
        "disagreements": [
            {"sessions": [d.first, d.second], "effect": d.effect, "chi2": d.chi2, "dof": d.dof,
             "chance": d.chance}
            for d in disagreements(device)
        ],
    }  # fmt: skip


def print_device(device: Device, when: datetime, console: Console) -> None:
    """Sessions, what is known, and where sessions disagree."""
    from rich.markup import escape

    count = words.counted(len(device.sessions), "session")
    console.print(f"[bold]{escape(device.name)}[/]  {count}; what is known on {when:{DAY}}")
    for title, columns, rows in _tables(device, when):
        console.print(f"[bold]{title}[/]")
        shown_rows = table(columns[0], *(f">*{column}" for column in columns[1:]))
        for row in rows:
            shown_rows.add_row(*(escape(c) for c in row))
        console.print(shown_rows)
    for d in disagreements(device):
        console.print(f"[yellow]{escape(difference_sentence(d, device))}[/]")
    console.print(forgetting(), style="dim")


def _tables(
    device: Device, when: datetime
) -> Iterator[tuple[str, tuple[str, ...], list[list[str]]]]:
    """Title, columns and rows: of the sessions, of what is known."""
    yield (
        "Sessions", ("", "recorded", "°C", "recordings", "parameters"),
        [[str(k), f"{s.recorded:{DAY} %H:%M}",
          "–" if s.temperature is None else f"{s.temperature:.0f}",
          ", ".join(s.recordings), str(len(s.names))]
         for k, s in enumerate(device.sessions, 1)],
    )  # fmt: skip
    if not device.sessions:
        return
    now, rows = courses(device, when)[-1], []
    usual = usual_of(now.names)
    told = [plain(s, now.names) for s in device.sessions]
    for effect, at in _groups(now.names).items():
        unit = _unit([now], at)
        for i in at:
            last = next(
                (t for t, s in zip(told[::-1], device.sessions[::-1], strict=True)
                 if now.names[i] in s.names and t.sigma[i] < 10.0 * usual[i]),
                None,
            )  # fmt: skip
            title = f"{words.effect_title(effect)} {now.names[i][1]}"
            latest = "–" if last is None else (
                f"{unit.value(last.mean[i], last.sigma[i], sign=True)} ± "
                f"{unit.value(last.sigma[i], last.sigma[i])}"
            )  # fmt: skip
            known = "forgotten", unit.value(usual[i])
            if not _forgotten(now, i, float(usual[i])):
                known = (unit.value(now.mean[i], now.sigma[i], sign=True),
                         unit.value(now.sigma[i], now.sigma[i]))  # fmt: skip
            rows.append([title, *known, unit.unit, latest, unit.value(usual[i])])
    yield (
        "What is known",
        ("parameter", "value", "± 1 sigma", "unit", "last session alone", "usual ±"),
        rows,
    )


def _forgotten(now: State, i: int, usual: float) -> bool:
    """Whether of a bias nothing is known any more but what is usual."""
    faded = now.sigma[i] > FADED * usual and abs(now.mean[i]) < (1.0 - FADED) * usual
    return now.names[i] in BIASES and bool(faded)


def write_device_report(device: Device, when: datetime, path: Path) -> None:
    """One page: sessions, what is known, and each parameter over time. Errors: HandcalError."""
    differ = [difference_sentence(d, device) for d in disagreements(device)]
    context = {
        "version": handcal.__version__,
        "name": device.name,
        "sub": f"{words.counted(len(device.sessions), 'session')}; what is known on {when:{DAY}}.",
        "differ": differ,
        "tables": list(_tables(device, when)),
        "plots": _draw(device, when) if device.sessions else [],
        "forgetting": forgetting(),
    }
    output.write_text(path, page("device.html.j2", context))


def _draw(device: Device, when: datetime) -> list[Plot]:
    import matplotlib as mpl

    names = courses(device, when)[-1].names
    days, moments = _days(device, when)
    first = device.sessions[0].recorded
    dates = [first + timedelta(days=float(d)) for d in moments]
    states = [_full(courses(_until(device, d), d)[-1], names) for d in dates]
    told = [plain(s, names) for s in device.sessions]
    with mpl.rc_context(RC):
        return [
            _history((moments, days), states, told, at[k : k + 3], f"days since {first:{DAY}}")
            for at in _groups(names).values()
            for k in range(0, len(at), 3)
        ]


def _days(device: Device, when: datetime) -> tuple[Array, Array]:
    """Days of the sessions since the first, and those at which the picture has points: just before
    each session and after it, and between."""
    first = device.sessions[0].recorded
    days = np.array([(s.recorded - first).total_seconds() / DAY_S for s in device.sessions])
    now = (when - first).total_seconds() / DAY_S
    end = max(days[-1] * (1.0 + MARGIN), min(now, days[-1] + ALONE_DAYS), 0.01)
    between = np.linspace(0.0, end, STEPS)
    return days, np.unique(np.r_[days, days - 1e-4 * end, between].clip(min=0.0))


def _history(
    times: tuple[Array, Array], states: Sequence[State], told: Sequence[State], at: Sequence[int],
    label: str,
) -> Plot:  # fmt: skip
    """Up to three parameters of an effect; times: of the states, and of the sessions, days."""
    names = states[-1].names
    effect = names[at[0]][0]
    unit = _unit([states[-1]], at)
    figure, axes = canvas(len(at), 1.0 + 1.05 * max(len(at), 2))
    for ax, i in zip(axes, at, strict=True):
        _panel(ax, times, states, told, i, unit)
        ax.set_ylabel(f"{names[i][1]}, {unit.unit}".rstrip(", "))
        ax.locator_params(axis="y", nbins=4)
    axes[-1].set_xlabel(label)
    figure.align_ylabels(axes)
    wanders = " It is forgotten between sessions." if names[at[0]] in BIASES else ""
    caption = (
        "Points: each session alone, ±1 sigma. Line and bands: what was known by then, ±1 and ±3 "
        f"sigma.{wanders}"
    )
    more = "" if at[0] == _groups(names)[effect][0] else ", further"
    title = words.effect_title(effect) + more
    return Plot(title, caption, svg(figure, f"device-{effect}-{at[0]}"))


def _until(device: Device, when: datetime) -> Device:
    """The device as it was known then (to the second)."""
    past = (s for s in device.sessions if (s.recorded - when).total_seconds() < 1.0)
    return replace(device, sessions=tuple(past))


def _full(state: State, names: Sequence[Name]) -> State:
    """The state with what no session had told yet as it usually is."""
    usual = usual_of(names)
    mean, C = np.zeros(len(names)), np.diag(usual**2)
    here = [names.index(n) for n in state.names]
    mean[here] = state.mean
    C[np.ix_(here, here)] = state.covariance
    return State(tuple(names), mean, C)


def _panel(
    ax: Axes, times: tuple[Array, Array], states: Sequence[State], told: Sequence[State], i: int,
    unit: Shown,
) -> None:  # fmt: skip
    moments, days = times
    name = states[0].names[i][1]
    colour = XYZ[AXES.index(name[0])] if name[0] in AXES else XYZ[2]
    mean = unit.factor * np.array([s.mean[i] for s in states])
    sigma = unit.factor * np.array([s.sigma[i] for s in states])
    for times_sigma, alpha in ((3.0, 0.12), (1.0, 0.22)):
        ax.fill_between(moments, mean - times_sigma * sigma, mean + times_sigma * sigma,
                        color=colour, alpha=alpha, lw=0, step=None)  # fmt: skip
    ax.plot(moments, mean, color=colour)
    seen = [k for k, t in enumerate(told) if t.sigma[i] < 10.0 * usual_of(t.names)[i]]
    own = unit.factor * np.array([[told[k].mean[i], told[k].sigma[i]] for k in seen]).reshape(-1, 2)
    ax.errorbar(days[seen], own[:, 0], yerr=own[:, 1], fmt="o", color=colour, markersize=5,
                elinewidth=1.4, capsize=3)  # fmt: skip
    reach = np.r_[mean - 3 * sigma, mean + 3 * sigma]
    low, high = np.quantile(reach, [0.02, 0.98])
    if len(own):
        low, high = min(low, own[:, 0].min()), max(high, own[:, 0].max())
    margin = 0.08 * (high - low) or 1.0
    ax.set_ylim(low - margin, high + margin)
