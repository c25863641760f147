"""docs/gallery/ shows only what its licence allows, in small pictures that load nothing, and a
miss is a miss."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[1]
GALLERY = ROOT / "docs" / "gallery"


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("make_gallery", ROOT / "docs/make_gallery.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_every_recording_has_a_licence_that_allows_figures(script):
    for entry in script.entries():
        assert re.search(r"; (CC BY 4\.0|MIT licence|BSD licence)$", entry["source"]), entry["name"]
        assert ("known" in entry) == ("known_from" in entry), entry["name"]


def test_every_page_is_of_a_listed_recording_and_stands_in_the_overview(script):
    pages = {p.stem for p in GALLERY.glob("*.md")} - {"index"}
    assert pages <= {e["name"] for e in script.entries()}
    overview = (GALLERY / "index.md").read_text(encoding="utf-8")
    assert set(re.findall(r"\]\((\w+)\.md\)", overview)) == pages
    for entry in script.entries():
        assert entry["title"] in overview, entry["name"]


def test_pictures_are_small_and_load_nothing():
    pictures = sorted(GALLERY.glob("*.svg"))
    assert sum(p.stat().st_size for p in pictures) < 1_000_000
    shown = "".join(p.read_text(encoding="utf-8") for p in GALLERY.glob("*.md"))
    for picture in pictures:
        assert picture.stat().st_size < 60_000, picture.name
        assert f"({picture.name})" in shown
        text = picture.read_text(encoding="utf-8")
        assert "var(" not in text
        for element in ElementTree.fromstring(text).iter():
            for name, value in element.attrib.items():
                if name.endswith("href"):
                    assert value.startswith("#"), picture.name


FACT = {"effect": "lever_arm", "names": "x y z", "values": [0.02, 0.0, 0.03], "within": 0.001}


def document(*found, untellable=()):
    """A result with a lever arm of these (name, value, sigma), and a gyro's lag of 2 ms."""
    keys = ("name", "value", "sigma")
    arm = [{"effect": "lever_arm", **dict(zip(keys, f, strict=True))} for f in found]
    lag = {"effect": "gyro_bandwidth", "name": "tau", "value": 0.002, "sigma": 1e-4, "unit": "s"}
    hidden = [{"effect": "lever_arm", "name": n} for n in untellable]
    return {"parameters": [*arm, lag], "untellable": hidden}


def test_a_miss_is_a_miss(script):
    def words(d):
        return [row["word"] for row in script.judged(FACT, d)]

    near, far, vague = ("x", 0.0205, 2e-4), ("x", 0.0215, 2e-4), ("x", 0.0205, 2e-3)
    assert words(document(near)) == ["right", "not named", "missed"]
    assert words(document(far, untellable="z")) == ["missed", "not named", "not told"]
    assert words(document(vague, ("y", 0.002, 1e-4), ("z", 0.03, 1e-4))) == [
        "not told", "missed", "right",
    ]  # fmt: skip
    assert "| 20.0 ± 1.0 mm | 21.50 ± 0.20 mm | **missed** |" in script.facts_table(
        script.judged(FACT, document(far))
    )


def test_a_lag_of_the_gyro_is_taken_off_a_delay(script):
    fact = {"effect": "pose_delay", "names": "delay", "values": [-0.004], "within": 0.001,
            "less": "gyro_bandwidth tau"}  # fmt: skip
    d = document()
    d["parameters"].append(
        {"effect": "pose_delay", "name": "delay", "value": -0.002, "sigma": 1e-4, "unit": "s"}
    )
    (row,) = script.judged(fact, d)
    assert row["word"] == "right"
    assert row["found"] == pytest.approx(-0.004)


def test_where_it_differed_and_how_the_fit_improved_is_told(script):
    spans = [{"channel": c, "from_s": 1.0, "to_s": 2.0, "when": "throughout", "share": s}
             for c, s in (("gyro_x", 0.2), ("position_z", 0.8))]  # fmt: skip
    told = script.differed({"mismatch": spans}).splitlines()
    assert [line.split(" | ")[0] for line in told[2:]] == ["| position z", "| gyro x"]
    fits = [{"log_evidence": e, "residual_rms": {"gyro_x": 0.01, "position_z": r}}
            for e, r in ((-10.0, 0.01), (20.0, 0.001))]  # fmt: skip
    fit = dict(zip(("before", "after"), fits, strict=True))
    told = script.improved({"mismatch": spans, "fit": fit})
    assert "| position z | 10.0 | 1.0 mm |" in told
    assert "30\u00a0nats more probable" in told
