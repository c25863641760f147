"""An Allan analysis as a page, as JSON and in the terminal."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import handcal
from handcal import output
from handcal.allan.analysis import UNITS, Allan, Channel
from handcal.allan.terms import LAWS
from handcal.show.calibration.summary import digest
from handcal.show.drawing import INK, MUTED, PURPLE, RC, RED, XYZ, Plot, canvas, legend, svg
from handcal.show.html_page import page
from handcal.show.terminal import print_section, table
from handcal.types import Array
from handcal.units import shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from rich.console import Console

SCHEMA = "handcal/allan/1"
TITLES = {"Q": "quantisation", "N": "white noise", "B": "bias instability", "K": "random walk",
          "R": "ramp"}  # fmt: skip
COLOURS = {"Q": RED, "N": XYZ[0], "B": XYZ[1], "K": XYZ[2], "R": PURPLE}
READING = {"gyro": "rad/s", "accel": "m/s^2"}
SENSORS = {"gyro": "Gyro", "accel": "Accelerometer"}
SUGGESTED = {
    "gyro_noise": "Gyro noise",
    "accel_noise": "Accelerometer noise",
    "gyro_bias_walk": "Gyro bias walk",
    "accel_bias_walk": "Accelerometer bias walk",
}


def write_allan_report(result: Allan, path: str | Path) -> None:
    """Write the page as one HTML file; nothing in it needs a network."""
    output.write_text(path, page("allan.html.j2", _context(result)))


def allan_json(result: Allan) -> dict[str, Any]:
    """``allan --json``. Coefficients that were not seen have an upper bound (95 %)."""
    recording = result.recording
    topic = {"topic": recording.topics["imu"]} if "imu" in recording.topics else {}
    return {
        "schema": SCHEMA,
        "recording": {"path": recording.path, "duration_s": recording.duration_s,
                      "imu_rate_hz": result.rate_hz,
                      "streams": {"imu": {"samples": len(recording.imu.t), **topic}},
                      "sha256": digest(Path(recording.path))},
        "span_s": list(result.span),
        "channels": [
            {"channel": c.name, "unit": READING[c.sensor], "tau_s": c.tau.tolist(),
             "deviation": c.deviation.tolist(), "low": c.low.tolist(), "high": c.high.tolist(),
             "edf": c.edf.tolist(), "fit_from_s": c.fit_from_s,
             "coefficients": [{"name": t.name, "value": t.value, "sigma": t.sigma, "unit": t.unit}
                              for t in c.terms],
             "not_seen": [{"name": b.name, "at_most": b.at_most, "unit": b.unit}
                          for b in c.unseen]}
            for c in result.channels
        ],
        "suggested": [{"name": s.name, "value": s.value, "unit": s.unit} for s in result.suggested],
        "not_seen": too_short(result),
        "warnings": _warnings(result),
    }  # fmt: skip


def print_allan(result: Allan, console: Console) -> None:
    """Coefficients, suggestions, and what the record is too short to see."""
    from rich.markup import escape

    console.print(f"[bold]{escape(result.recording.path)}[/]  {used(result)}")
    rows = table("channel", "*noise", "*unit", ">value", ">± 1 sigma")
    for channel, noise, value, sigma, unit in coefficients(result):
        rows.add_row(channel, noise, unit, value, sigma)
    console.print(rows)
    lines = [f"{s.name} = {s.value:.3g} {s.unit}" for s in result.suggested]
    for heading, sentences in (("For the filter", lines), ("Not seen", too_short(result)),
                               ("Warnings", _warnings(result))):  # fmt: skip
        print_section(console, heading, sentences)


def coefficients(result: Allan) -> list[tuple[str, str, str, str, str]]:
    """Channel, noise, value, sigma in % of it and unit of each coefficient that was seen."""
    out = []
    for c in result.channels:
        for t in c.terms:
            unit = shown(t.unit, [t.value])
            sigma = _percent(t.sigma / t.value)
            out.append(
                (c.name, f"{t.name} {TITLES[t.name]}", unit.value(t.value), sigma, unit.unit)
            )
    return out


def too_short(result: Allan) -> list[str]:
    """What this record could not show, in sentences."""
    out = []
    for name in ("B", "K"):
        for sensor, title in SENSORS.items():
            blind = [(c.name[-1], b.at_most) for c in result.channels if c.sensor == sensor
                     for b in c.unseen if b.name == name]  # fmt: skip
            if blind:
                axes, largest = ", ".join(a for a, _ in blind), max(v for _, v in blind)
                unit = shown(UNITS[sensor][name], [largest])
                out.append(
                    f"{title} {axes}: {TITLES[name]} ({name}) was not seen; anything up to "
                    f"{unit.value(largest)} {unit.unit} would have stayed hidden."
                )
    if out:
        length = result.span[1] - result.span[0]
        out.append(
            f"This record of {_time(length)} averages over {_time(result.longest_s)} at most. "
            "Slow noise shows in longer ones: record for hours, at a steady temperature."
        )
    return out


def _context(result: Allan) -> dict[str, Any]:
    rows = []
    for c in result.channels:
        entries = []
        for t in c.terms:
            unit = shown(t.unit, [t.value])
            entries.append({"name": f"{t.name} {TITLES[t.name]}", "value": unit.value(t.value),
                            "sigma": _percent(t.sigma / t.value), "unit": unit.unit})  # fmt: skip
        rows.append({"title": _title(c), "terms": entries})
    suggested = []
    for s in result.suggested:
        unit = shown(s.unit, [s.value])
        suggested.append((SUGGESTED[s.name], s.name, f"{s.value:.3g}", s.unit,
                          f"{unit.value(s.value)} {unit.unit}"))  # fmt: skip
    length = result.span[1] - result.span[0]
    return {
        "name": Path(result.recording.path).name, "version": handcal.__version__,
        "used": used(result),
        "facts": [(_time(length), "at rest"), (f"{result.rate_hz:.0f} Hz", "readings"),
                  (_time(result.longest_s), "longest averaging time"),
                  (f"{sum(len(c.terms) for c in result.channels)}", "coefficients seen")],
        "channels": rows, "suggested": suggested,
        "walks": [SUGGESTED[f"{s}_bias_walk"] for s in result.recording.sensors
                  if all(x.name != f"{s}_bias_walk" for x in result.suggested)],
        "too_short": too_short(result), "warnings": _warnings(result), "plots": draw(result),
    }  # fmt: skip


def draw(result: Allan) -> dict[str, list[Plot]]:
    """Figures: "sensors", the three axes of each in one; "channels", with their terms."""
    import matplotlib as mpl

    with mpl.rc_context(RC):
        both = [_sensor(result, s) for s in result.recording.sensors]
        each = [_one(c) for c in sorted(result.channels, key=lambda c: c.name[-1])]
    return {"sensors": both, "channels": each}


def _sensor(result: Allan, sensor: str) -> Plot:
    figure, (ax,) = canvas(1, 4.4)
    mine = [c for c in result.channels if c.sensor == sensor]
    unit = shown(READING[sensor], [v for c in mine for v in c.deviation.tolist()])
    for c, colour in zip(mine, XYZ, strict=True):
        ax.fill_between(c.tau, unit.factor * c.low, unit.factor * c.high, color=colour, alpha=0.16,
                        lw=0)  # fmt: skip
        ax.plot(c.tau, unit.factor * c.deviation, color=colour, label=c.name[-1])
    _scales(ax, unit.unit, [unit.factor * c.deviation for c in mine])
    legend(ax)
    caption = "Overlapping Allan deviation with its 95\u202f% band."
    return Plot(SENSORS[sensor], caption, svg(figure, f"allan-{sensor}"))


def _one(c: Channel) -> Plot:
    figure, (ax,) = canvas(1, 4.0)
    unit = shown(READING[c.sensor], c.deviation.tolist())
    colour = MUTED
    ax.fill_between(c.tau, unit.factor * c.low, unit.factor * c.high, color=colour, alpha=0.2, lw=0)
    points: dict[str, Any] = {"linestyle": "none", "markersize": 5, "markeredgewidth": 0}
    ax.plot(c.tau, unit.factor * c.deviation, ".", color=colour, label="measured", **points)
    ax.plot(c.tau, unit.factor * c.fitted, color=INK, label="fitted")
    for t in c.terms:
        factor, power = LAWS[t.name]
        curve = t.value * (factor * c.tau**power) ** 0.5
        ax.plot(c.tau, unit.factor * curve, color=COLOURS[t.name], lw=1.0, linestyle=(0, (4, 2)),
                label=t.name)  # fmt: skip
    _scales(ax, unit.unit, [unit.factor * c.deviation])
    legend(ax, 7)
    found = ", ".join(f"{t.name} {shown(t.unit, [t.value]).value(t.value)} "
                      f"{shown(t.unit, [t.value]).unit}" for t in c.terms)  # fmt: skip
    caption = f"{found or 'No term seen'}."
    if c.fit_from_s > 1.5 * c.tau[0]:
        caption += f" Fitted from {c.fit_from_s:.2g} s on."
    return Plot(_title(c), caption, svg(figure, f"allan-{c.name}"))


def _scales(ax: Axes, unit: str, shown: list[Array]) -> None:
    """Logarithmic both ways, around what was measured, with plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = min(float(s.min()) for s in shown), max(float(s.max()) for s in shown)
    ax.set(xscale="log", yscale="log", ylabel=unit, xlabel="averaging time, s",
           ylim=(low / 2, high * 1.5))  # fmt: skip
    plain = FuncFormatter(lambda v, _: f"{v:g}")
    ax.xaxis.set_major_formatter(plain)
    ax.yaxis.set_major_formatter(plain)
    if high / low < 30:
        ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_minor_formatter(NullFormatter())


def _title(c: Channel) -> str:
    return f"{SENSORS[c.sensor]} {c.name[-1]}"


def used(result: Allan) -> str:
    """Which stretch of the recording, and how often it was read."""
    start, end = result.span
    return f"{start:.1f} to {end:.1f} s of the recording, {result.rate_hz:.0f} Hz"


def _percent(part: float) -> str:
    return f"{100 * part:.2g}\u202f%"


def _time(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.3g} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def _warnings(result: Allan) -> list[str]:
    return list(dict.fromkeys((*result.recording.warnings, *result.warnings)))
