"""The documentation site builds without a warning, all its links lead somewhere, and a browser that
reads it from the disk asks nobody for anything."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit

import pytest
import yaml

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ROOT = Path(__file__).resolve().parents[1]
OF_THE_ROOT = {
    "readme.md", "changelog.md", "contributing.md", "security.md", "code-of-conduct.md",
}  # fmt: skip


def listed(nav) -> list[str]:
    """Pages of a part of the navigation."""
    if isinstance(nav, str):
        return [nav]
    return [
        page for part in (nav.values() if isinstance(nav, dict) else nav) for page in listed(part)
    ]


def test_every_page_and_notebook_is_in_the_navigation():
    """If not: a line in mkdocs.yml."""
    nav = listed(yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"])
    docs = ROOT / "docs"
    pages = {p.relative_to(docs).as_posix() for p in docs.rglob("*.md")}
    for folder in ("gallery", "dev/decisions"):
        listed_there = {p for p in pages if p.startswith(f"{folder}/")}
        pages -= listed_there - {f"{folder}/index.md"}
    notebooks = {p.with_suffix(".md").name for p in docs.glob("*.ipynb")}
    assert set(nav) == pages | notebooks | OF_THE_ROOT


@pytest.fixture(scope="session")
def site(tmp_path_factory) -> Path:
    """The site, built of the files that git knows and nothing else."""
    if importlib.util.find_spec("mkdocs") is None:
        pytest.skip("mkdocs is not installed: make site")
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("this is no checkout")
    folder = tmp_path_factory.mktemp("site")
    known = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True)
    for name in known.stdout.decode().rstrip("\0").split("\0"):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / name)
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict"],
        cwd=folder, capture_output=True, text=True, check=False,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
    )  # fmt: skip
    assert built.returncode == 0, built.stderr
    return folder / "site"


class Page(HTMLParser):
    """What a page links to, what it loads, and the names in it."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.names: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        known = dict(attrs)
        self.names |= {v for k in ("id", "name") if (v := known.get(k))}
        if tag == "a" and known.get("href"):
            self.links.append(known["href"])
        elif address := known.get("src") or known.get("href"):
            self.loads.append(address)


@pytest.mark.prove
def test_links_lead_somewhere_and_nothing_comes_from_outside(site: Path) -> None:
    pages = {p.resolve(): Page(p) for p in site.rglob("*.html")}
    assert len(pages) > 40
    wrong = []
    for path, page in pages.items():
        wrong += [(path.name, a) for a in page.loads if urlsplit(a).scheme not in ("", "data")]
        if path.name == "404.html":  # (its links are those of a server's root)
            continue
        for address in (*page.links, *page.loads):
            parts = urlsplit(address)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            anchor = unquote(parts.fragment)
            if not target.exists() or (anchor and anchor not in pages[target].names):
                wrong.append((path.name, address))
    assert wrong == []
    assert [p.name for p in site.rglob("*.css") if "//fonts." in p.read_text("utf-8")] == []


@pytest.mark.prove
def test_a_browser_reads_it_from_the_disk(browser: Browser, site: Path) -> None:
    """On a phone and on a screen: nothing is asked for, no page is wider than the window, and the
    search finds."""
    wrong: list[str] = []
    tab = browser.new_context(offline=True).new_page()
    tab.on("console", lambda m: wrong.append(m.text) if m.type == "error" else None)
    tab.on("pageerror", lambda e: wrong.append(str(e)))
    here = ("file:", "data:", "about:", "blob:")
    tab.on("request", lambda r: None if r.url.startswith(here) else wrong.append(r.url))
    for width in (390, 1280):
        tab.set_viewport_size({"width": width, "height": 900})
        for path in sorted(site.rglob("*.html")):
            if path.name == "404.html":
                continue
            tab.goto(path.as_uri())
            wide = tab.evaluate("document.documentElement.scrollWidth")
            if wide > width:
                wrong.append(f"{path.name} is {wide} wide at {width}")
    tab.goto((site / "index.html").as_uri())
    tab.click(".md-search__input")
    tab.keyboard.type("lever arm")
    tab.wait_for_selector(".md-search-result__article", timeout=10_000)
    assert wrong == []
