# ruff: noqa: E501 - paragraphs of Markdown
"""Explains real recordings (docs/gallery/recordings.toml) and writes docs/gallery/; `make gallery`
runs it.

An hour or more. Each explanation is kept in gallery-out/ and not made again while it is there; the
page of a recording that is not there stays as it is, and one that has no page yet stands in the
overview as left out. `--only-pages` explains nothing.
"""

from __future__ import annotations

import argparse
import html
import json
import math
import os
import re
import resource
import subprocess
import sys
import tomllib
from functools import partial
from pathlib import Path
from typing import Any

from handcal.effects import known_effect
from handcal.show import words
from handcal.show.drawing import PALETTE
from handcal.show.explanation import words as say
from handcal.units import Shown, shown

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "gallery"
KEPT = ROOT / "gallery-out"
RECORDINGS = Path(os.environ.get("HANDCAL_RECORDINGS", ROOT.parent / "shared" / "recordings"))
SMALL = 45_000  # bytes of a picture
COLUMN = 600.0  # SVG units: a wider drawing has letters too small to read here
CHANNELS = 5  # in the table of residuals
FIGURE = re.compile(
    r'(?s)<figure class="plot[^"]*">\s*<figcaption><h3>(.*?)</h3><p>(.*?)</p></figcaption>\s*(<svg.*?</svg>)'
)
VERDICTS = {
    "explained": "explained", "unexplained": "unexplained", "cannot_tell": "cannot tell",
    "nothing_missing": "nothing missing",
}  # fmt: skip
Document = dict[str, Any]


def entries() -> list[Document]:
    """What recordings.toml lists."""
    text = (FOLDER / "recordings.toml").read_text(encoding="utf-8")
    listed: list[Document] = tomllib.loads(text)["recording"]
    return listed


def explain(entry: Document) -> None:
    """Its JSON and report into gallery-out/, and the processor time it took. Errors:
    CalledProcessError where handcal fails."""
    out = KEPT / f"{entry['name']}.json"
    if out.exists():
        return
    print(f"{entry['name']}: explaining", flush=True)
    begun = resource.getrusage(resource.RUSAGE_CHILDREN)
    made = out.with_suffix(".new")
    command = ["-m", "handcal", "explain", str(RECORDINGS / entry["file"])]
    files = ["--json", str(made), "--report", str(out.with_suffix(".html"))]
    subprocess.run([sys.executable, *command, *files], check=True, stdout=subprocess.DEVNULL)
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    document = json.loads(made.read_text(encoding="utf-8"))
    spent = ended.ru_utime + ended.ru_stime - begun.ru_utime - begun.ru_stime
    out.write_text(json.dumps(document | {"processor_s": round(spent)}), encoding="utf-8")
    made.unlink()
    print(f"{entry['name']}: {spent:.0f} s", flush=True)


# ---- what is known against what was found ------------------------------------------------------


def judged(fact: Document, document: Document) -> list[Document]:
    """Each parameter of a fact: name, known, within, found, sigma and a word: "right", "missed",
    "not told" (found, with a sigma above the tolerance, or not shown by this motion), or "not
    named" (where zero is within the tolerance)."""
    got = {(p["effect"], p["name"]): p for p in document["parameters"]}
    hidden = {(p["effect"], p["name"]) for p in document["untellable"]}
    off = got.get(tuple(fact["less"].split())) if "less" in fact else None
    effect, within = fact["effect"], fact["within"]
    units = {p.name: p.unit for p in known_effect(effect).parameters}
    rows = []
    for name, known in zip(fact["names"].split(), fact["values"], strict=True):
        p, found, sigma = got.get((effect, name)), None, None
        if p is None:
            small = abs(known) <= within
            word = "not told" if (effect, name) in hidden else "not named" if small else "missed"
        else:
            found, sigma = p["value"] - (off["value"] if off else 0.0), p["sigma"]
            right = abs(found - known) <= within
            word = "not told" if sigma > within else "right" if right else "missed"
        rows.append({"effect": effect, "name": name, "unit": units[name], "known": known,
                     "within": within, "found": found, "sigma": sigma, "word": word})  # fmt: skip
    return rows


def facts_of(entry: Document, document: Document) -> list[Document]:
    return [row for fact in entry.get("known", ()) for row in judged(fact, document)]


