"""The command ``live``. What is slow to import is imported where it is used."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from handcal.commands._options import load
from handcal.commands._registry import say

if TYPE_CHECKING:
    from handcal.live.estimates import Ended
    from handcal.live.session import Session


def live(
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="The folder to write to.")
    ] = Path("live-out"),
    lan: Annotated[
        bool,
        typer.Option("--lan", help="Serve the page to this network too, encrypted, not to this "
                     "machine alone."),
    ] = False,
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="Port of the page; any free one.")
    ] = None,
    source: Annotated[
        Path | None,
        typer.Option("--from", metavar="FILE", help="Practise: feed a recording, without a page."),
    ] = None,
    speed: Annotated[
        float, typer.Option(min=0.0, help="With --from, times as fast as it happened; 0: at once.")
    ] = 1.0,
    budget: Annotated[
        float | None,
        typer.Option(min=0.0, metavar="SECONDS", help="Time limit of the search, as of explain."),
    ] = None,
) -> None:  # fmt: skip
    """Record a phone as it moves, through a page in its browser, and explain the recording.

    Open the link on the phone, do what the page says, press Stop (or Ctrl-C here). Writes
    recording.mcap, calibration.json, explanation.json and report.html. What was recorded survives
    a crash: start again with the same folder, and the same link goes on.
    """
    from handcal.live.recorder import opened
    from handcal.live.session import Session

    recording = None if source is None else load(source, None, None)
    if recording is None:
        _check_installed()
    out.mkdir(parents=True, exist_ok=True)
    session = Session(opened(out / "recording.mcap"))
    if session.recorder.samples:
        say(f"going on with {session.recorder.seconds:.0f} s that were recorded before")
    if recording is None:
        ended = _served(session, out, lan, port, budget)
    else:
        from handcal.live.run import fed

        ended = fed(session, recording, speed, out, budget, say)
    print(ended.headline)
    for sentence in ended.sentences:
        print(sentence)
    print(f"{out}: {', '.join(ended.files)}")


def _check_installed() -> None:
    from importlib.util import find_spec

    from handcal.live.link import NEEDED
    from handcal.types import InputError

    if find_spec("aiohttp") is None:
        raise InputError(f"{NEEDED}.")


def _served(
    session: Session, out: Path, lan: bool, port: int | None, budget: float | None
) -> Ended:
    import asyncio

    from handcal.live.link import link_of, qr
    from handcal.live.run import serve

    link = link_of(out, lan, port)

    def ready() -> None:
        print(qr(link.url) + link.url, flush=True)
        if lan:
            say("the phone will warn that it does not know the certificate, which was made here: "
                "go on all the same (Advanced, Proceed; on iOS Show Details, visit)")  # fmt: skip
        else:
            say("the page can be opened on this machine alone; --lan serves it to a phone")

    return asyncio.run(serve(session, link, out, budget, say, ready))
