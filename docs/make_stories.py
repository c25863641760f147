# ruff: noqa: E501 - paragraphs of Markdown
"""Writes docs/stories.md and its pictures: three recordings explained by the commands that it shows.
`make stories` runs it; ten minutes. Two of the stories need recordings of real devices beside the
checkout and stay as they are without."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from make_figures import GREY, STYLE, XYZ, save

HERE = Path(__file__).resolve().parent
DEVICES = HERE.parents[1] / "shared" / "recordings" / "devices"
HANDCAL = Path(sys.executable).with_name("handcal")
PAGE = HERE / "stories.md"
Law = Callable[[np.ndarray], np.ndarray]


def run(folder: Path, *commands: str) -> str:
    """Run these commands there; the same as a block of Markdown."""
    for command in commands:
        words = shlex.split(command)
        assert words[0] == "handcal"
        print(command, flush=True)
        subprocess.run([HANDCAL, *words[1:]], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    return "\n".join(("```", *commands, "```"))


def read(folder: Path, name: str) -> dict[str, Any]:
    """A result."""
    document: dict[str, Any] = json.loads((folder / name).read_text(encoding="utf-8"))
    return document


def told(document: dict[str, Any]) -> str:
    """Verdict, names and laws, in a line of Markdown."""
    named = [f"`{m['effect']}` ({m['log_evidence_gain']:,.0f} nats)" for m in document["missing"]]
    laws = [f"`{u['formula']}` ({u['log_evidence_gain']:,.0f} nats)" for u in document["unnamed"]]
    found = "; ".join((*named, *laws)) or "nothing"
    return f"The verdict is `{document['verdict']}`: {found}."


def left(document: dict[str, Any], law: Law, channel: str) -> float:
    """Share of a law that what was found leaves, root mean square over its curve less its mean and
    slope, which a bias and a scale error may hold."""
    u = next(u for u in document["unnamed"] if channel in u["channels"])
    x, y = (np.array(u["curve"][k]) for k in "xy")
    A = np.stack([np.ones_like(x), x], axis=1)

    def bent(v: np.ndarray) -> np.ndarray:
        return v - A @ np.linalg.lstsq(A, v, rcond=None)[0]

    return float(np.std(bent(y - law(x))) / np.std(bent(law(x))))


def drawn(name: str, document: dict[str, Any], law: Law, channel: str) -> None:
    """The curve that was found, with its band, over the law that was there."""
    u = next(u for u in document["unnamed"] if channel in u["channels"])
    x, y, sigma = (np.array(u["curve"][k]) for k in ("x", "y", "sigma"))
    unit = {"rad/s": (np.degrees(1.0), "deg/s")}
    (a, x_unit), (b, y_unit) = (
        unit.get(u["curve"][k], (1.0, u["curve"][k])) for k in ("x_unit", "y_unit")
    )
    truth = law(x)
    truth = truth + np.mean(y - truth)  # (a constant is the bias's)
    figure, axis = plt.subplots(figsize=(6.4, 3.0), layout="constrained")
    axis.fill_between(
        a * x, b * (y - 2 * sigma), b * (y + 2 * sigma), color=XYZ[0], alpha=0.2, lw=0
    )
    axis.plot(a * x, b * y, color=XYZ[0], label="found, ± 2 sigma")
    axis.plot(a * x, b * truth, "--", color=GREY, label="concealed")
    axis.set(xlabel=f"{', '.join(u['drivers'])}, {x_unit}", ylabel=f"{channel}, {y_unit}")
    axis.legend(frameon=False)
    save(figure, name)


def invented(folder: Path) -> str:
    """A law in a simulated phone: found, written out, read in, found again."""
    laws = shlex.quote(str(HERE / "laws"))
    made = run(
        folder,
        "handcal simulate free-hand -o one.mcap --seed 1 --effect lever_arm=0.03,-0.02,0.01",
        "handcal simulate free-hand -o two.mcap --seed 2 --effect lever_arm=0.03,-0.02,0.01",
        f"handcal conceal one.mcap --effect gyro_rectifies=0.012 --effects-from {laws} -o first.mcap",
        f"handcal conceal two.mcap --effect gyro_rectifies=0.012 --effects-from {laws} -o second.mcap",
    )
    (folder / "own").mkdir()
    found = run(folder, "handcal explain first.mcap --json first.json --write-effect own/found.py")
    again = run(folder, "handcal explain second.mcap --effects-from own --json second.json")
    first, second = read(folder, "first.json"), read(folder, "second.json")
    law = lambda x: 0.012 * np.abs(x)  # noqa: E731
    drawn("story-invented", first, law, "gyro_z")
    share = left(first, law, "gyro_z")
    own = [p for p in second["parameters"] if p["effect"].startswith("found")]
    sizes = ", ".join(f"{p['name']} = {p['value']:.4g} ± {p['sigma']:.1g}" for p in own)
    return f"""## An invented law in a simulated phone

[`laws/gyro_rectifies.py`](laws/gyro_rectifies.py) is no effect of the catalogue: gyro z reads 0.012 |omega_x| too much. It is put into two recordings of a simulated phone whose accelerometer sits beside the point that is held.

{made}

{found}

{told(first)} Of the law that was concealed, beyond what a bias and a straight line hold, {100 * share:.1f} % is left.

![The law that was found over the one that was concealed](images/story-invented.png)

