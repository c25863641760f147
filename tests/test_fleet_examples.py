"""The examples of docs/fleet.md, run on a data set."""

from __future__ import annotations

import contextlib
import io
import re
from pathlib import Path

import pytest

from handcal.fleet import dataset
from handcal.fleet.record import Source

TEXT = (Path(__file__).resolve().parents[1] / "docs/fleet.md").read_text("utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)


@pytest.mark.parametrize("library", ["pandas", "polars", "duckdb"])
def test_an_example_reads_what_was_written(library, tmp_path, monkeypatch):
    pytest.importorskip(library, reason=f"{library} is not installed: make setup-dev")
    told = [
        {"effect": "gyro_scale", "name": "x", "value": value, "sigma": 1e-3, "unit": "1",
         "prior_sigma": 0.01, "together": True}
        for value in (0.001, 0.25, 0.5)
    ]  # fmt: skip
    rows = [
        (Source(f"r{i}", model, f"d{i}"), {"status": "done", "reason": "", "told": [t]})
        for i, (model, t) in enumerate(zip(("one", "one", "a model"), told, strict=True))
    ]
    dataset.write(tmp_path / "fleet", iter(rows))
    monkeypatch.chdir(tmp_path)
    (example,) = (e for e in EXAMPLES if f"import {library}" in e)
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(compile(example, "docs/fleet.md", "exec"), {})
    assert "0.1255" in said.getvalue()
    assert "a model" in said.getvalue().replace("a%20model", "a model")
