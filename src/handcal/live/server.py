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
from handcal.types import InputError

PAGE = Path(__file__).with_name("page")
TYPES = {"": "text/html", "page.js": "text/javascript", "page.css": "text/css"}
LARGEST = 256 * 1024
PER_S, BURST = 25.0, 60.0
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
    has been told how it ended."""

    session: Session
    link: Link
    stop: asyncio.Event = field(default_factory=asyncio.Event)
    seen: asyncio.Event = field(default_factory=asyncio.Event)
    allowance: float = BURST
    asked: float = 0.0


def application(served: Served) -> web.Application:
    """The pages: the page itself, ``hello``, ``batch``, ``state``, ``stop``, under the token."""

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
    app = web.Application(middlewares=[guard], client_max_size=LARGEST)
    app.router.add_get("/{token}/{name:(page.js|page.css)?}", _page)
    app.router.add_get("/{token}/state", _asked(served))
    for name, act in (("hello", _hello), ("batch", _batch), ("stop", _stop)):
        app.router.add_post(f"/{{token}}/{name}", _posted(act, served))
    return app


def _check(request: web.Request, served: Served) -> None:
    """Errors: Refused for another name of this machine, a wrong token, or too much."""
    if request.host not in served.link.hosts:
        raise Refused(403, "This machine goes by another name.")
    token = request.path.split("/")[1].encode()
    if not hmac.compare_digest(token, served.link.token.encode()):
        raise Refused(403, "This link is not the right one.")
    if (request.content_length or 0) > LARGEST:
        raise Refused(413, f"A batch may have {LARGEST // 1024} kB at most.")
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


async def _page(request: web.Request) -> web.Response:
    name = request.match_info["name"]
    text = (PAGE / (name or "index.html")).read_text("utf-8")
    return web.Response(text=text, content_type=TYPES[name], charset="utf-8")


def _asked(served: Served) -> Handler:
    async def handler(_request: web.Request) -> web.Response:
        if served.session.state in ("done", "failed"):
            served.seen.set()
        return _answer(served)

    return handler


def _posted(act: Callable[[bytes, Served], None], served: Served) -> Handler:
    async def handler(request: web.Request) -> web.Response:
        act(await request.read(), served)
        return _answer(served)

    return handler


def _hello(body: bytes, served: Served) -> None:
    served.session.hello(_client(body))


def _batch(body: bytes, served: Served) -> None:
    served.session.take(browser.parse(body))


def _stop(body: bytes, served: Served) -> None:
    served.session.hello(_client(body))
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


async def listening(served: Served) -> web.AppRunner:
    """A server that has begun. Errors: InputError where the port is in use."""
    runner = web.AppRunner(application(served), access_log=None)
    await runner.setup()
    link = served.link
    tls = _tls(link.certificate) if link.certificate else None
    try:
        await web.TCPSite(runner, link.host, link.port, ssl_context=tls).start()
    except OSError as error:
        await runner.cleanup()
        raise InputError(
            f"Port {link.port} of {link.host} cannot be used ({error.strerror}): choose another "
            "with --port."
        ) from error
    return runner
