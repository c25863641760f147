"""Writes docs/effects.md, the catalogue, from src/handcal/effects/; `make docs` runs it."""

# ruff: noqa: E501 (a paragraph of the page is a line)

from __future__ import annotations

from itertools import groupby
from pathlib import Path

from handcal.effects import PLACE, Effect, Param, catalogue
from handcal.recordings.streams import STREAMS
from handcal.units import shown

FILE = Path(__file__).with_name("effects.md")
GROUPS = (
    ("Gyro", ("gyro_",)),
    ("Accelerometer", ("accel_",)),
    ("Heading and magnetometer", ("heading_", "mag_")),
    ("Place, world and clocks", ("",)),
)
INTRODUCTION = """# The catalogue of effects

What a sensor may read besides the truth. `handcal explain` tries all of these, as far as the recording has the streams for them; `handcal calibrate --effects gyro_scale,lever_arm` estimates those that are named; `handcal simulate` and `handcal conceal` put them in: `--effect gyro_scale=0.008,-0.006,0.01`, values in SI units and in the order given here.

Errors add to the reading: a scale error of +0.01 reads 1 % too much. In `xy` the first letter is the axis that reads, the second whose rate, force or place it is; `x_yz` is what x reads of the product of y and z. *Usual* is one standard deviation of what is assumed of a consumer's device.

Constant biases of gyro and accelerometer, white noise of unknown size and a hand that sways are in every model; the biases are listed because they can be concealed and taken off like any other error.

This page is written by `make docs` from the files in `src/handcal/effects/`: one file, one effect.
"""


def page() -> str:
    """The whole page as Markdown."""
    left = dict(catalogue())
    parts = [INTRODUCTION]
    for title, prefixes in GROUPS:
        mine = [left.pop(i) for i in list(left) if i.startswith(prefixes)]
        parts.append(f"## {title}\n")
        parts += [entry(e) for e in mine]
    return "\n".join(parts)


def entry(effect: Effect) -> str:
    """Heading, story and facts of one effect."""
    names = ",".join(p.name for p in effect.parameters)
    lines = [
        f"### {effect.title}",
        "",
        f"`{effect.id}={names}`",
        "",
        effect.story,
        "",
        f"- Usual: {'; '.join(_usual(effect))}",
        f"- What shows it: {effect.motion}",
    ]
    needs = [f"a stream `{n}`" for n in effect.needs if n in STREAMS]
    needs += ["a held point or a stream `pose`"] * (PLACE in effect.needs)
    if needs:
        lines.append(f"- Needs: {', and '.join(needs)}")
    lines += [f"- Source: {effect.source}", f"- Tried on: {effect.validated}", ""]
    return "\n".join(lines)


def _kind(p: Param) -> tuple[str, float]:
    return p.unit, p.prior_sigma


def _usual(effect: Effect) -> list[str]:
    """ "each 0.01 rad (0.573 deg)", one for all that are alike."""
    said = []
    for (si_unit, sigma), group in groupby(effect.parameters, _kind):
        names = [p.name for p in group]
        if effect.moments is not None and si_unit == "s":
            said.append(f"{names[0]} any moment, in s after the first sample")
            continue
        unit = shown(si_unit, [sigma])
        friendly = f"{unit.value(sigma)} {unit.unit}"
        si = friendly if si_unit == "1e-6" else f"{sigma:g}" + f" {si_unit}" * (si_unit != "1")
        more = "" if friendly == si else f" ({friendly})"
        said.append(f"{'each' if len(names) > 1 else names[0]} {si}{more}")
    return said


if __name__ == "__main__":
    FILE.write_text(page(), encoding="utf-8")
