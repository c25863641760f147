"""Draws the figure of docs/how-far-to-trust.md: what three motions leave of each parameter. `make
docs` runs it. Half a minute."""

from __future__ import annotations

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from make_figures import GREY, INK, STYLE, XYZ, save

import handcal
from handcal.show import words
from handcal.types import Result
from handcal_sim import simulate, write
from handcal_sim.motion import Motion, Start, _turns

SECONDS = 36.0
# Axis of the body, from and to, s: a turn and its reverse would show no more here.
MOTIONS = {
    "yaw on a table": [(2, 4.0, 32.0)],
    "two axes": [(2, 2.0, 16.0), (0, 20.0, 34.0)],
    "three axes": [(2, 2.0, 11.0), (0, 14.0, 23.0), (1, 26.0, 34.0)],
}


def calibrated(name: str) -> Result:
    """What is learnt of one and the same phone by a motion, with a compass of 5 degrees."""

    def motion(duration: float, start: Start, _: np.random.Generator) -> Motion:
        return _turns(name, duration, start, MOTIONS[name])

    sway = 0.05 if "table" in name else 1.0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.mcap"
        write(simulate(motion, seed=3, duration_s=SECONDS, start=Start(), sway=sway), path)
        return handcal.calibrate(handcal.load(path), assume="fixed-point")


def main() -> None:
    """A row for each effect, in it a line for each motion, on it a dot for each parameter."""
    results = {name: calibrated(name) for name in MOTIONS}
    effects = list(dict.fromkeys(p.effect for r in results.values() for p in r.parameters))
    figure, ax = plt.subplots(figsize=(9, 0.42 * len(effects) + 1.4), layout="constrained")
    ax.axvspan(0.5, 10.0, color="#e9edf2", zorder=0)
    for n, (name, result) in enumerate(results.items()):
        for p in result.parameters:
            row = effects.index(p.effect) + 0.22 * (n - 1)
            ax.plot(p.sigma / p.prior_sigma, row, "o", ms=5, color=XYZ[n],
                    mfc=XYZ[n] if p.shown else "white", mew=1.0)  # fmt: skip
        ax.plot([], [], "o", ms=5, color=XYZ[n], label=name)
        shown = sum(p.shown for p in result.parameters)
        print(f"trust: {name}: {shown} of {len(result.parameters)} parameters are shown")
    for row in range(1, len(effects)):
        ax.axhline(row - 0.5, color="#d9dee5", lw=0.7)
    ax.plot([], [], "o", ms=5, color=GREY, mfc="white", label="not shown")
    ax.set(xscale="log", xlim=(2e-3, 2.0), ylim=(len(effects) - 0.5, -0.5),
           xlabel="posterior sigma / usual size")  # fmt: skip
    ax.set_xticks([0.01, 0.1, 0.5, 1.0], ["0.01", "0.1", "0.5", "1"])
    ax.minorticks_off()
    ax.set_yticks(range(len(effects)), [words.effect_title(e) for e in effects])
    ax.tick_params(axis="y", length=0, labelcolor=INK)
    ax.legend(frameon=False, ncols=4, loc="lower center", bbox_to_anchor=(0.45, 1.0))
    save(figure, "trust")


if __name__ == "__main__":
    with plt.rc_context(STYLE):
        main()
