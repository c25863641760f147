"""A run over a fleet: what is not kept yet is made, wherever there are workers."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any

import handcal
from handcal.fleet.record import DONE, FAILED, RECORD_SCHEMA, Document, Options, Source, key
from handcal.fleet.store import Store, stands
from handcal.fleet.supervise import supervised_all
from handcal.workers import Workers, done

# Between two lines of progress where stderr is no terminal, s.
EVERY_S = 10.0
# Recordings that travel together are lost together when their worker is: of so many seconds.
PARCEL_S = 30.0
# Towards the end parcels are so many for each worker at the least.
SHARES = 8


@dataclass(frozen=True)
class Task:
    """One recording that is to be explained, under its key."""

    key: str
    source: Source
    sha256: str
    request: Mapping[str, Any]


@dataclass(frozen=True)
class Member:
    """One recording of the fleet: where its record is kept (None: it could not be read at all, and
    ``reason`` says why)."""

    source: Source
    key: str
    reason: str = ""


@dataclass
class Progress:
    """How far a run is: of so many recordings, how many are finished, how many of these failed,
    how many were so before it began, and how many seconds the others took."""

    total: int
    finished: int = 0
    failed: int = 0
    before: int = 0
    seconds: float = 0.0
    began: float = field(default_factory=time.monotonic)

    def line(self, now: float) -> str:
        """Done, failed, rate, time left."""
        made = self.finished - self.before
        out = f"{self.finished} of {self.total} done, {self.failed} failed"
        if made and now > self.began:
            rate = made / (now - self.began)
            left = (self.total - self.finished) / rate
            out += f", {3600.0 * rate:.0f} an hour, about {_time(left)} left"
        return out


def _time(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def run(
    sources: Sequence[Source], store: Store, workers: Workers, options: Options,
    prior_of: Callable[[Source], Document | None], say: Callable[[Progress], None],
) -> list[Member]:  # fmt: skip
    """Every recording of the fleet, with its key; what is not kept yet is explained, and kept.

    prior_of: what is known of a recording's model before (``work.prior_json``). say: told of every
    step. Errors: WorkersDied; KeyboardInterrupt passes, and what was finished is kept.
    """
    progress, members = Progress(len(sources)), list[Member]()
    version = handcal.__version__  # (each look at it reads the package's metadata)
    tasks = _to_do(sources, store, options, version, prior_of, members, progress, say)
    for some, answers in done(workers, _submitted, _parcels(tasks, workers, progress)):
        for task, answer in zip(some, answers, strict=True):
            record = _record(task, answer, options, version)
            result = answer.get("result") or {}
            text = _joined(record, result.get("kept", ""))
            store.keep(task.key, text, result.get("explanation", ""))
            progress.finished += 1
            progress.failed += record["status"] != DONE
            progress.seconds += answer["seconds"]
            say(progress)
    return members


def _submitted(executor: Executor, some: Sequence[Task]) -> Future[list[Document]]:
    return executor.submit(supervised_all, [task.request for task in some])


def _parcels(
    tasks: Iterator[Task], workers: Workers, progress: Progress
) -> Iterator[tuple[Task, ...]]:
    """What travels together: as many as take ``PARCEL_S`` by what recordings took so far, and so
    few that at the end no worker has much more to do than the others."""
    given = 0
    while True:
        made = progress.finished - progress.before
        many = PARCEL_S * made / progress.seconds if progress.seconds > 0.0 else 1.0
        left = progress.total - progress.before - given
        even = left / (SHARES * workers.count)
        size = int(min(workers.together, many, even))
        some = tuple(islice(tasks, max(1, size)))
        if not some:
            return
        given += len(some)
        yield some


def _to_do(
    sources: Sequence[Source], store: Store, options: Options, version: str,
    prior_of: Callable[[Source], Document | None], members: list[Member], progress: Progress,
    say: Callable[[Progress], None],
) -> Iterator[Task]:  # fmt: skip
    """What has to be made, each set of readings once; members are noted in their order."""
    given_out: set[str] = set()
    for source in sources:
        prior = prior_of(source)
        try:
            sha256 = source.identity or store.digest(Path(source.place))
        except OSError as error:
            reason = f"It cannot be read: {error.strerror or error}."
            members.append(Member(source, "", reason))
            progress.finished, progress.failed = progress.finished + 1, progress.failed + 1
            continue
        # (where the file of priors lies does not change what it says)
        content = None if prior is None else {k: prior[k] for k in ("names", "mean", "sigma")}
        name = key(sha256, version, options, content)
        members.append(Member(source, name))
        record = store.record(name)
        if name in given_out or stands(record, options):
            progress.finished, progress.before = progress.finished + 1, progress.before + 1
            progress.failed += record is not None and record["status"] != DONE
            say(progress)
            continue
        given_out.add(name)
        request = {"path": source.place, "budget": options.budget, "prior": prior,
                   "work": options.work, "deadline": options.deadline,
                   "memory": options.memory}  # fmt: skip
        yield Task(name, source, sha256, request)


def _record(task: Task, answer: Document, options: Options, version: str) -> Document:
    """What is kept of a recording, whatever became of it, beside what it told."""
    # (of an address the worker says what it read; a recording that it could not fetch has none)
    fetched = (answer.get("result") or {}).get("fetched")
    sha256 = fetched or ("" if task.source.identity else task.sha256)
    about = {
        "schema": RECORD_SCHEMA, "version": version, "key": task.key,
        "path": task.source.shown, "sha256": sha256, "status": answer["status"],
        "reason": answer["reason"], "tries": answer["tries"], "seconds": answer["seconds"],
        "peak": answer["peak"], "deadline": options.deadline, "memory": options.memory,
        "budget": options.budget, "priors": _source_of(task.request["prior"]),
    }  # fmt: skip
    return about | ({"said": answer["said"]} if "said" in answer else {})


def _joined(record: Document, kept: str) -> str:
    """Both as one JSON object; kept: one as it came, which is not read again here."""
    own = json.dumps(record, allow_nan=False, ensure_ascii=False)
    return f"{own[:-1]}, {kept[1:]}" if kept else own


def _source_of(prior: Document | None) -> Document | None:
    if prior is None:
        return None
    return {"path" if k == "priors" else k: v for k, v in prior["source"].items()}


def rows(members: Sequence[Member], store: Store) -> Iterator[tuple[Source, Document]]:
    """Each recording with its record, as far as there is one. The same readings a second time are
    a row that failed: they count once."""
    seen: dict[str, str] = {}
    for m in members:
        if not m.key:
            yield m.source, {"status": FAILED, "reason": m.reason, "key": "", "sha256": ""}
            continue
        record = store.record(m.key)
        if record is None:
            continue
        sha256 = str(record["sha256"])
        if sha256 and sha256 in seen:
            reason = f"It holds the very readings of {seen[sha256]}, which count once."
            record = {k: record[k] for k in ("key", "sha256", "schema")}
            record |= {"status": FAILED, "reason": reason}
        seen.setdefault(sha256, m.source.shown)
        yield as_told(m.source, record), record | {"path": m.source.shown}


def as_told(source: Source, record: Document) -> Source:
    """A source; where the manifest lacks the time, the device or the model, those that its file
    states. A model of the manifest stands, since it may be another word for it."""
    started = source.started or (record.get("recording") or {}).get("recorded") or ""
    device = source.device or str(record.get("device") or "")
    model = source.model or ("" if source.device else str(record.get("model") or ""))
    return replace(source, started=started, device=device, model=model)
