"""The command ``fleet``. What is slow to import is imported where it is used."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Annotated

import typer

from handcal.commands._ending import INTERRUPTED
from handcal.commands._options import Anyway
from handcal.commands._registry import say, tell

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from handcal.fleet.record import Document, Options, Source
    from handcal.fleet.run import Member, Progress
    from handcal.fleet.store import Store

# A recording of minutes is explained in one to seven minutes at the worst (docs/gallery).
DEADLINE_S = 900.0
# `explain` of ten minutes at 100 Hz needs about 1 GB.
MEMORY_MB = 4000.0
# Recordings of which the terminal says why they are no part of the fleet.
MOST_SAID = 20


def fleet(
    sources: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="SOURCE...",
            help="Recordings: files, folders, patterns or addresses (s3://, https://, ...). None "
            "with --manifest.",
        ),
    ] = None,
    out: Annotated[
        str | None,
        typer.Option(
            "--out",
            metavar="DIR",
            help="Folder or address for the results (required). A run continues from the results "
            "that are there.",
        ),
    ] = None,
    executor: Annotated[
        str,
        typer.Option(
            metavar="local|dask://HOST:PORT",
            help="Where to compute: on this machine or on a Dask cluster.",
        ),
    ] = "local",
    priors: Annotated[
        Path | None,
        typer.Option(metavar="FILE.toml", help="Prior from an earlier fleet of these models."),
    ] = None,
    group_by: Annotated[
        str,
        typer.Option(
            "--group-by",
            metavar="COLUMN",
            help="Column of the manifest by which devices form a population.",
        ),
    ] = "model",
    manifest: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv",
            help="Table of the recordings, with columns path, device, model, started.",
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1, help="Recordings at a time, with --executor local; one per core if not given."
        ),
    ] = None,
    deadline: Annotated[
        float, typer.Option(min=0.1, metavar="SECONDS", help="Time limit for one recording.")
    ] = DEADLINE_S,
    memory: Annotated[
        float, typer.Option(min=1.0, metavar="MB", help="Memory limit for one recording.")
    ] = MEMORY_MB,
    budget: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            metavar="SECONDS",
            help="Time limit of the search for each recording, as in `explain`.",
        ),
    ] = None,
    anyway: Anyway = False,
) -> None:
    """Explain every recording of many devices, and find what the devices of a model have in common.

    Each result is kept at once; after an interruption, the same command continues.
    """
    from handcal.fleet import store as kept
    from handcal.fleet.record import Options
    from handcal.output import check_outputs
    from handcal.types import HandcalError, InputError

    if not hasattr(os, "fork"):
        raise HandcalError("handcal fleet needs a system that can fork: Linux or macOS.")
    if out is None:
        raise InputError("Say where results go: --out DIR.")
    listed, left_out = _listed(sources or [], manifest, group_by, out)
    options = Options(deadline, int(memory * 1e6), budget)
    with kept.opened_at(out) as store:
        check_outputs(kept.told_files(store.folder), (priors, manifest))
        _announced(listed, left_out)
        prior_of = _prior_of(priors, listed)
        members = _run(listed, store, options, executor, workers or os.cpu_count() or 1, prior_of)
        _written(members, store, anyway)


def _listed(
    sources: Sequence[str], manifest: Path | None, group_by: str, own: str
) -> tuple[list[Source], list[str]]:
    from handcal.fleet.sources import found, joined
    from handcal.fleet.sources import listed as rows_of
    from handcal.types import InputError

    if not sources and manifest is None:
        raise InputError("Name recordings (files, folders, patterns) or a --manifest of them.")
    rows = rows_of(manifest) if manifest else []
    # (what an earlier run wrote into a folder that is read is no recording)
    recordings, left_out = found(sources, own)
    out = joined(recordings, rows, group_by)
    if not out:
        raise InputError(f"There is no recording in {', '.join(sources)}.")
    return out, left_out


def _announced(listed: Sequence[Source], left_out: Sequence[str]) -> None:
    """What is not known of the recordings, before anything runs."""
    if left_out:
        names = ", ".join(PurePath(p).name for p in left_out[:3])
        say(f"{len(left_out)} files are skipped, whose names are not those of recordings: {names}")
    nameless = sum(not s.device for s in listed)
    if nameless:
        say(f"the device of {nameless} of {len(listed)} recordings is not known: each counts as a "
            "device of its own (name devices in --manifest FILE.csv)")  # fmt: skip
    if any(not s.model for s in listed):
        say("the model of some recordings is not known: they form one population, unknown")


def _prior_of(priors: Path | None, listed: Sequence[Source]) -> Callable[[Source], Document | None]:
    if priors is None:
        return lambda _: None
    from handcal.device.priors import prior, read
    from handcal.fleet.work import prior_json

    learned = read(priors)
    for model in sorted({s.model for s in listed} - set(learned.models)):
        say(f"{priors} has no prior for {model or 'devices of no model'}: the usual prior is used")
    return lambda source: prior_json(prior(learned, source.model) if source.model in learned.models
                                     else None)  # fmt: skip


def _run(
    listed: Sequence[Source], store: Store, options: Options, executor: str, workers: int,
    prior_of: Callable[[Source], Document | None],
) -> list[Member]:  # fmt: skip
    from handcal.fleet.run import run
    from handcal.fleet.supervise import Local
    from handcal.workers import opened

    try:
        with opened(executor, workers, Local) as open_workers:
            if open_workers.said:
                say(f"Dask shows what it does at {open_workers.said}")
            return run(listed, store, open_workers, options, prior_of, _Line())
    except KeyboardInterrupt:
        say(f"interrupted; what is finished is kept in {store.shown}, and the same command "
            "continues from there")  # fmt: skip
        raise typer.Exit(INTERRUPTED) from None


class _Line:
    """Progress on stderr: one line that changes, in a log one now and then."""

    def __init__(self) -> None:
        self.said = 0.0
        self.terminal = sys.stderr.isatty()

    def __call__(self, progress: Progress) -> None:
        from handcal.fleet.run import EVERY_S

        now = time.monotonic()
        last = progress.finished == progress.total
        if now - self.said < (0.2 if self.terminal else EVERY_S) and not last:
            return
        self.said = now
        if self.terminal:
            end = "\n" if last else ""
            print(f"\r\x1b[Khandcal: {progress.line(now)}", end=end, file=sys.stderr, flush=True)
        else:
            say(progress.line(now))


def _written(members: Sequence[Member], store: Store, anyway: bool) -> None:
    """All that is told of the fleet."""
    from handcal.fleet.results import write_all
    from handcal.population.stacked import FOUND
    from handcal.show import words

    told = write_all(
        members,
        store,
        lambda m: say(f"what the devices of {m or 'no model'} have in common"),
        anyway,
    )
    tell(f"{told.done} recordings explained, {told.failed} without a result: "
         f"{store.shown}/fleet.html")  # fmt: skip
    for sentence in told.said[:MOST_SAID]:
        say(sentence)
    if len(told.said) > MOST_SAID:
        say(f"and {len(told.said) - MOST_SAID} more: {store.shown}/fleet.json has them all")
    for m in told.fleet.models:
        learned = sum(c.told for c in m.common)
        found = [words.effect_title(s.effect) for s in m.stacks if s.probability > FOUND]
        names = ", ".join(found) or "nothing found"
        tell(f"{m.name}: {m.devices} devices; {learned} of {len(m.common)} spreads determined, "
             f"{len(m.odd)} odd ones; common to them: {names}")  # fmt: skip
