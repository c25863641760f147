"""Draws the figures of docs/ from simulations; `make docs` runs it. One minute."""

from __future__ import annotations

import math
import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import handcal
from handcal.estimate import driven, linear, observed
from handcal.estimate.noise_levels import white_levels
from handcal.observations import catalogue
from handcal.show import words
from handcal.types import Recording, Result
from handcal_sim import simulate, write
from handcal_sim.phone import consumer_phone

IMAGES = Path(__file__).with_name("images")
XYZ = ("#c44e00", "#00875f", "#0067b3")
INK, GREY = "#1c2330", "#5b6472"
STYLE = {"axes.spines.top": False, "axes.spines.right": False, "font.size": 9,
         "axes.titlelocation": "left"}  # fmt: skip


def recorded(scenario: str, seed: int, heading: bool = True, duration_s: float | None = None):
    """A simulated recording as the reader sees it, without its truth."""

    def phone(rng):
        drawn = consumer_phone(rng)
        return drawn if heading else replace(drawn, heading=None)

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{scenario}.mcap"
        write(simulate(scenario, seed=seed, phone=phone, duration_s=duration_s), path)
        return handcal.load(path)


def save(figure: plt.Figure, name: str) -> None:
    """As a small PNG."""
    figure.savefig(IMAGES / f"{name}.png", dpi=110, metadata={"Software": None})
    plt.close(figure)


def whiteness() -> None:
    """Autocorrelation of position innovations: a hand's sway as white noise, and as a process."""
    recording = recorded("free-hand", 4, duration_s=40.0)
    # Both with the sensor noise that the readings show, or that would make up for the sway.
    # White: no correlated part, so that the observation's own noise has to carry it.
    sensors = white_levels(recording)
    still = sensors | {"sway": 1e-4, "sway_per_rate": 1e-4}
    as_process = handcal.calibrate(recording, assume="fixed-point", noise=sensors)
    as_white = handcal.calibrate(recording, assume="fixed-point", noise=still)
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
    for result, colour, name in (
        (as_white, XYZ[0], "white noise"), (as_process, XYZ[2], "correlated sway"),
    ):  # fmt: skip
        i = result.innovations["fixed_position"]
        z = i.residual / i.sigma
        z = z / np.sqrt((z**2).mean(0))
        lags = range(21)
        rho = [float(np.mean((z[k:] * z[: len(z) - k]).mean(0))) for k in lags]
        axes[0].plot(np.array(lags) / 10.0, rho, "o-", ms=3, color=colour, label=name)
        axes[1].plot(i.t, 100 * i.residual[:, 2], ".", ms=3, color=colour, label=name)
        gain = result.log_evidence
        print(f"whiteness: {name}: log evidence {gain:.0f}, lag one {rho[1]:+.2f}")
    limit = 2.0 / math.sqrt(len(z))
    axes[0].axhspan(-limit, limit, color="#e9edf2", zorder=0)
    axes[0].set(xlabel="lag, s", ylabel="autocorrelation", title="Innovations of the held point")
    axes[1].set(xlabel="time, s", ylabel="cm", title="The same over time, up")
    axes[0].legend(frameon=False)
    save(figure, "whiteness")


def motions() -> None:
    """What three motions leave unknown of each bias."""
    cases = (
        ("z turn, no heading", recorded("z-turn", 11, heading=False)),
        ("z turn, heading", recorded("z-turn", 11)),
        ("three turns, no heading", recorded("three-turns", 11, heading=False)),
        ("three turns, heading", recorded("three-turns", 11)),
    )
    figure, ax = plt.subplots(figsize=(9, 3.4), layout="constrained")
    for c, (name, recording) in enumerate(cases):
        result = handcal.calibrate(recording, assume="fixed-point")
        biases = result.parameters[:6]
        share = [p.sigma / p.prior_sigma for p in biases]
        x = np.arange(6) + 0.2 * (c - 1.5)
        ax.bar(x, share, 0.18, color=(*XYZ, GREY)[c], label=name)
        print("motions:", name, np.round(share, 4))
    ax.axhline(0.5, color=INK, lw=0.8, ls="--")
    ax.text(5.6, 0.55, "shown below", ha="right", va="bottom", color=INK, fontsize=8)
    ax.set(yscale="log", ylim=(3e-4, 2), ylabel="sigma / prior sigma")
    ax.set_xticks(range(6), [words.parameter_title(p) for p in biases], fontsize=8)
    ax.legend(frameon=False, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=8)
    save(figure, "motions")


