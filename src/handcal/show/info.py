"""What a recording holds, as a page, as JSON and in the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import handcal
from handcal import output
from handcal.design.seen import Seen
from handcal.recordings.overview import Overview, Stamps
from handcal.recordings.streams import STREAMS
from handcal.show import words
from handcal.show.drawing import AXES, MISS, RC, XYZ, Plot, canvas, envelope, legend, shade, svg
from handcal.show.html_page import page
from handcal.show.terminal import print_section, table
from handcal.units import DEG, shown

if TYPE_CHECKING:
    from rich.console import Console

SCHEMA = "handcal/info/1"
STRIP, BARS = 60, "▁▂▃▄▅▆▇█"
CHANNELS = tuple(f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in AXES)
# The gyro's unit is told where gravity turns as it says, better by this than without any turn.
TOLD = 0.6


@dataclass(frozen=True)
class Info:
    """A recording looked at: by which format it was read (half a sentence) and what that says of
    units and signs, its numbers, and what it can show; rests_show: what few rests alone show."""

    read_as: str
    units: str
    overview: Overview
    seen: tuple[Seen, ...]
    rests_show: str = ""


def info_json(info: Info) -> dict[str, Any]:
    """``info --json``."""
    o = info.overview
    return {
        "schema": SCHEMA, "version": handcal.__version__,
        "recording": {"path": o.recording.path, "duration_s": o.recording.duration_s,
                      "start_ns": o.recording.start_ns, "format": info.read_as},
        "units": {"stated": info.units, "evidence": unit_sentences(o),
                  "gravity_read": o.gravity, "turning_error_rad": list(o.turning)},
        "streams": [
            {"stream": s.stream, **({"topic": s.topic} if s.topic else {}),
             "columns": list(STREAMS[s.stream].columns), "unit": STREAMS[s.stream].unit,
             "readings": s.readings, "rate_hz": s.rate_hz, "jitter_s": s.jitter_s,
             "first_s": s.first_s, "last_s": s.last_s,
             "gaps": {"count": s.gaps, "longest_s": s.longest_s, "at_s": s.at_s}}
            for s in o.streams
        ],
        "range": {"largest": dict(zip(CHANNELS, o.largest.tolist(), strict=True)),
                  "not_trusted": o.saturated},
        "rests": [{"from_s": r.start, "to_s": r.end, "still": r.still, "force": r.force.tolist(),
                   "gyro_noise": r.gyro_noise, "accel_noise": r.accel_noise} for r in o.rests],
        "rests_show": info.rests_show,
        "turns": [{"axis": t.axis, "forward_rad": t.forward, "backward_rad": t.backward,
                   "fastest_rad_s": t.fastest} for t in o.turns],
        "could_teach": [
            {"effect": s.effect.id, "shown": list(s.shown),
             "parameters": [{"name": p.name, "sigma": p.sigma, "prior_sigma": p.prior_sigma,
                             "unit": p.unit, "observable": p.shown} for p in s.parameters],
             "motion": s.effect.motion}
            for s in info.seen
        ],
        "warnings": list(o.recording.warnings),
    }  # fmt: skip


def unit_sentences(o: Overview) -> list[str]:
    """Why the units are believed."""
    out = [f"The accelerometer reads {o.gravity:.2f} m/s² where stillest; gravity is 9.8."]
    if o.recording.unfit:
        return out
    if "mag" in o.recording.streams:
        out.append(
            "The magnetometer turns as the gyro says: its axes are right." if o.field_told else
            "The motion does not tell whether the magnetometer's axes are the IMU's."
        )  # fmt: skip
    if not o.turning or o.turning[0] > TOLD * o.turning[1]:
        out.append(
            "The motion does not tell whether the gyro's unit, full scale and axes are right: "
            "gravity turns too little, or the device is moved about too much."
        )
        return out
    right, still = (f"{math.degrees(e):.2g}°" for e in o.turning)
    seen = "unit, full scale and axes are right" if o.axes_told else (
        "unit and full scale are right; this motion does not tell all of its axes apart"
    )  # fmt: skip
    out.append(
        f"Where gravity turns most, by {still}, the gyro carries the direction up to within "
        f"{right} of where the accelerometer finds it: its {seen}."
    )
    return out


def _rest_sentences(info: Info) -> list[str]:
    return [rest_sentence(info.overview), *([info.rests_show] if info.rests_show else [])]


def rest_sentence(o: Overview) -> str:
    """How many rests, how long, how many attitudes."""
    if not o.rests:
        return (
            "No rest was found: lay the device down for ten seconds, at the beginning and the end."
        )
    total = sum(r.seconds for r in o.rests)
    still = sum(r.still for r in o.rests)
    ways = len({tuple(np.round(r.force / np.linalg.norm(r.force)).tolist()) for r in o.rests})
    return (
        f"{_count(len(o.rests), 'rest')}, {total:.1f} s together, {still} of them still as on "
        f"a table, in {_count(ways, 'attitude')}."
    )


def teach_sentences(info: Info) -> list[str]:
    """What is not shown, with the motion that would show it."""
    out = []
    for s in info.seen:
        blind = [p.name for p in s.parameters if not p.shown]
        if blind:
            which = "" if len(blind) == len(s.parameters) else f" {', '.join(blind)}"
            out.append(
                f"{words.effect_title(s.effect.id)}{which}: not shown by these rests and "
                f"turns. What shows it: {words.effect_motion(s.effect.id)}."
            )
    return out  # fmt: skip


def print_info(info: Info, console: Console) -> None:
    """Streams, motion, units, and which errors it can show."""
    from rich.markup import escape

    o = info.overview
    name = escape(Path(o.recording.path).name)
    console.print(f"[bold]{name}[/]  {_time(o.recording.duration_s)}, {escape(info.read_as)}",
                  highlight=False)  # fmt: skip
    console.print(_stream_table(o))
    console.print(f"  [cyan]{strip(o)}[/]  rate of turning", highlight=False)
    console.print(_turn_table(o))
    console.print(_seen_table(info))
    sections = (
        ("Rests", _rest_sentences(info)),
        ("Units", [f"In the file: {info.units}.", *unit_sentences(o)]),
        ("Not shown", teach_sentences(info)),
        ("Warnings", list(o.recording.warnings)),
    )
    for heading, sentences in sections:
        print_section(console, heading, sentences)


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]], wraps: str = "") -> Any:
    """wraps: the column that may take more than a line, so that no other one is cut."""
    from rich.markup import escape

    out = table(columns[0], *(f">{'*' if c == wraps else ''}{c}" for c in columns[1:]))
    for row in rows:
        out.add_row(*map(escape, row))
    return out


# What a stamp can tell, s; jitter below it is rounding.
STAMP_S = 1e-9
STREAM_COLUMNS = ("stream", "topic", "readings", "rate", "jitter", "gaps", "longest gap")
TURN_COLUMNS = ("turned about", "forward", "back", "fastest", "largest force")
SEEN_COLUMNS = ("error it can show", "shown", "sigma", "usual")


def _stream_table(o: Overview) -> Any:
    return _table(STREAM_COLUMNS, [stream_row(s) for s in o.streams], wraps="topic")


def _turn_table(o: Overview) -> Any:
    return _table(TURN_COLUMNS, turn_rows(o))


def _seen_table(info: Info) -> Any:
    return _table(SEEN_COLUMNS, seen_rows(info))


def stream_row(s: Stamps) -> tuple[str, ...]:
    """One stream, for people."""
    jitter = shown("s", [s.jitter_s])
    longest = f"{s.longest_s:.3g} s at {s.at_s:.1f} s" if s.gaps else "–"
    return (
        STREAMS[s.stream].title,
        s.topic or "–",
        str(s.readings),
        f"{s.rate_hz:.4g} Hz",
        "none" if s.jitter_s < STAMP_S else f"{jitter.value(s.jitter_s)} {jitter.unit}",
        str(s.gaps or "–"),
        longest,
    )


def turn_rows(o: Overview) -> list[tuple[str, ...]]:
    """Turns and ranges by axis, for people."""
    return [
        (t.axis, f"{t.forward * DEG:.0f}°", f"{t.backward * DEG:.0f}°",
         f"{t.fastest * DEG:.0f}°/s", f"{force:.1f} m/s²")
        for t, force in zip(o.turns, o.largest[3:], strict=True)
    ]  # fmt: skip


def seen_rows(info: Info) -> list[tuple[str, ...]]:
    """What could be told, for people: the sigma of the best and the worst parameter."""
    rows: list[tuple[str, ...]] = []
    for s in info.seen:
        prior = s.parameters[0].prior_sigma
        unit = shown(s.parameters[0].unit, [prior])
        sigmas = sorted(p.sigma for p in s.parameters)
        span = "–".join(dict.fromkeys(f"{x * unit.factor:.2g}" for x in (sigmas[0], sigmas[-1])))
        names = ", ".join(s.shown) if len(s.shown) < len(s.parameters) else "all"
        rows.append((words.effect_title(s.effect.id), names or "none",
                     f"{span} {unit.unit}", f"{unit.value(prior)} {unit.unit}"))  # fmt: skip
    return rows


def strip(o: Overview) -> str:
    """The rate of turning over time, in bars."""
    imu = o.recording.imu
    rate = np.linalg.norm(imu.gyro, axis=1)
    part = np.minimum((imu.t / max(imu.t[-1], 1e-9) * STRIP).astype(int), STRIP - 1)
    level = np.array([rate[part == k].max(initial=0.0) for k in range(STRIP)])
    height = np.rint(np.sqrt(level / max(level.max(), 1e-9)) * (len(BARS) - 1)).astype(int)
    return "".join(BARS[h] for h in height)


def write_info_report(info: Info, path: str | Path) -> None:
    """Write the page as one HTML file; nothing in it needs a network."""
    o = info.overview
    tables: list[tuple[str, tuple[str, ...], list[tuple[str, ...]]]] = [
        ("Streams", STREAM_COLUMNS, [stream_row(s) for s in o.streams]),
        ("Turns", TURN_COLUMNS, turn_rows(o)),
        ("Which errors it can show", SEEN_COLUMNS, seen_rows(info)),
    ]
    context = {
        "name": Path(o.recording.path).name, "version": handcal.__version__,
        "sub": f"{info.read_as}; {info.units}.",
        "facts": [(_time(o.recording.duration_s), "long"),
                  (f"{o.recording.rate_hz:.4g} Hz", "readings of the IMU"),
                  (str(len(o.rests)), "rests"),
                  (str(sum(s.gaps for s in o.streams)), "gaps")],
        "warnings": list(o.recording.warnings), "plots": draw(o), "tables": tables,
        "sentences": [*_rest_sentences(info), *unit_sentences(o)], "blind": teach_sentences(info),
    }  # fmt: skip
    output.write_text(path, page("info.html.j2", context))


def draw(o: Overview) -> list[Plot]:
    """The readings over time, with rests and gaps; and the steps between stamps."""
    import matplotlib as mpl

    with mpl.rc_context(RC):
        return [_readings(o), _steps(o)]


def _readings(o: Overview) -> Plot:
    imu = o.recording.imu
    figure, panels = canvas(2, 5.6)
    for ax, value, factor, label in ((panels[0], imu.gyro, DEG, "deg/s"),
                                     (panels[1], imu.accel, 1.0, "m/s²")):  # fmt: skip
        for axis, column, colour in zip(AXES, value.T, XYZ, strict=True):
            ax.plot(*envelope(imu.t, column * factor), color=colour, label=axis, lw=0.9)
        ax.set_ylabel(label)
    shade(panels, [(r.start, r.end) for r in o.rests])
    gaps = [(s.at_s, s.at_s + s.longest_s) for s in o.streams[:1] if s.gaps]
    shade(panels, gaps, MISS)
    legend(panels[0])
    return Plot("Readings", "Gyro and accelerometer; grey: rests, yellow: the longest gap.",
                svg(figure, "info-readings"))  # fmt: skip


def _steps(o: Overview) -> Plot:
    figure, (ax,) = canvas(1, 3.2)
    t = o.recording.imu.t
    ax.plot(*envelope(t[1:], 1e3 * np.diff(t)), color=XYZ[2], lw=0.9)
    ax.set_ylabel("ms")
    ax.set_ylim(bottom=0.0)
    return Plot("Steps between readings", "Of the IMU; a steady clock is a flat line.",
                svg(figure, "info-steps"))  # fmt: skip


def _count(n: int, word: str) -> str:
    return f"{n} {word}{'' if n == 1 else 's'}"


def _time(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 600 else f"{seconds / 60:.1f} min"
