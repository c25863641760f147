"""A session from its first batch to its files: served to a phone, asked of one, or fed."""

from __future__ import annotations

import asyncio
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from handcal.interrupt import asked
from handcal.live.behind import worker
from handcal.live.ending import Ended, Wanted, finish
from handcal.live.link import Link
from handcal.live.looks import USUAL, Looks
from handcal.live.progress import Board, Live
from handcal.live.session import Refused, Session
from handcal.live.sources import file
from handcal.types import HandcalError, Recording

TICK_S, FAREWELL_S, LINGER_S = 0.1, 20.0, 1.0
# From one look at what is new to the next, s: an app may push two dozen times a second.
SOONEST_S = 0.05
# Between two questions to a source that has to be asked, s.
ASK_S = 0.2
Say = Callable[[str], None]
# Records what is new; False once the source has ended. Errors: HandcalError, Refused, OSError.
Pull = Callable[[Session], bool]
# A source that does not answer for so long, s, has gone.
GONE_S = 30.0
REACHED = "everything is known as well as was asked for"


@contextmanager
def followed(
    session: Session, wanted: Wanted, say: Say, board: Board | None = None, behind: bool = True
) -> Iterator[Live]:
    """What follows a session, with processes of its own. behind: whether ``explain`` runs too."""
    from multiprocessing import active_children

    others = set(active_children())
    one = worker()
    other = worker() if behind else None
    effects = wanted.effects or USUAL
    try:
        looks = Looks(one, effects, wanted.before, wanted.until)
        yield Live(session, wanted, looks, other, board, say)
    finally:
        for executor in (one, other):
            if executor is not None:
                executor.shutdown(wait=False, cancel_futures=True)
        for child in set(active_children()) - others:  # (what it works on is of no use any more)
            child.terminate()


def fed(session: Session, recording: Recording, speed: float, out: Path, wanted: Wanted,
        say: Say, board: Board | None = None) -> Ended:  # fmt: skip
    """Feed a recording, and end. Errors: HandcalError."""
    try:
        if speed:
            with followed(session, wanted, say, board) as live:
                if file.feed(recording, session, speed, tick=live.tick):
                    say(REACHED)
        else:
            file.feed(recording, session, speed)
    except KeyboardInterrupt:
        say("stopped; explaining what there is")

    def progress(_fraction: float, stage: str) -> None:
        if stage:
            say(stage)

    with asked(say) as stop:
        return finish(session, out, replace(wanted, stop=stop), progress)


async def serve(session: Session, link: Link, out: Path, wanted: Wanted, say: Say,
                ready: Callable[[], None], pull: Pull | None = None,
                board: Board | None = None) -> Ended:  # fmt: skip
    """Serve the page until Stop, Ctrl-C or the source's end, explain, and tell the page.

    pull: asks a source for what is new, where readings do not come by themselves. Errors:
    HandcalError.
    """
    from handcal.live.server import Served, listening

    served = Served(session, link)
    runner = await listening(served)
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, served.stop.set)
    try:
        ready()
        with followed(session, wanted, say, board) as live:
            watching = [asyncio.create_task(_watch(live, served.stop))]
            if pull is not None:
                asking = asyncio.to_thread(_asked, session, pull, served.stop, loop, say)
                watching.append(asyncio.create_task(asking))
            await served.stop.wait()
            session.state = "working"
            say("stopped; explaining what there is")
            watching[0].cancel()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.remove_signal_handler(number)
        with asked(say) as stop:
            return await _finished(session, out, replace(wanted, stop=stop), say)
    finally:
        if served.pages and session.state in ("done", "failed"):
            await _within(served.seen, FAREWELL_S)
            await asyncio.sleep(LINGER_S)
        await runner.cleanup()


async def _watch(live: Live, stop: asyncio.Event) -> None:
    """See what is new as soon as it comes, in a thread beside the server."""
    while True:
        began = time.monotonic()
        if await asyncio.to_thread(ticked, live):
            live.say(REACHED)
            stop.set()
        await asyncio.sleep(max(0.0, SOONEST_S - (time.monotonic() - began)))


def ticked(live: Live) -> bool:
    """Wait for something to come, for a while, and see what is new."""
    live.session.news.wait(TICK_S)
    live.session.news.clear()
    return live.tick()


def _asked(
    session: Session, pull: Pull, stop: asyncio.Event, loop: asyncio.AbstractEventLoop, say: Say
) -> None:
    """Ask the source again and again, until it ends or has gone (in a thread)."""
    heard, quiet = time.monotonic(), threading.Event()
    while session.state == "recording":
        try:
            if not pull(session):
                break
            heard = time.monotonic()
        except (Refused, OSError) as error:
            if isinstance(error, Refused) and session.state != "recording":
                return
            if time.monotonic() - heard > GONE_S:
                say(f"the source has not answered for {GONE_S:.0f} s: {error}")
                break
        except HandcalError as error:
            say(str(error))
            break
        quiet.wait(ASK_S)
    loop.call_soon_threadsafe(stop.set)


async def _finished(session: Session, out: Path, wanted: Wanted, say: Say) -> Ended:
    def progress(fraction: float, stage: str) -> None:
        session.told |= {"progress": round(fraction, 3)} | ({"stage": stage} if stage else {})
        if stage:
            say(stage)

    try:
        ended = await asyncio.to_thread(finish, session, out, wanted, progress)
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
