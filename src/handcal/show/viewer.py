"""The Rerun viewer as a child process that listens on this machine alone.

The viewer's own launchers listen on every network interface; here the binary is
started with ``--bind 127.0.0.1`` and ends with the command that started it.

By itself it would also send usage statistics and ask for newer versions. It keeps no
statistics where it finds the variable CI, and asks through a proxy where one is named:
here that is a port of this machine on which nothing listens, so nothing leaves it. Its page
in a browser is kept to this machine by ``viewer_page``.
"""

from __future__ import annotations

import importlib.util
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import IO

from handcal.show import viewer_page
from handcal.types import HandcalError, InputError

LOOPBACK = "127.0.0.1"
START_S = 30.0
NOWHERE = f"http://{LOOPBACK}:9"  # the port of the discard service, which is off by default


@dataclass(frozen=True)
class Viewer:
    """A running viewer: where to send data, and where a browser finds it (web only)."""

    url: str
    web_url: str | None
    process: subprocess.Popen[bytes]

    def wait(self) -> None:
        """Until the person closes the viewer."""
        self.process.wait()


def require_display() -> None:
    """A sentence, as HandcalError, where no window can be opened."""
    display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform.startswith("linux") and not display:
        raise HandcalError(
            "There is no display here to open the viewer on: use --web to watch in a browser, "
            "or --no-viewer --rrd FILE.rrd to save what it would show."
        )


def binary() -> Path:
    """The viewer's executable, which comes with the rerun-sdk package."""
    spec = importlib.util.find_spec("rerun_cli")
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    path = Path(spec.origin).with_name(name) if spec and spec.origin else None
    if path is None or not path.exists():
        raise HandcalError("The Rerun viewer was not found: reinstall rerun-sdk.")
    return path


def _port(wanted: int | None) -> int:
    with socket.socket() as s:
        s.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            s.bind((LOOPBACK, wanted or 0))
        except (OSError, OverflowError) as e:
            raise InputError(f"Port {wanted} cannot be used: choose another with --port.") from e
        return int(s.getsockname()[1])


def _environment() -> dict[str, str]:
    """This process's variables, changed so that the viewer makes no other connections."""
    mine = {k: v for k, v in os.environ.items() if k != "FORCE_RERUN_ANALYTICS"}
    proxies = ("ALL_PROXY", "HTTPS_PROXY", "HTTP_PROXY")
    names = (name for proxy in proxies for name in (proxy, proxy.lower()))
    return mine | {"CI": "1", "NO_PROXY": "", "no_proxy": ""} | dict.fromkeys(names, NOWHERE)


@contextmanager
def viewer(
    *, web: bool = False, port: int | None = None, extra: tuple[str, ...] = ()
) -> Iterator[Viewer]:
    """Start the viewer, and end it whatever happens (an exception, Ctrl-C, SIGTERM).

    web: serve the viewer to a browser instead of opening a window. port: of the data
    (default any free one). extra: further options of the viewer, "--headless" in tests.
    """
    if not web and "--headless" not in extra:
        require_display()
    port = _port(port)
    web_port = _port(None) if web else None
    command = [
        str(binary()),
        "--bind",
        LOOPBACK,
        "--port",
        str(port),
        "--hide-welcome-screen",
        *extra,
    ]
    if web:
        command += ["--serve-web", "--web-viewer-port", str(web_port)]
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(
            command, stdout=said, stderr=said, stdin=subprocess.DEVNULL, env=_environment()
        )
        before = _on_terminate(_interrupt)
        try:
            _await(process, [p for p in (port, web_port) if p], said)
            url = f"rerun+http://{LOOPBACK}:{port}/proxy"
            with viewer_page.served(web_port, port) if web_port else nullcontext() as at:
                page = f"http://{LOOPBACK}:{at}/?url={url.replace('+', '%2B')}" if at else None
                yield Viewer(url, page, process)
        finally:
            _end(process)
            _on_terminate(before)


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _on_terminate(handler: object) -> object:
    """Install a SIGTERM handler where that is possible (the main thread); the one before."""
    try:
        return signal.signal(signal.SIGTERM, handler)  # type: ignore[arg-type]
    except (ValueError, TypeError):
        return None


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(5)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _await(process: subprocess.Popen[bytes], ports: list[int], said: IO[bytes]) -> None:
    """Until every port answers."""
    deadline = time.monotonic() + START_S
    for port in ports:
        while True:
            try:
                socket.create_connection((LOOPBACK, port), timeout=0.5).close()
                break
            except OSError:
                pass
            if process.poll() is not None or time.monotonic() > deadline:
                said.seek(0)
                last = said.read().decode(errors="replace").strip().splitlines()[-1:]
                raise HandcalError(
                    f"The Rerun viewer did not start: {' '.join(last) or 'no reason given'}"
                )
            time.sleep(0.05)
