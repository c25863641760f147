"""Serves the page and takes what it sends, to one phone, behind a token."""

from __future__ import annotations

import asyncio
import hmac
import json
import ssl
import tempfile
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from aiohttp import web

from handcal.live.link import Link
from handcal.live.session import Refused, Session
from handcal.live.sources import browser
from handcal.live.sources.sensor_logger import Pushed
from handcal.types import InputError

PAGE = Path(__file__).with_name("page")
TYPES = {"": "text/html", "page.js": "text/javascript", "page.css": "text/css"}
LARGEST = 256 * 1024
# An app that pushes says eight sensors' names with every reading, for some seconds at a time.
LARGEST_PUSH = 4 * 2**20
PER_S, BURST = 25.0, 60.0
# Connections at once: a browser keeps six; and for how long an idle one is kept, s.
MOST_CONNECTIONS, KEEP_S = 32, 15.0
# For so long what comes behind a refused batch is thrown away, so that its sender hears the reason.
LINGER_S = 1.0
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


@dataclass
class Served:
    """What the handlers share. stop: set when the recording is to end; seen: set when the page
    has been told how it ended; pages: whether there is one to
    be told; pushed: what an app has sent."""

    session: Session
    link: Link
    stop: asyncio.Event = field(default_factory=asyncio.Event)
    seen: asyncio.Event = field(default_factory=asyncio.Event)
    pushed: Pushed = field(default_factory=Pushed)
    pages: bool = False
    allowance: float = BURST
    asked: float = 0.0


def application(served: Served) -> web.Application:
    """The pages: the page itself, ``hello``, ``batch``, ``state``, ``stop``, under the token,
    and ``push`` for Sensor Logger."""

    async def guarded(request: web.Request, handler: Handler) -> web.StreamResponse:
        try:
            _check(request, served)
            answer = await handler(request)
        except Refused as refused:
            answer = _answer(served, refused.status, error=str(refused))
            if refused.status == 413:
                answer.force_close()
        except web.HTTPException as error:
            answer = _answer(served, error.status, error=error.reason)
        answer.headers.update(HEADERS)
        return answer

    guard: Any = web.middleware(guarded)
    app = web.Application(middlewares=[guard], client_max_size=LARGEST_PUSH)
    app.router.add_get("/{token}/{name:(page.js|page.css)?}", _shown(served))
    app.router.add_get("/{token}/state", _asked(served))
    for name, act in (("hello", _hello), ("batch", _batch), ("stop", _stop)):
        app.router.add_post(f"/{{token}}/{name}", _posted(act, served))
    app.router.add_post("/{token}/push", _pushed(served))
    return app


def _check(request: web.Request, served: Served) -> None:
    """Errors: Refused for another name of this machine, a wrong token, or too much."""
    if request.host not in served.link.hosts:
        raise Refused(403, "This machine goes by another name.")
    token = request.path.split("/")[1].encode()
    if not hmac.compare_digest(token, served.link.token.encode()):
        raise Refused(403, "This link is not the right one.")
    largest = LARGEST_PUSH if request.path.endswith("/push") else LARGEST
    if (request.content_length or 0) > largest:
        raise Refused(413, f"A batch may have {largest // 1024} kB at most.")
    now = asyncio.get_running_loop().time()
    served.allowance = min(BURST, served.allowance + PER_S * (now - served.asked))
    served.asked = now
    if served.allowance < 1.0:
        raise Refused(429, "Too many requests; wait a second.")
    served.allowance -= 1.0


def _answer(served: Served, status: int = 200, **more: Any) -> web.Response:
    known = {"next": served.session.next} if status == 403 else served.session.status()
    text = json.dumps({**({} if status == 403 else known), **more}, allow_nan=False)
    return web.Response(text=text, status=status, content_type="application/json")


def _shown(served: Served) -> Handler:
    async def handler(request: web.Request) -> web.Response:
        served.pages = True
        return await _page(request)

    return handler


async def _page(request: web.Request) -> web.Response:
    name = request.match_info["name"]
    text = (PAGE / (name or "index.html")).read_text("utf-8")
    return web.Response(text=text, content_type=TYPES[name], charset="utf-8")


def _asked(served: Served) -> Handler:
    async def handler(_request: web.Request) -> web.Response:
        served.pages = True
        if served.session.state in ("done", "failed"):
            served.seen.set()
        return _answer(served)

    return handler


def _posted(act: Callable[[bytes, Served], None], served: Served) -> Handler:
    async def handler(request: web.Request) -> web.Response:
        served.pages = True  # (one that was opened before a restart, too)
        body = await request.read()
        if len(body) > LARGEST:  # (sent without saying its length)
            raise Refused(413, f"A batch may have {LARGEST // 1024} kB at most.")
        act(body, served)
        return _answer(served)

    return handler


def _pushed(served: Served) -> Handler:
    async def handler(request: web.Request) -> web.Response:
        body = await request.read()
        served.session.source = "push"
        served.pushed.take(body, served.session)
        return _answer(served)

    return handler


def _hello(body: bytes, served: Served) -> None:
    served.session.hello(_client(body))


def _batch(body: bytes, served: Served) -> None:
    served.session.take(browser.parse(body))


def _stop(body: bytes, served: Served) -> None:
    client = _client(body)
    if served.session.source == "page":
        served.session.hello(client)
    served.stop.set()


def _client(body: bytes) -> str:
    try:
        client = json.loads(body)["client"]
    except (ValueError, RecursionError, KeyError, TypeError):
        client = None
    if not isinstance(client, str) or not 0 < len(client) <= browser.LONGEST_CLIENT:
        raise Refused(400, "client: expected a short name.")
    return client


def _tls(certificate: str) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    with tempfile.NamedTemporaryFile("w", suffix=".pem") as file:  # (made for its owner alone)
        file.write(certificate)
        file.flush()
        context.load_cert_chain(file.name)
    return context


class _Listening(web.AppRunner):
    """A runner that closes its own listener too."""

    listener: asyncio.Server | None = None

    async def cleanup(self) -> None:
        if self.listener is not None:
            self.listener.close()
        await super().cleanup()


async def listening(served: Served) -> web.AppRunner:
    """A server that has begun. Errors: InputError where the port is in use."""
    runner = _Listening(
        application(served), access_log=None, keepalive_timeout=KEEP_S, lingering_time=LINGER_S
    )
    await runner.setup()
    link = served.link
    tls = _tls(link.certificate) if link.certificate else None
    loop = asyncio.get_running_loop()
    try:
        runner.listener = await loop.create_server(
            _few(runner), link.host, link.port, ssl=tls,
            ssl_handshake_timeout=KEEP_S if tls else None,
        )  # fmt: skip
    except OSError as error:
        await runner.cleanup()
        raise InputError(
            f"Port {link.port} of {link.host} cannot be used ({error.strerror}): choose another "
            "with --port."
        ) from error
    return runner


def _few(runner: web.AppRunner) -> Callable[[], asyncio.BaseProtocol]:
    """Makes what answers a connection; of too many the oldest is closed, so that a client which
    opens a thousand of them shuts no other out."""

    def made() -> asyncio.BaseProtocol:
        server = runner.server
        assert server is not None
        for old in server.connections[: max(0, len(server.connections) - MOST_CONNECTIONS + 1)]:
            if old.transport is not None:
                old.transport.abort()
        answered: asyncio.BaseProtocol = server()
        return answered

    return made
