"""Draws the figures of docs/explain.md from simulations; `make docs` runs it. Two minutes."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import combinations
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from make_figures import GREY, IMAGES, INK, STYLE, XYZ, recorded, save

import handcal
from handcal import linear
from handcal.effects import catalogue, select
from handcal.explain import explain, fit
from handcal.explain.case import case_of
from handcal.explain.fit import Model, fitted, scan, started
from handcal.explain.search import Space, gains, space
from handcal.explain_report import write_explanation_report
from handcal.types import Recording
from handcal_sim import simulate, write
from handcal_sim.demo import concealing
from handcal_sim.strangers import estrange

PAGE = (1000, 1180)  # of the picture of a report


@contextmanager
def replaced(module: Any, name: str, value: Any) -> Iterator[None]:
    """Another value for a name in a module, for a while."""
    kept = getattr(module, name)
    setattr(module, name, value)
    try:
        yield
    finally:
        setattr(module, name, kept)


def read(world: Any) -> Recording:
    """A world as the reader sees it, without its truth."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.mcap"
        write(world, path, truth=False)
        return handcal.load(path)


def baseline(recording: Recording) -> Model:
    """Biases and noise alone."""
    return fitted([started(case_of(recording))], ())


def scanned(model: Model, ids: Sequence[str]) -> Space:
    """All subsets of these effects about a fit."""
    effects = select(ids)
    return space(scan(model, effects), effects, {})


def subsets() -> None:
    """One pass against a fit of each subset of its own, at the same noise."""
    ids = ("gyro_scale", "lever_arm", "accel_scale", "gyro_misalignment", "accel_delay")
    hidden = {"gyro_scale": [0.002, -0.0015, 0.0025], "lever_arm": [0.02, -0.01, 0.015]}
    base = baseline(read(simulate("free-hand", seed=4, duration_s=60.0, effects=hidden)))
    where = scanned(base, ids)
    empty = where.score(())
    once, each, right = [], [], []
    for size in (1, 2):
        for chosen in combinations(ids, size):
            prior = sum(where.prior[i] for i in chosen)
            once.append(where.score(chosen) - empty - prior)
            full = fitted(base.parts, select(chosen), noise_rounds=0)
            each.append(full.log_evidence - base.log_evidence)
            right.append(len(set(chosen) & set(hidden)))
            print(f"subsets: {'+'.join(chosen)}: {once[-1]:.1f} in one pass, {each[-1]:.1f}")
    figure, ax = plt.subplots(figsize=(5.2, 3.6), layout="constrained")
    names = ("neither of the two that are there", "one of them", "both")
    for n, name in enumerate(names):
        k = [i for i, r in enumerate(right) if r == n]
        ax.plot([each[i] for i in k], [once[i] for i in k], "o", ms=5,
                color=(GREY, XYZ[0], XYZ[2])[n], label=name)  # fmt: skip
    ends = [min(each + once), max(each + once)]
    ax.plot(ends, ends, color=INK, lw=0.8, zorder=0)
    ax.set(xlabel="nats gained, fitted on its own", ylabel="nats gained, from one pass",
           title="Fifteen subsets of five effects")  # fmt: skip
    ax.legend(frameon=False, loc="lower right")
    save(figure, "explain-subsets")


def alibis() -> None:
    """What sway and sensor noise do if they are let."""
    ids = ("accel_scale", "accel_misalignment", "accel_asymmetry", "lever_arm")
    found: dict[str, list[list[float]]] = {"by the readings": [], "without sway": []}
    for seed in range(5):
        recording = recorded("free-hand", 30 + seed, duration_s=84.0)
        for name, force in (("by the readings", lambda *_: None),
                            ("without sway", linear._steady_force)):  # fmt: skip
            with replaced(linear, "_steady_force", force):
                gained = gains(scanned(baseline(recording), ids), frozenset())
            found[name].append([gained[i] for i in ids])
    noisy = read(concealing(1))
    free: dict[str, tuple[float, float]] = {}
    for name, excess in (("free", 1e6), (f"at most {fit.EXCESS:g} times", fit.EXCESS)):
        with replaced(fit, "EXCESS", excess):
            base = baseline(noisy)
            with_scale = fitted(base.parts, select(["gyro_scale"]))
            level = np.degrees(base.parts[0].levels["gyro_noise"])
            free[name] = (base.log_evidence, with_scale.log_evidence)
            at_base = gains(scanned(base, ["gyro_scale"]), frozenset())["gyro_scale"]
        print(f"alibis: noise {name}: {level:.4f} deg/s/sqrt(Hz), scale gains {at_base:.0f} at the "
              f"baseline's noise, {with_scale.log_evidence - base.log_evidence:.0f} in the end")  # fmt: skip
        free[name] = (at_base, with_scale.log_evidence - base.log_evidence)
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained", width_ratios=(3, 2))
    for n, (name, rows) in enumerate(found.items()):
        y = np.arange(len(ids)) + 0.3 * (n - 0.5)
        for row in rows:
            axes[0].plot(row, y, "o", ms=4, color=(XYZ[0], XYZ[2])[n], alpha=0.8,
                         label=f"excited {name}" if row is rows[0] else None)  # fmt: skip
        print("alibis:", name, np.round(np.mean(rows, axis=0), 1))
    axes[0].axvline(0, color=INK, lw=0.8)
    axes[0].set_yticks(range(len(ids)), [catalogue()[i].title for i in ids])
    axes[0].invert_yaxis()
    axes[0].set(xlabel="nats gained where nothing is missing",
                title="A sway that excites effects")  # fmt: skip
    axes[0].legend(frameon=False, loc="lower left", fontsize=8)
    for n, (name, pair) in enumerate(free.items()):
        axes[1].bar(np.arange(2) + 0.38 * (n - 0.5), pair, 0.34, color=(XYZ[0], XYZ[2])[n],
                    label=f"gyro noise {name}")  # fmt: skip
    axes[1].set_xticks(range(2), ["at first sight", "fitted again"])
    axes[1].set(ylabel="nats gained by the gyro scale", title="A gyro noise without bounds")
    axes[1].legend(frameon=False, loc="upper left", fontsize=8)
    save(figure, "explain-alibis")