The next recording of the device has the law in its catalogue:

{again}

{told(second)} Its size there: {sizes}.
"""


def real(folder: Path) -> str:
    """A law concealed in a recording of a real device."""
    source = DEVICES / "euroc_v203.mcap"
    laws = shlex.quote(str(HERE / "laws"))
    (folder / "drone.mcap").write_bytes(source.read_bytes())
    plain = run(folder, "handcal explain drone.mcap --json plain.json")
    made = run(
        folder,
        f"handcal conceal drone.mcap --from plain.json --effect gyro_rectifies=0.02"
        f" --effects-from {laws} -o first.mcap",
        "handcal explain first.mcap --json first.json",
    )
    named = run(folder, f"handcal explain first.mcap --effects-from {laws} --json named.json")
    before, after, last = (read(folder, f"{k}.json") for k in ("plain", "first", "named"))
    assert after["verdict"] == "unexplained", "the story is another by now"
    (law,) = after["unnamed"]
    assert law["formula"] == "gyro_z += k * abs(omega_x)", "the story is another by now"
    found = f"k = {law['value']:.4f} ± {law['sigma']:.4f}"
    size = [p for p in last["parameters"] if p["effect"] == "gyro_rectifies"]
    sizes = ", ".join(f"{p['value']:.4f} ± {p['sigma']:.4f}" for p in size)
    return f"""## A law concealed in a real recording

A drone flies for a minute in a room with motion capture (EuRoC, V2_03). As it is:

{plain}

{told(before)}

Now its gyro has the same law, 0.02 |omega_x| on z, which is added to the readings as they were, noise, vibration and all:

{made}

{told(after)} That is the law that was put in, on its channel, written out: {found}, where 0.02 was concealed. The tracker's delay is worth a hundred times as many nats and more, but adds nothing to a gyro; so it does not hide it. With the law in the catalogue, `explain` gives its name and its size. What else it may name beside it, at some tens of nats, was not concealed:

{named}

{told(last)} Its size: {sizes}.
"""


def phone(folder: Path) -> str:
    """Two recordings of one phone: what repeats, and what does not."""
    both = []
    for k in (1, 3):
        (folder / f"{k}.mcap").write_bytes((DEVICES / f"phone_oscillations{k}.mcap").read_bytes())
    commands = run(folder, *(f"handcal explain {k}.mcap --json {k}.json" for k in (1, 3)))
    both = [read(folder, f"{k}.json") for k in (1, 3)]
    apart_by = {}
    rows = ["| | one recording | another | apart by |", "|---|---|---|---|"]
    known = [{(p["effect"], p["name"]): p for p in d["parameters"]} for d in both]
    for key in known[0]:
        if key in known[1] and key[0] not in ("gyro_bias", "accel_bias"):
            a, b = (k[key] for k in known)
            apart = abs(a["value"] - b["value"]) / np.hypot(a["sigma"], b["sigma"])
            apart_by[f"`{key[0]}` {key[1]}"] = apart
            rows.append(
                f"| `{key[0]}` {key[1]}, {a['unit']} | {a['value']:.3g} ± {a['sigma']:.1g} | "
                f"{b['value']:.3g} ± {b['sigma']:.1g} | {apart:.1f} sigma |"
            )
    once = [
        m["effect"] for d, o in zip(both, both[::-1], strict=True) for m in d["missing"]
        if m["effect"] not in {x["effect"] for x in o["missing"]}
    ]  # fmt: skip
    alone = listed([f"`{e}`" for e in once])
    same = listed([k for k, v in apart_by.items() if v < 3.0])
    other = listed([k for k, v in apart_by.items() if v >= 3.0])
    return f"""## A real phone, twice

One phone was swung by hand, twice, its magnetometer raw. Its errors are not known. But the phone's own errors have to come out alike both times.

{commands}

{told(both[0])}

{told(both[1])}

{chr(10).join(rows)}

Found in one of the two alone: {alone or "nothing"}. Within three sigma of each other: {same or "nothing"}. Further apart: {other or "nothing"}; the arm is the hand's and may have been another, but what belongs to the phone and comes out as two different numbers is surer of itself than it should be, or stands in for something that has no name. Nothing of that is claimed for the phone: two recordings of one device tell more than the sigma of either.
"""


def listed(words: Sequence[str]) -> str:
    return ", ".join(words)


def parts() -> dict[str, str]:
    """The page's stories as they are, by title."""
    text = PAGE.read_text(encoding="utf-8") if PAGE.exists() else ""
    found = re.split(r"(?m)^(?=## )", text)[1:]
    return {part.partition("\n")[0]: part for part in found}


def main() -> None:
    plt.rcParams.update(STYLE)
    stories = list(parts().values())
    tellers = (invented, real, phone) if DEVICES.exists() else (invented,)
    new = []
    for teller in tellers:
        with tempfile.TemporaryDirectory() as folder:
            new.append(teller(Path(folder)))
    stories = new + stories[len(new) :]
    head = """# Three stories

*Explanation.* Three recordings in which `explain` meets something outside the catalogue. All numbers and pictures come from the commands shown (`make stories`).

"""
    text = head + "\n".join(part.rstrip() + "\n" for part in stories)
    PAGE.write_text(text.replace(str(HERE), "docs"), encoding="utf-8")


if __name__ == "__main__":
    main()
