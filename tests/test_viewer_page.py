"""The viewer's page in a real browser: it works, and no request leaves this machine."""

from __future__ import annotations

import http.client
import socket
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest
import rerun as rr
from browsers import chromium
from fake_result import fake_frames, fake_result
from playwright.sync_api import Browser, Error

from handcal.show import dashboard, frames
from handcal.show.viewer import Viewer, viewer

ALONE = ["--disable-background-networking", "--disable-component-update"]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium(*ALONE, "--use-gl=angle", "--use-angle=swiftshader") as started:
        yield started


@pytest.fixture
def shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Viewer]:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    with viewer(web=True) as running:
        yield running


def test_no_request_of_the_page_leaves_this_machine(browser: Browser, shown: Viewer) -> None:
    """Every request is recorded, and those to other hosts are seen to fail in the browser
    itself, before anything that this test does could stop them."""
    result = fake_result(extra=False)
    page = browser.new_page()
    asked: list[str] = []
    ended: dict[str, str] = {}
    arrived: list[str] = []
    page.on("request", lambda r: asked.append(r.url))
    page.on("requestfailed", lambda r: ended.update({r.url: str(r.failure)}))
    page.on("response", lambda r: arrived.append(r.url))
    assert shown.web_url is not None
    page.goto(shown.web_url)
    page.wait_for_selector("#the_canvas_id.visible", timeout=60_000)
    steps = list(fake_frames(result))[:30]
    dashboard.stream(steps, frames.layout_of(result), [rr.GrpcSink(shown.url)], speed=0)
    page.wait_for_timeout(3000)  # statistics are sent, and versions asked for, after the start

    left = [url for url in asked if urlsplit(url).hostname not in ("127.0.0.1", None)]
    assert asked
    assert all("csp" in ended.get(url, "").lower() for url in left), (left, ended)
    assert not set(left) & set(arrived)
    port = urlsplit(shown.url.removeprefix("rerun+")).port
    assert any(urlsplit(url).port == port for url in arrived), "no data reached the page"
    page.close()


@pytest.mark.parametrize(
    "attempt",
    [
        "fetch('http://{}/')",
        "new Promise((ok, no) => {{ const i = new Image(); i.onload = ok; i.onerror = no;"
        " i.src = 'http://{}/x.png'; }})",
        "new Promise((ok, no) => {{ const s = new WebSocket('ws://{}/');"
        " s.onopen = ok; s.onerror = no; }})",
        "new Promise((ok, no) => {{ const s = document.createElement('script');"
        " s.onload = ok; s.onerror = no; s.src = 'http://{}/x.js'; document.body.append(s); }})",
    ],
)
def test_the_browser_refuses_what_the_page_may_not(
    browser: Browser, shown: Viewer, attempt: str
) -> None:
    """Another port of this machine stands for another host: it must never be reached."""
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        other.settimeout(0.5)
        page = browser.new_page()
        assert shown.web_url is not None
        page.goto(shown.web_url, wait_until="domcontentloaded")
        tried = attempt.format(f"127.0.0.1:{other.getsockname()[1]}")
        with pytest.raises(Error):
            page.evaluate(f"Promise.race([{tried}, new Promise(ok => setTimeout(ok, 2000))])")
        page.close()
        with pytest.raises(TimeoutError):
            other.accept()


def _get(shown: Viewer, host: str | None = None) -> http.client.HTTPResponse:
    parts = urlsplit(shown.web_url or "")
    connection = http.client.HTTPConnection(parts.hostname or "", parts.port, timeout=10)
    connection.request("GET", "/", headers={"Host": host} if host else {})
    return connection.getresponse()


def test_the_page_names_no_other_host_and_answers_to_no_other_name(shown: Viewer) -> None:
    page = _get(shown)
    text = page.read().decode()
    assert "<link" in text
    assert "fonts.g" not in text
    assert "default-src 'none'" in (page.headers["Content-Security-Policy"] or "")
    assert _get(shown, "somewhere.example").status == 403
