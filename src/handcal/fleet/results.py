"""What a run ends with: the data set, what the fleet knows, its priors as a file."""

from __future__ import annotations

import json
import math
import re
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import chain, count
from pathlib import Path

import handcal
from handcal import output
from handcal.device.file import Name
from handcal.device.priors import Learned, write
from handcal.fleet import dataset
from handcal.fleet.laws import FOLDER, asked, laws_of, write_law
from handcal.fleet.record import DONE, FAILED, Document, Source
from handcal.fleet.run import Member, rows
from handcal.fleet.store import Store, told_files
from handcal.fleet.work import information_of
from handcal.population.by_model import Common, Model, Reading, models
from handcal.population.odd import refused
from handcal.show.fleet import Fleet, fleet_json, write_page
from handcal.trust import GOOD, Trust, check, of_document, said
from handcal.types import HandcalError


@dataclass(frozen=True)
class Written:
    """What was written: how many recordings have a result, how many have none."""

    done: int
    failed: int
    fleet: Fleet

    @property
    def said(self) -> list[str]:
        """A sentence for each recording that has no result, or tells nothing of its model."""
        return [
            *(f"{Path(path).name}: {reason}" for path, _, reason in self.fleet.failures),
            *(f"{Path(path).name} is explained, and tells nothing of its model. {reason}"
              for path, reason in self.fleet.untold),
            *(sentence for path, own in self.fleet.doubted.items()
              for sentence in said(Path(path).name, own)),
        ]  # fmt: skip


def write_all(
    members: Sequence[Member], store: Store, report: Callable[[str], None] = lambda _: None,
    anyway: bool = False,
) -> Written:  # fmt: skip
    """The data set, fleet.json, priors.toml and fleet.html of a folder, from what is kept in it;
    report: called with the name of each model before its devices are looked at; anyway: what is not
    to be trusted tells of its model too. Errors: HandcalError."""
    readings, failures, verdicts = list[Reading](), list[tuple[str, str, str]](), Counter[str]()
    untold, doubted = list[tuple[str, str]](), dict[str, Trust]()
    unused: dict[str, dict[str, list[str]]] = {}

    def seen() -> Iterator[tuple[Source, Document]]:
        for source, record in rows(members, store):
            own = of_document(source.shown, record)
            why_not = _untold(Path(source.shown).name, record, own, anyway)
            if record["status"] == DONE:
                if why_not:
                    untold.append((source.shown, why_not))
                else:
                    readings.append(reading_of(source, record))
                    if own.level != GOOD:
                        doubted[source.shown] = own
                verdicts[str(record.get("verdict"))] += 1
            else:
                failures.append((source.shown, record["status"], record["reason"]))
            if source.device:
                why = record["reason"] if record["status"] == FAILED else why_not
                of_model = unused.setdefault(source.model or dataset.UNKNOWN, {})
                of_model.setdefault(source.device, []).append(why)
            yield source, record

    dataset.write(store.folder, seen())
    known = [replace(m, odd=(*refused(unused[m.name]), *m.odd)) if m.name in unused else m
             for m in models(readings, asked(), report)]  # fmt: skip
    done = len(readings) + len(untold)
    fleet = Fleet(tuple(known), tuple(failures), dict(verdicts), done, tuple(untold),
                  doubted)  # fmt: skip
    document = fleet_json(fleet) | {"version": handcal.__version__}
    text = json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False)
    json_file, priors, page = told_files(store.folder)
    output.write_text(json_file, text + "\n")
    _write_priors(priors, known)
    _write_laws(store, known)
    write_page(fleet, page)
    for written in (dataset.FOLDER, *(p.name for p in (priors, json_file, page))):
        store.send(written)
    return Written(done, len(failures), fleet)


def _untold(name: str, record: Document, own: Trust, anyway: bool) -> str:
    """Why a recording tells nothing of the devices of its model; empty where it does."""
    try:
        check(name, own, anyway)
    except HandcalError as error:
        return str(error)
    return str(record.get("untold", ""))


def reading_of(source: Source, record: Document) -> Reading:
    """What a record tells, of which device."""
    told = record.get("told", [])
    values = {(t["effect"], t["name"]): (float(t["value"]), float(t["sigma"])) for t in told}
    together = frozenset((t["effect"], t["name"]) for t in told if t["together"])
    gravity = float(record.get("gravity", math.nan))
    model = source.model or dataset.UNKNOWN
    kept = record.get("information")
    information = None if kept is None else information_of(kept)
    warm = (record.get("recording") or {}).get("temperature_degC")
    return Reading(
        source.shown, model, source.device, values, together, gravity, information,
        _seconds(source.started), math.nan if warm is None else float(warm),
        laws_of(record.get("laws")),
    )  # fmt: skip


def _seconds(started: str) -> float:
    """s since 1970 of a time that is written in ISO 8601; nan without one."""
    try:
        when = datetime.fromisoformat(started)
    except ValueError:
        return math.nan
    return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()


def _write_laws(store: Store, known: Sequence[Model]) -> None:
    """A file of the catalogue for the law without a name of each model."""
    shutil.rmtree(store.folder / FOLDER, ignore_errors=True)
    taken: set[str] = set()
    for m in known:
        if m.law is not None:
            own = "law_of_" + re.sub(r"[^a-z0-9]+", "_", m.name.lower()).strip("_")
            names = chain((own,), (f"{own}_{n}" for n in count(2)))
            effect_id = next(i for i in names if i not in taken)
            taken.add(effect_id)
            write_law(m.law, store.folder / FOLDER, effect_id, m.name)
    if taken:
        store.send(FOLDER)


def _write_priors(path: Path, known: Sequence[Model]) -> None:
    learned: dict[str, dict[Name, Learned]] = {
        m.name: {(c.effect, c.name): learned_of(c) for c in m.common if c.told and c.own}
        for m in known
    }
    origin = {m.name: {"recordings": m.recordings, "devices": m.devices} for m in known}
    write(path, learned, origin, [f"By handcal {handcal.__version__}."])


def learned_of(c: Common) -> Learned:
    """A population as a prior; of what differs from one switching on to the next, that too."""
    p = c.population
    apart = 0.0 if math.isnan(p.apart) else p.apart
    spread = math.hypot(p.spread, apart)
    # (the ends of the interval are about four of its sigmas apart)
    return Learned(p.mean, p.mean_sigma, spread, 0.25 * (p.high - p.low), p.dof, p.count)
