"""Draws the figures of docs/explain.md from simulations; `make docs` runs it. Two minutes."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from make_figures import GREY, IMAGES, INK, STYLE, XYZ, save

import handcal
from handcal.effects import select
from handcal.estimate import fit
from handcal.estimate.baseline import started
from handcal.estimate.case import case_of
from handcal.estimate.fit import fitted
from handcal.estimate.model import Model
from handcal.estimate.scan import scan
from handcal.explain import explain
from handcal.search.space import Space, gains, space
from handcal.show.explanation.report import write_explanation_report
from handcal.types import Recording
from handcal_sim import simulate, write
from handcal_sim.commands.demo import concealing
from handcal_sim.strangers import estrange

WIDTH = 1000  # of the picture of a report


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
    return fitted([started(case_of(recording))], (), noise_rounds=2)


def scanned(model: Model, ids: Sequence[str]) -> Space:
    """All subsets of these effects about a fit."""
    effects = select(ids)
    return space(scan(model, effects), effects, {})


def subsets() -> None:
    """One pass against a fit of each subset of its own, at the same noise."""
    ids = ("gyro_scale", "lever_arm", "accel_scale", "gyro_misalignment", "accel_delay")
    hidden = {"gyro_scale": [0.002, -0.0015, 0.0025], "lever_arm": [0.02, -0.01, 0.015]}
    base = baseline(read(simulate("free-hand", seed=4, duration_s=60.0, effects=hidden)))
    effects = select(ids)
    q = scan(base, effects)
    whole = replace(q, b=q.b / q.worth, G=q.G / q.worth, worth=1.0)
    where = space(whole, effects, {})
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


def alibi() -> None:
    """What a gyro's noise hides if it is let: the demo's gyro misreads turns by a per cent."""
    recording = read(concealing(1))
    figure, ax = plt.subplots(figsize=(5.6, 2.6), layout="constrained")
    for n, (name, excess) in enumerate((("any level", 1e6), (f"{fit.EXCESS:g} times", fit.EXCESS))):
        with replaced(fit, "EXCESS", excess):
            base = baseline(recording)
            first = gains(scanned(base, ["gyro_scale"]), frozenset())["gyro_scale"]
            again = fitted(base.parts, select(["gyro_scale"])).log_evidence - base.log_evidence
        level = np.degrees(base.parts[0].levels["gyro_noise"])
        print(f"alibi: {name}: {level:.4f} deg/s/sqrt(Hz), gains {first:.0f}, then {again:.0f}")
        ax.barh(np.arange(2) + 0.36 * (n - 0.5), (first, again), 0.34, color=(XYZ[0], XYZ[2])[n],
                label=f"noise allowed: {name}{' what the readings show' if n else ''}")  # fmt: skip
        for row, v in enumerate((first, again)):
            ax.text(v, row + 0.36 * (n - 0.5), f" {v:.0f}", va="center")
    ax.set_yticks(range(2), ["at the baseline's noise", "fitted, noise too"])
    ax.invert_yaxis()
    ax.set(xlabel="nats gained by the gyro scale error that is there")
    ax.legend(frameon=False, loc="upper right", fontsize=8)
    save(figure, "explain-alibi")


def alike() -> None:
    """A scale error, and how far behind a quadratic error is in its place, in three motions."""
    motions = (
        ("z-turn", 30.0, "one turn about z"),
        ("three-turns", 30.0, "a turn about each axis"),
        ("free-hand", 60.0, "to and fro at will"),
    )
    behind = []
    for scenario, seconds, _ in motions:
        hidden = {"gyro_scale": [0.0, 0.0, 0.012]}
        base = baseline(read(simulate(scenario, seed=9, duration_s=seconds, effects=hidden)))
        model = fitted(base.parts, select(["gyro_scale"]))
        rival = fitted(model.parts, select(["gyro_quadratic"]), noise_rounds=0)
        behind.append(model.log_evidence - rival.log_evidence)
        print(f"alike: {scenario}: {behind[-1]:.1f}")
    figure, ax = plt.subplots(figsize=(6.5, 1.9), layout="constrained")
    ax.barh(range(3), behind, 0.55, color=[XYZ[2] if v > 3.0 else GREY for v in behind])
    for row, v in enumerate(behind):
        ax.text(max(v, 3.0), row, f" {v:,.1f}" if v < 10 else f" {v:,.0f}", va="center")
    ax.axvline(3.0, color=INK, lw=0.8, ls="--")
    ax.set_xscale("symlog", linthresh=10)
    ax.set_yticks(range(3), [name for _, _, name in motions])
    ax.invert_yaxis()
    ax.set(xlabel="nats by which the quadratic error fits worse (dashed: odds of 20 to 1)",
           xlim=(0, 5 * max(behind)))  # fmt: skip
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
        ax.text(
            max(nats, 0), row, f" {nats:,.0f}".replace("-0", "0").replace("-", "−"), va="center"
        )
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
        size = {"width": WIDTH, "height": 800}
        tab = started_.new_context(offline=True, viewport=size).new_page()
        tab.goto(file.as_uri())
        end = tab.evaluate("document.querySelector('figure').getBoundingClientRect().bottom") + 20
        tab.screenshot(path=shot, full_page=True,
                       clip={"x": 0, "y": 0, "width": WIDTH, "height": end})  # fmt: skip
        started_.close()
        picture = Image.open(shot).convert("RGB").quantize(256, dither=Image.Dither.NONE)
        picture.save(IMAGES / "explain.png", optimize=True)


if __name__ == "__main__":
    IMAGES.mkdir(exist_ok=True)
    plt.rcParams.update(STYLE)
    for draw in (subsets, alibi, alike, unnamed, page):
        draw()