def facts_table(rows: list[Document]) -> str:
    """Known beside found; what was missed stands out."""
    lines = ["| | known | found | |", "|---|---|---|---|"]
    for r in rows:
        alike = [o for o in rows if o["effect"] == r["effect"]]
        unit = shown(r["unit"], [v for o in alike for v in (o["known"], o["found"] or 0.0)])
        known, found = (
            "–" if value is None else
            f"{unit.value(value, sigma)} ± {unit.value(sigma, sigma)} {unit.unit}"
            for value, sigma in ((r["known"], r["within"]), (r["found"], r["sigma"]))
        )  # fmt: skip
        word = f"**{r['word']}**" if r["word"] == "missed" else r["word"]
        title = f"{words.effect_title(r['effect'])} {r['name']}"
        lines.append(f"| {title} | {known} | {found} | {word} |")
    return "\n".join(lines)


# ---- what handcal says -------------------------------------------------------------------------


def plain(text: str) -> str:
    """A piece of the report as Markdown."""
    text = html.unescape(re.sub(r"<[^>]+>", "", text)).replace("*", r"\*")
    return re.sub(r"[ \n]+", " ", text).strip()


def said(report: str) -> list[str]:
    """Headline and sentences of the verdict."""
    (section,) = re.findall(r'(?s)<section class="verdict[^"]*">(.*?)</section>', report)
    return [plain(part) for part in re.findall(r"(?s)<(?:strong|p)>(.*?)</(?:strong|p)>", section)]


def unseen(report: str) -> str:
    """What blocks that the fit has not seen say of the model."""
    found = re.search(r"(?s)Does it hold on data[^<]*</h2>\s*<p>(.*?)</p>", report)
    return plain(found.group(1)) if found else "Nothing was held out of the fit."


def pictures(entry: Document, report: str) -> list[str]:
    """A channel that differs and the evidence, as files beside the page, and how the page shows them."""
    figures = FIGURE.findall(report)
    traces = [f for f in figures if " (rms) off" in f[1]]
    evidence = [f for f in figures if f[0] == "Evidence for each effect"]
    small = [f for f in traces if len(f[2]) < SMALL and width(f[2]) < COLUMN]
    out = []
    for kind, (title, caption, drawing) in zip(
        ("trace", "evidence"), (*small[:1], *evidence), strict=False
    ):
        name = f"{entry['name']}-{kind}.svg"
        (FOLDER / name).write_text(standing_alone(drawing), encoding="utf-8")
        out.append(
            f"![{plain(title)}: {plain(caption)}]({name})\n\n*{plain(title)}.* {plain(caption)}"
        )
    if small and small[0] is not traces[0]:
        out[0] += (
            f" (The worst channel, {plain(traces[0][0])}, is drawn in the report alone, wider than this page.)"
        )
    return out


def width(drawing: str) -> float:
    """In SVG units."""
    found = re.search(r'viewBox="0 0 ([0-9.]+)', drawing)
    return float(found.group(1)) if found else math.inf


def standing_alone(drawing: str) -> str:
    """A drawing of a report as a file of its own, in the colours of light pages."""
    for colour, variable in PALETTE.items():
        drawing = drawing.replace(f"var({variable})", colour)
    drawing = drawing.replace("var(--sans)", "'DejaVu Sans', sans-serif")
    return drawing.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"', 1) + "\n"


def differed(document: Document) -> str:
    """Channels, times and shares of the mismatch."""
    if not document["mismatch"]:
        return "Nowhere by more than chance."
    lines = ["| channel | from, to | when | share of the mismatch |", "|---|---|---|---|"]
    for m in sorted(document["mismatch"], key=lambda m: -m["share"]):
        span = f"{m['from_s']:.0f} to {m['to_s']:.0f} s"
        share = say.whole_percent(m["share"])
        lines.append(f"| {words.channel_title(m['channel'])} | {span} | {m['when']} | {share} |")
    return "\n".join(lines)


def with_sigma(found: Document, unit: Shown) -> str:
    """Its value and uncertainty as numbers of this unit."""
    sigma = found["sigma"]
    return f"{unit.value(found['value'], sigma, sign=True)} ± {unit.value(sigma, sigma)}"