def evidence_of_nothing() -> None:
    """Sigma of the vertical gyro bias in a z turn without heading, with noise turned or not."""
    recording = recorded("z-turn", 11, heading=False)
    honest = handcal.calibrate(recording, assume="fixed-point")
    levels = {n.name: n.value for n in honest.noise}
    figure, ax = plt.subplots(figsize=(9, 3.0), layout="constrained")
    for result, colour, name in (
        (naive(recording, levels), XYZ[0], "noise fixed in space"),
        (honest, XYZ[2], "noise turns with the attitude"),
    ):
        h = result.history
        ax.plot(h.t, np.degrees(h.parameter_sigma[:, 2]), color=colour, label=name)
        print("honesty:", name, math.degrees(h.parameter_sigma[-1, 2]))
    ax.set(xlabel="time, s", ylabel="deg/s", ylim=(0, 1.1), title="Sigma of gyro bias z")
    ax.legend(frameon=False)
    save(figure, "honesty")


def naive(recording: Recording, levels: dict[str, float]) -> Result:
    """The same calibration by an estimator that takes its trajectory's noise for a signal."""
    kept = linear.turn_noise, driven._markov_steps, observed.catalogue
    plain = {k: replace(o, isotropic=False) for k, o in catalogue().items()}

    def steps(problem, markov, Phi_e):
        d_e, Phi_psi = kept[1](problem, markov, Phi_e)
        return d_e, np.zeros_like(Phi_psi)

    linear.turn_noise, driven._markov_steps = (lambda *_: None), steps
    observed.catalogue = lambda: plain
    try:
        return handcal.calibrate(recording, assume="fixed-point", noise=levels)
    finally:
        linear.turn_noise, driven._markov_steps, observed.catalogue = kept


def demo() -> None:
    """The README's picture: what `handcal demo` estimates, over time, and the truth."""
    from handcal_sim.commands.demo import CONCEALED, concealing, truth_of

    world = concealing(1)
    with tempfile.TemporaryDirectory() as folder:
        write(world, Path(folder) / "x.mcap")
        result = handcal.calibrate(handcal.load(Path(folder) / "x.mcap"), [CONCEALED])
    truth, h = truth_of(world), result.history
    figure, axes = plt.subplots(1, 3, figsize=(10, 3.3), layout="constrained")
    for ax, group in zip(axes, words.by_effect(result.parameters).values(), strict=True):
        unit = words.shown_group(group)
        for p, colour in zip(group, XYZ, strict=True):
            c = result.parameters.index(p)
            value, sigma = (unit.factor * a[:, c] for a in (h.parameters, h.parameter_sigma))
            ax.fill_between(
                h.t, value - 3 * sigma, value + 3 * sigma, color=colour, alpha=0.15, lw=0
            )
            ax.plot(h.t, value, color=colour, label=p.name)
            true = unit.factor * truth[p.effect, p.name]
            ax.plot([h.t[-1] + 0.7], [true], "<", color=colour, clip_on=False, ms=7)
        wide = unit.factor * np.array([truth[p.effect, p.name] for p in group])
        room = 1.2 * (wide.max() - wide.min())
        ax.set(ylim=(wide.min() - room, wide.max() + room), xlim=(0, h.t[-1]), xlabel="time, s")
        ax.set_title(f"{words.effect_title(group[0].effect)}, {unit.unit}", loc="left")
        ax.grid(color="#d9dee5", lw=0.6)
    axes[0].legend(frameon=False, ncols=3, loc="lower right")
    save(figure, "demo")


if __name__ == "__main__":
    IMAGES.mkdir(exist_ok=True)
    plt.rcParams.update(STYLE)
    for draw in (demo, whiteness, motions, evidence_of_nothing):
        draw()
