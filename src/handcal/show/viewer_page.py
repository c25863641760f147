"""The viewer's page for a browser, which may reach this machine and nothing else.

The page that comes with the viewer sends usage statistics, asks for newer versions and fetches
fonts. Here it passes through a server of our own, on loopback, that leaves out what names other
hosts and adds a Content-Security-Policy: the browser itself then refuses every other request.
"""

from __future__ import annotations

import http.client
import re
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

LOOPBACK = "127.0.0.1"
TIMEOUT_S = 30.0
# Opening a connection ahead of its use is the one thing a policy does not stop.
_LINK_ELSEWHERE = re.compile(rb"<link\b[^>]*\bhref=\"(?:https?:)?//[^>]*>")
_PASSED_ON = ("Content-Type", "rerun-final-length")


def policy(data_port: int) -> str:
    """The Content-Security-Policy of a page whose data come from a port of this machine.

    The page's own scripts stand in it and compile WebAssembly. Everything that is not named,
    and every host but this one, is refused.
    """
    return "; ".join(
        (
            "default-src 'none'",
            "script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'",
            "style-src 'self' 'unsafe-inline'",
            "img-src 'self' data: blob:",
            "font-src 'self' data:",
            "media-src 'self' blob:",
            "worker-src 'self' blob:",
            f"connect-src 'self' http://{LOOPBACK}:{data_port}",
            "base-uri 'none'",
            "form-action 'none'",
        )
    )


@contextmanager
def served(page_port: int, data_port: int) -> Iterator[int]:
    """Serve the viewer's page, itself on ``page_port``, under the policy; the port it is at."""

    class Page(_Page):
        source, security = page_port, policy(data_port)

    with ThreadingHTTPServer((LOOPBACK, 0), Page) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
        thread.start()
        try:
            yield server.server_port
        finally:
            server.shutdown()
            thread.join()


class _Page(BaseHTTPRequestHandler):
    """One request, passed on to the viewer's own server."""

    source: int
    security: str
    timeout = TIMEOUT_S

    def do_GET(self) -> None:
        """A file of the viewer's. Another host's name for this machine gets none of them."""
        assert isinstance(self.server, ThreadingHTTPServer)
        port = self.server.server_port
        if self.headers.get("Host") not in (f"{LOOPBACK}:{port}", f"localhost:{port}"):
            self.send_error(403)
            return
        viewer = http.client.HTTPConnection(LOOPBACK, self.source, timeout=TIMEOUT_S)
        try:
            viewer.request("GET", self.path)
            self._answer(viewer.getresponse())
        except (http.client.HTTPException, ConnectionError, TimeoutError):
            self.close_connection = True  # the viewer, or the browser, has been closed
        finally:
            viewer.close()

    def _answer(self, answer: http.client.HTTPResponse) -> None:
        self.send_response(answer.status)
        for name in _PASSED_ON:
            if (value := answer.headers.get(name)) is not None:
                self.send_header(name, value)
        self.send_header("Content-Security-Policy", self.security)
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("X-DNS-Prefetch-Control", "off")
        self.end_headers()
        if (answer.headers.get("Content-Type") or "").startswith("text/html"):
            self.wfile.write(_LINK_ELSEWHERE.sub(b"", answer.read()))
        else:
            shutil.copyfileobj(answer, self.wfile)

    def log_message(self, format: str, *args: object) -> None:
        """Nothing is said of what is served."""
