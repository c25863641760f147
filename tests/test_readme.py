"""What README and the pages tell to type can be typed, and README's output is what comes."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest
import yaml
from test_docs import PAGES, ROOT
from typer.testing import CliRunner

from handcal.commands import _app

README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(text: str) -> list[str]:
    """Fenced code without a language (or of a shell): what is typed and what comes."""
    return re.findall(r"^```(?:sh|bash|text)?\n(.*?)^```$", text, re.M | re.S)


def typed(page: Path) -> list[list[str]]:
    """The arguments of every `handcal ...` line in the page's code."""
    lines = [s for b in blocks(page.read_text("utf-8")) for s in b.splitlines()]
    lines = [s.removeprefix(".venv/bin/") for s in lines]
    return [shlex.split(s, comments=True)[1:] for s in lines if s.startswith("handcal ")]


def understood(arguments: list[str]) -> bool:
    """Whether there are such a command and such options; files need not be there."""
    return CliRunner().invoke(_app.app, [*arguments, "--help"]).exit_code == 0


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_what_a_page_tells_to_type_is_understood(page):
    assert [a for a in typed(page) if not understood(a)] == []


def test_a_wrong_option_is_noticed():
    assert not understood(["explain", "my.mcap", "--no-such-option"])
    assert not understood(["no-such-command"])


@pytest.mark.prove
def test_the_three_commands_work_and_the_output_is_what_comes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROOT / "recordings/sealed_10.mcap", "my-recording.mcap")
    three = [a for a in typed(ROOT / "README.md") if "my-recording.mcap" in a]
    assert [a[0] for a in three] == ["info", "explain", "apply"]
    printed = {}
    for arguments in three:
        done = CliRunner().invoke(_app.app, arguments)
        assert done.exit_code == 0, done.output
        said = done.stdout.replace("\u00a0", " ")  # (a space that does not break)
        printed[arguments[0]] = [s.strip() for s in said.splitlines()]
    assert (tmp_path / "why.html").exists()
    assert (tmp_path / "corrected.mcap").exists()
    (shown,) = [b for b in blocks(README) if "Found: " in b]
    shown = shown.replace("sealed_10.mcap", "my-recording.mcap")
    lines = [s.strip() for s in shown.splitlines() if s.strip() not in ("", "...")]
    assert [s for s in lines if s not in printed["explain"]] == []


def test_the_forms_and_workflows_say_what_they_have_to():
    folder = ROOT / ".github"
    if not folder.exists():
        pytest.skip("this is no checkout")
    read = {p.name: yaml.safe_load(p.read_text("utf-8")) for p in folder.rglob("*.yml")}
    labels = [str(f["attributes"].get("label")) for f in read["bug_report.yml"]["body"]]
    assert any("handcal info --json" in label for label in labels)
    matrix = read["test.yml"]["jobs"]["test"]["strategy"]["matrix"]
    assert matrix["python"] == ["3.11", "3.12", "3.13", "3.14"]
    assert {name.split("-")[0] for name in matrix["os"]} == {"ubuntu", "macos", "windows"}
    publish = read["release.yml"]["jobs"]["publish"]
    assert publish["permissions"] == {"id-token": "write"}
    assert publish["needs"] == "test"