def alike() -> None:
    """Two effects in each other's place, in two motions."""
    pair = ("accel_delay", "gyro_bandwidth")
    figure, axes = plt.subplots(1, 2, figsize=(9, 2.2), layout="constrained", sharey=True)
    for ax, (scenario, title) in zip(axes, (("three-turns", "Three slow turns, 30 s"),
                                            ("free-hand", "Turned at will, 60 s")), strict=True):  # fmt: skip
        seconds = 30.0 if scenario == "three-turns" else 60.0
        hidden = {"accel_delay": [-0.004]}
        base = baseline(read(simulate(scenario, seed=3, duration_s=seconds, effects=hidden)))
        model = fitted(base.parts, select(pair[:1]))
        scores = [fitted(model.parts, select([i]), noise_rounds=0).log_evidence for i in pair]
        values = [s - base.log_evidence for s in scores]
        print("alike:", scenario, np.round(values, 1))
        ax.barh(range(2), values, 0.55, color=(XYZ[2], GREY))
        for row, v in enumerate(values):
            ax.text(v, row, f" {v:.0f}", va="center")
        ax.set_yticks(range(2), [catalogue()[i].title for i in pair])
        ax.invert_yaxis()
        ax.set(title=title, xlabel="nats over the baseline", xlim=(0, 1.15 * max(values)))
    save(figure, "explain-alike")


def unnamed() -> None:
    """Physics outside the catalogue: what the named effects gain, and the term that was found."""
    world, strange = estrange(
        "accel_rate", simulate("free-hand", seed=8, duration_s=84.0), np.random.default_rng(5)
    )
    e = explain([read(world)])
    print("unnamed:", strange.formula, e.verdict, [u.formula for u in e.unnamed])
    best = sorted(e.hypotheses, key=lambda h: -h.alone)[:5]
    rows = [(h.title, h.alone, GREY) for h in best]
    rows += [(u.formula, u.log_evidence_gain, XYZ[2]) for u in e.unnamed]
    figure, ax = plt.subplots(figsize=(7.5, 0.9 + 0.32 * len(rows)), layout="constrained")
    for row, (_, nats, colour) in enumerate(rows):
        ax.barh(row, nats, 0.6, color=colour)
        ax.text(max(nats, 0), row, f" {nats:,.0f}", va="center")
    ax.set_yticks(range(len(rows)), [name for name, _, _ in rows])
    ax.invert_yaxis()
    ax.set_xscale("symlog", linthresh=10)
    ax.set(xlabel="nats", xlim=(-10, 4 * max(nats for _, nats, _ in rows)))
    ax.set_title("The best five of the catalogue alone, and what was found instead")
    save(figure, "explain-unnamed")


def page() -> None:
    """The top of the report on the demo, as a browser shows it; skipped where there is none."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        print("page: no browser here, the picture stays as it is")
        return
    from PIL import Image
    from playwright.sync_api import sync_playwright

    recording = read(concealing(1))
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as p:
        file, shot = Path(folder) / "explanation.html", Path(folder) / "page.png"
        write_explanation_report(explain([recording], assume="fixed-point"), file)
        started_ = p.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        size = dict(zip(("width", "height"), PAGE, strict=True))
        tab = started_.new_context(offline=True, viewport=size).new_page()
        tab.goto(file.as_uri())
        tab.screenshot(path=shot)
        started_.close()
        picture = Image.open(shot).convert("RGB").quantize(64, dither=Image.Dither.NONE)
        picture.save(IMAGES / "explain.png", optimize=True)


if __name__ == "__main__":
    IMAGES.mkdir(exist_ok=True)
    plt.rcParams.update(STYLE)
    for draw in (subsets, alibis, alike, unnamed, page):
        draw()
