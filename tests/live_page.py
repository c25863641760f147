"""A client that speaks the page's protocol, and a server of a session in a thread, for tests."""

from __future__ import annotations

import asyncio
import http.client
import json
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from handcal.live.link import Link, link_of
from handcal.live.recorder import opened
from handcal.live.session import Session
from handcal.types import Recording

START_MS = 1_760_000_000_000.0


class Page:
    """What the page does, by hand: ``post`` any body, ``batch`` a numbered one."""

    def __init__(self, link: Link, client: str = "one") -> None:
        self.link, self.client = link, client

    def post(self, name: str, body: Any, **headers: str) -> tuple[int, dict[str, Any]]:
        data = body if isinstance(body, bytes) else json.dumps(body).encode()
        return self.ask("POST", f"/{self.link.token}/{name}", data, headers)

    def ask(
        self, method: str, path: str, data: bytes | None = None, headers: Any = None
    ) -> tuple[int, dict[str, Any]]:
        connection = http.client.HTTPConnection(self.link.host, self.link.port, timeout=20)
        try:
            connection.request(method, path, data, headers or {})
            answer = connection.getresponse()
            text = answer.read()
            kind = answer.headers.get("Content-Type") or ""
            return answer.status, json.loads(text) if "json" in kind else {"text": text.decode()}
        finally:
            connection.close()

    def batch(self, seq: int, rows: dict[str, Any]) -> dict[str, Any]:
        return {"client": self.client, "seq": seq, "agent": "android", **rows}


def rows_of(recording: Recording, each: int = 25) -> list[dict[str, Any]]:
    """What a phone would send of a recording, in batches."""
    imu = recording.imu
    t = START_MS + np.round(imu.t * 1e3, 3)
    gyro = np.degrees(imu.gyro)
    return [
        {"t": t[i : i + each].tolist(), "gyro": gyro[i : i + each].tolist(),
         "accel": imu.accel[i : i + each].tolist()}
        for i in range(0, len(t), each)
    ]  # fmt: skip


@contextmanager
def running(begin: Callable[[], Awaitable[Any]]) -> Iterator[Any]:
    """A server in a loop and a thread of its own; begin: makes its runner, which is yielded."""
    loop, begun, ended = asyncio.new_event_loop(), threading.Event(), asyncio.Event()
    made: list[Any] = []

    async def run() -> None:
        made.append(await begin())
        begun.set()
        await ended.wait()
        await made[0].cleanup()

    thread = threading.Thread(target=loop.run_until_complete, args=(run(),))
    thread.start()
    assert begun.wait(10)
    try:
        yield made[0]
    finally:
        loop.call_soon_threadsafe(ended.set)
        thread.join()
        loop.close()


@contextmanager
def served(
    folder: Path, clock: Callable[[], float] | None = None, link: Link | None = None
) -> Iterator[tuple[Session, Link]]:
    """A server over loopback, until the block ends."""
    from handcal.live.server import Served, listening

    session = Session(opened(folder / "recording.mcap"))
    if clock is not None:
        session.clock = clock
    link = link_of(folder, False, None) if link is None else link
    try:
        with running(lambda: listening(Served(session, link))):
            yield session, link
    finally:
        session.recorder.close()