def missing(document: Document) -> str:
    """What was named, with sizes, and laws without a name."""
    lines = ["| effect | nats | size |", "|---|---|---|"]
    for m in document["missing"]:
        values = m["parameters"]
        unit = shown(values[0]["unit"], [v for p in values for v in (p["value"], p["sigma"])])
        same = [p for p in values if p["unit"] == values[0]["unit"]]
        size = ", ".join(f"{p['name']} {with_sigma(p, unit)}" for p in same)
        names = " or ".join(map(words.effect_title, (m["effect"], *m["indistinguishable_from"])))
        gain = say.number(m["log_evidence_gain"])
        lines.append(f"| {names} | {gain} | {size} {unit.unit} |")
    for u in document["unnamed"]:
        gain = say.number(u["log_evidence_gain"])
        formula = html.escape(u["formula"]).replace("|", "&#124;")
        unit = shown(u["unit"], [u["value"], u["sigma"]])
        size = f"{with_sigma(u, unit)} {unit.unit}"
        lines.append(f"| no name: <code>{formula}</code> | {gain} | {size} |")
    return "\n".join(lines) if len(lines) > 2 else "Nothing was named."


def improved(document: Document) -> str:
    """Residuals and evidence, before and after."""
    before, after = (document["fit"][k] for k in ("before", "after"))
    share: dict[str, float] = {}
    for m in document["mismatch"]:
        share[m["channel"]] = share.get(m["channel"], 0.0) + m["share"]
    worst = sorted(before["residual_rms"], key=lambda c: -share.get(c, 0.0))[:CHANNELS]
    lines = ["| residual, root mean square | biases alone | final model |", "|---|---|---|"]
    for channel in worst:
        pair = [fit["residual_rms"][channel] for fit in (before, after)]
        unit = say.channel_shown(channel, pair, small=True)
        old, new = (unit.value(v, 0.1 * max(pair)) for v in pair)
        lines.append(f"| {words.channel_title(channel)} | {old} | {new} {unit.unit} |")
    gain = after["log_evidence"] - before["log_evidence"]
    lines.append(
        f"| log evidence, nats | {before['log_evidence']:,.0f} | {after['log_evidence']:,.0f} |"
    )
    return (
        "\n".join(lines)
        + f"\n\nThe final model makes the recording {say.nats(gain)} more probable."
    )


# ---- pages -------------------------------------------------------------------------------------


def open_points(
    entry: Document, document: Document, rows: list[Document], kept: dict[str, Document]
) -> str:
    """What is unknown, what does not agree, and what the motion did not show."""
    facts = {r["effect"] for r in rows}
    alone = [
        words.effect_title(m["effect"]) for m in document["missing"] if m["effect"] not in facts
    ]
    points = [entry["not_known"]]
    if alone:
        points.append(f"Named, with nothing to hold it against: {words.listed(alone)}.")
    if wrong := [
        f"{words.effect_title(r['effect'])} {r['name']}" for r in rows if r["word"] == "missed"
    ]:
        points.append(
            f"**Missed: {words.listed(wrong)}.** Not found, or further off than sigma and tolerance allow; either number may be wrong."
        )
    score = document["held_out"] or {}
    if score and score["log_score_after"] < score["log_score_before"]:
        points.append(
            "**The model does worse on blocks that it has not seen:** part of it is this recording's alone."
        )
    if document["verdict"] == "unexplained":
        points.append("Something is left that no effect of the catalogue accounts for.")
    points += repeated(entry, document, kept)
    points += [plain(html.escape(w)) for w in document["warnings"]]
    return "\n".join(f"- {p}" for p in points)


def repeated(entry: Document, document: Document, kept: dict[str, Document]) -> list[str]:
    """Of each law without a name whether another recording of the unit has it, too: on the same
    sensor, of the same driver. One that has not is no law of the device."""
    others = {
        e["title"]: kept[e["name"]] for e in entries()
        if e["name"] in kept and e["name"] != entry["name"] and e.get("unit") == entry.get("unit", e)
    }  # fmt: skip
    points = []
    for u in document["unnamed"]:
        law = f"<code>{html.escape(u['formula']).replace('|', '&#124;')}</code>"
        again = [title for title, d in others.items() if any(map(partial(alike, u), d["unnamed"]))]
        if again:
            points.append(f"{law} was found again, of the same driver, in: {'; '.join(again)}.")
        elif others:
            points.append(
                f"{law} was not found in {'; '.join(others)}, of the same unit: **as a law of the device it is withdrawn**, and describes this recording alone."
            )
        else:
            points.append(
                f"{law} could not be repeated: there is no second recording of this unit. It describes this recording, and nothing is claimed of the device."
            )
    return points


def alike(law: Document, other: Document) -> bool:
    """Whether two laws are of one sensor and of the same drivers."""
    sensors = [{c.split("_")[0] for c in one["channels"]} for one in (law, other)]
    return sensors[0] == sensors[1] and set(law["drivers"]) == set(other["drivers"])


