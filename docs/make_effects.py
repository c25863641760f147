"""Writes docs/effects.md, the catalogue, from src/handcal/effects/; `make docs` runs it."""

# ruff: noqa: E501 (a paragraph of the page is a line)

from __future__ import annotations

from pathlib import Path

from handcal.effects import Effect, catalogue
from handcal.show.catalogue import grouped, needs, usual

FILE = Path(__file__).with_name("effects.md")
INTRODUCTION = """# The catalogue of effects

*Reference.* The errors that handcal knows, sensor by sensor. `handcal explain` tries all of these, as far as the recording has the streams for them; `handcal calibrate` estimates the common ones, and with `--effects gyro_quadratic,gravity` those that are named; `handcal simulate` and `handcal conceal` put them in: `--effect gyro_scale=0.008,-0.006,0.01`, values in SI units and in the order given here.

Errors add to the reading: a scale error of +0.01 reads 1 % too much. In `xy` the first letter is the axis that reads, the second whose rate, force or place it is; `x_yz` is what x reads of the product of y and z. *Usual* is one standard deviation of what is assumed of a consumer's device, the scale of a density with wide tails. *Common* is what every device has: every fit of a recording that could show it estimates it, and `explain` names it where the evidence asks for it. *Rare* effects are tried beside those.

Constant biases of gyro and accelerometer, white noise of unknown size and a hand that sways are in every model; the biases are listed because they can be concealed and taken off like any other error.

This page is written by `make docs` from the files in `src/handcal/effects/`: one file, one effect.
"""


def page() -> str:
    """The whole page as Markdown."""
    parts = [INTRODUCTION]
    for title, mine in grouped(catalogue()):
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
        f"- Usual: {'; '.join(usual(effect))}",
        f"- Common: {effect.common}" if effect.common else "- Rare",
        f"- What shows it: {effect.motion}",
    ]
    if needs(effect):
        lines.append(f"- Needs: {', and '.join(needs(effect))}")
    lines += [f"- Source: {effect.source}", f"- Tried on: {effect.validated}", ""]
    return "\n".join(lines)


if __name__ == "__main__":
    FILE.write_text(page(), encoding="utf-8")
