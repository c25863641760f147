"""A session from its first batch to its files: served to a phone, or fed from a recording."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable
from pathlib import Path

from handcal.live.estimates import Ended, finish, look
from handcal.live.link import Link
from handcal.live.session import Session
from handcal.live.sources import file
from handcal.types import HandcalError, Recording

LOOK_S, FAREWELL_S, LINGER_S = 2.0, 20.0, 1.0
Say = Callable[[str], None]


def fed(session: Session, recording: Recording, speed: float, out: Path, budget: float | None,
        say: Say) -> Ended:  # fmt: skip
    """Feed a recording, and end. Errors: HandcalError."""
    if left := file.left_out(recording):
        say(left)
    try:
        file.feed(recording, session, speed)
    except KeyboardInterrupt:
        say("stopped; explaining what there is")

    def progress(_fraction: float, stage: str) -> None:
        if stage:
            say(stage)

    return finish(session, out, False, budget, progress, (left,) if left else ())


async def serve(session: Session, link: Link, out: Path, budget: float | None, say: Say,
                ready: Callable[[], None]) -> Ended:  # fmt: skip
    """Serve the page until Stop or Ctrl-C, explain, and tell the page. Errors: HandcalError."""
    from handcal.live.server import Served, listening

    served = Served(session, link)
    runner = await listening(served)
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, served.stop.set)
    try:
        ready()
        watching = asyncio.create_task(_watch(session))
        await served.stop.wait()
        session.state = "working"
        say("stopped; explaining what there is")
        watching.cancel()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.remove_signal_handler(number)  # (a second Ctrl-C ends it here and now)
        return await _finished(session, out, budget, say)
    finally:
        if session.client and session.state in ("done", "failed"):
            await _within(served.seen, FAREWELL_S)
            await asyncio.sleep(LINGER_S)
        await runner.cleanup()


async def _watch(session: Session) -> None:
    """Look at what there is now and then, in a thread beside the server."""
    while True:
        await asyncio.to_thread(look, session, True)
        await asyncio.sleep(LOOK_S)


async def _finished(session: Session, out: Path, budget: float | None, say: Say) -> Ended:
    def progress(fraction: float, stage: str) -> None:
        session.told |= {"progress": round(fraction, 3)} | ({"stage": stage} if stage else {})
        if stage:
            say(stage)

    try:
        ended = await asyncio.to_thread(finish, session, out, True, budget, progress)
    except HandcalError as error:
        session.told["verdict"] = {"headline": str(error), "sentences": [], "files": []}
        session.state = "failed"
        raise
    session.told["verdict"] = ended.document
    session.state = "done"
    return ended


async def _within(event: asyncio.Event, seconds: float) -> None:
    try:
        await asyncio.wait_for(event.wait(), seconds)
    except TimeoutError:
        return