def page(entry: Document, document: Document, report: str, kept: dict[str, Document]) -> str:
    """One recording, from what was recorded to what stayed open."""
    rows = facts_of(entry, document)
    headline, *sentences = said(report)
    known = f"From {entry['known_from']}.\n\n{facts_table(rows)}" if rows else "Nothing."
    shown_ = pictures(entry, report)
    seconds, rate = (document["recording"][k] for k in ("duration_s", "imu_rate_hz"))
    parts = [
        f"# {entry['title']}",
        f"*Reference.* {entry['what']} {seconds:.0f} s, {rate:.0f} readings a second. Source: {entry['source']}. Explained in {document['processor_s']:,} s of processor time; the figures are handcal's.",
        f"**{headline}** {' '.join(sentences)}",
        "## Where simulation and recording differed", differed(document), *shown_[:1],
        "## What was missing", missing(document), *shown_[1:],
        "## How the fit improved", improved(document),
        "## On blocks that the fit has not seen", unseen(report),
        "## What is known from elsewhere", known,
        "## What stayed open", open_points(entry, document, rows, kept),
        "[All recordings](index.md)",
    ]  # fmt: skip
    return "\n\n".join(parts) + "\n"


INTRODUCTION = """# Gallery: recordings of real devices

*Reference.* `handcal explain` on other people's recordings, without a hint, beside what is known of the devices from elsewhere. Misses are shown. *Right* counts numbers within the tolerance to which somebody else's are to be believed, with a sigma below it; *missed* those outside; the rest this motion could not tell, or found too small to be named. *Unseen blocks*: nats by which the model predicts later blocks better than biases alone, fitted to earlier ones.

"""
CLOSING = """
Of devices whose recordings come without one of these licences (phones, a drone, a robot's arm), nothing is shown here; two of [three stories](../stories.md) are told by such. `make gallery` computes these pages again from the recordings, which are not part of the repository; [recordings.toml](recordings.toml) says where they are from.
"""


def rows_before() -> dict[str, str]:
    """Of the overview that there is, the row of each page, by the recording's name."""
    path = FOLDER / "index.md"
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    found = [
        (re.search(r"\]\((\w+)\.md\)", line), line) for line in lines if line.startswith("| [")
    ]
    return {m[1]: line for m, line in found if m}


def overview(kept: dict[str, Document], left_out: list[str]) -> str:
    """A row for each recording."""
    before = rows_before()
    lines = ["| recording | verdict | known numbers | unseen blocks, nats | processor, s |",
             "|---|---|---|---|---|"]  # fmt: skip
    for entry in entries():
        if entry["name"] not in kept:
            lines += [before[entry["name"]]] if entry["name"] in before else []
            continue
        document = kept[entry["name"]]
        words_ = [r["word"] for r in facts_of(entry, document)]
        missed = words_.count("missed")
        told = f"{words_.count('right')} of {len(words_)} right" if words_ else "none"
        told += f", **{missed} missed**" if missed else ""
        score = document["held_out"]
        gain = score["log_score_after"] - score["log_score_before"] if score else math.nan
        lines.append(
            f"| [{entry['title']}]({entry['name']}.md) | {VERDICTS[document['verdict']]} | {told} "
            f"| {say.number(gain)} | {document['processor_s']:,} |"
        )
    out = INTRODUCTION + "\n".join(lines) + "\n"
    if left_out:
        out += f"\nLeft out, for explaining them takes long: {'; '.join(left_out)}.\n"
    return out + CLOSING


def write_pages() -> None:
    """All pages of what is kept."""
    kept, left_out = {}, []
    for entry in entries():
        path = KEPT / f"{entry['name']}.json"
        if not path.exists():
            if not (FOLDER / f"{entry['name']}.md").exists():
                left_out.append(entry["title"])
            continue
        kept[entry["name"]] = json.loads(path.read_text(encoding="utf-8"))
    for entry in entries():
        if entry["name"] in kept:
            report = (KEPT / f"{entry['name']}.html").read_text(encoding="utf-8")
            text = page(entry, kept[entry["name"]], report, kept)
            (FOLDER / f"{entry['name']}.md").write_text(text, encoding="utf-8")
    (FOLDER / "index.md").write_text(overview(kept, left_out), encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="explain only these; all without")
    parser.add_argument("--only-pages", action="store_true", help="explain nothing")
    told = parser.parse_args()
    KEPT.mkdir(exist_ok=True)
    for entry in () if told.only_pages else entries():
        if not told.names or entry["name"] in told.names:
            explain(entry)
    write_pages()


if __name__ == "__main__":
    main()
