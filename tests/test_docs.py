"""What is written by code is what the code would write now, and links lead somewhere."""

import importlib.util
import json
import re
import sys
from pathlib import Path

import pytest

from handcal.effects import catalogue
from handcal.recordings import inputs

ROOT = Path(__file__).resolve().parents[1]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]


def made(name="make_effects"):
    """A script of docs/ as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / f"docs/{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def apart(page):
    """A page's words and its numbers."""
    number = r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?"
    return re.sub(number, "#", page), [float(x) for x in re.findall(number, page)]


def test_the_catalogue_page_is_what_the_effects_say():
    """If not: `make docs`, or docs/make_effects.py alone."""
    page = made().page()
    assert (ROOT / "docs" / "effects.md").read_text(encoding="utf-8") == page
    for effect in catalogue().values():
        assert page.count(f"\n`{effect.id}={effect.parameters[0].name}") == 1
        for text in (effect.title, effect.story, effect.motion, effect.source):
            assert text in page


def test_the_page_of_formats_is_what_the_formats_say():
    """If not: `make docs`, or docs/make_formats.py alone."""
    page = made("make_formats")
    assert (ROOT / "docs" / "formats.md").read_text(encoding="utf-8") == page.page()
    for module in inputs.formats():
        assert all(getattr(module, name, "") for name in ("UNITS", "STREAMS_READ", "TRIED")), module


def test_there_is_a_page_for_each_export_and_it_is_what_the_export_writes():
    """If not: `make docs`, or docs/make_use.py alone."""
    pages = made("make_use").pages()
    folder = ROOT / "docs" / "use"
    assert {p.name for p in folder.iterdir()} == set(pages)
    commands = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    for name, page in pages.items():
        kept, numbers = apart((folder / name).read_text(encoding="utf-8"))
        text, others = apart(page)
        assert kept == text
        # (the last digits of a matrix product differ between processors)
        assert numbers == pytest.approx(others, rel=1e-9, abs=1e-12)
        assert f"(use/{name})" in commands


def test_the_page_of_results_is_what_the_schemas_say():
    """If not: `make docs`, or docs/make_results.py alone. Every part that is linked is there."""
    page = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
    assert page == made("make_results").page()
    parts = {f"part-{name}" for name in re.findall(r"^### Part: (\S+)$", page, re.M)}
    assert set(re.findall(r"\(#(part-[^)]+)\)", page)) <= parts


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_and_pictures_of_the_documents_exist(page):
    text = page.read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", text) + re.findall(r'src="([^"]+)"', text)
    here = [t for t in targets if "://" not in t]
    assert [t for t in here if not (page.parent / t).exists()] == []


def test_nothing_says_to_install_from_an_index_that_does_not_have_it():
    """Whoever takes the name there would be installed."""
    code = [
        p for folder in ("src", "sim", "tests", "scripts") for p in (ROOT / folder).rglob("*.py")
    ]
    said = re.compile(r"pip install [^`\n]*\bhandcal\b(?!/)|install `handcal\[")
    found = [p for p in (*PAGES, *code) if said.search(p.read_text("utf-8"))]
    assert [p for p in found if p != Path(__file__)] == []


KIND = re.compile(r"\*(For developers: )?(tutorial|how-to|explanation|reference)\.\*", re.I)


def test_every_page_says_first_which_kind_it_is():
    """Tutorial, how-to, explanation or reference, in the first line below the title."""
    docs = ROOT / "docs"
    pages = {p: p.read_text(encoding="utf-8") for p in docs.rglob("*.md")}
    for path in docs.glob("*.ipynb"):
        first = json.loads(path.read_text(encoding="utf-8"))["cells"][0]
        pages[path] = "".join(first["source"])
    below = {p: text.partition("\n\n")[2] for p, text in pages.items()}
    assert [p.name for p, text in below.items() if not KIND.match(text)] == []


def test_the_glossary_is_short_and_in_order():
    text = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    terms = re.findall(r"^\| ([^|]+?) \|", text, re.M)[2:]
    assert 30 < len(terms) <= 60
    assert terms == sorted(terms, key=str.casefold)


def test_the_paper_has_its_pictures_and_cites_what_its_references_have():
    text = (ROOT / "paper" / "paper.md").read_text(encoding="utf-8")
    references = (ROOT / "paper" / "paper.bib").read_text(encoding="utf-8")
    cited = set(re.findall(r"@(\w+)", text))
    assert cited == set(re.findall(r"^@\w+\{(\w+),", references, re.M))
    pictures = re.findall(r"\]\((\.\./[^)]+)\)", text)
    assert pictures
    assert all((ROOT / "paper" / p).exists() for p in pictures)


def test_pictures_are_small():
    for picture in (ROOT / "docs" / "images").iterdir():
        assert picture.stat().st_size < 200_000, picture.name


def test_every_command_has_its_line():
    """Commands of packages (`lab`, `device`, `design`) too."""
    page = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    files = [p for f in ("src/handcal", "sim/handcal_sim") for p in (ROOT / f).rglob("*.py")]
    files = [p for p in files if "commands" in p.parts and not p.name.startswith("_")]
    said = [p.stem.strip("_").replace("_", "-") for p in files]
    assert len(said) > 20
    assert [n for n in said if not re.search(rf"`(handcal )?([a-z]+ )?{n}[ `]", page)] == []


def test_the_readme_is_short():
    words = (ROOT / "README.md").read_text(encoding="utf-8").split()
    assert len(words) <= 900


def test_the_picture_of_the_code_is_what_the_layers_are():
    """If not: `make docs`, or docs/make_layers.py alone."""
    script = made("make_layers")
    assert script.PICTURE.read_text(encoding="utf-8") == script.picture()


# The changelog names files of older versions, contributing those of its examples.
OF_NOW = [p for p in PAGES if p.name not in ("CHANGELOG.md", "CONTRIBUTING.md")]


@pytest.mark.parametrize("page", OF_NOW, ids=lambda p: p.name)
def test_files_that_the_documents_name_exist(page):
    named = set(re.findall(r"`([a-z_/]+\.py)`", page.read_text(encoding="utf-8")))
    places = [ROOT, ROOT / "docs", ROOT / "src/handcal", *(ROOT / "src/handcal").glob("estimate"),
              ROOT / "sim/handcal_sim", ROOT / "sim/handcal_sim/prove"]  # fmt: skip
    missing = [n for n in sorted(named) if not any((p / n).exists() for p in places)]
    assert missing == []


# Of each notebook, what its outputs have to say.
NOTEBOOKS = {
    "python": ("gyro scale", "image/png"),
    "conceal": ("nothing_missing", "gyro scale error", "accelerometer delay", "image/png"),
    "heading": ("Gyro bias, deg/h", "bound, deg/h", "image/png"),
    "own-effect": ("rectifies the turning about x", "image/png"),
}


def test_every_notebook_is_run():
    assert {p.stem for p in (ROOT / "docs").glob("*.ipynb")} == set(NOTEBOOKS)


@pytest.mark.prove
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_the_notebook_runs(name):
    """Every cell, from the first to the last; and it shows what it is about."""
    page = made("make_notebook").executed(ROOT / "docs" / f"{name}.ipynb")
    shown = str([o for c in page.cells if c.cell_type == "code" for o in c.outputs])
    assert [said for said in NOTEBOOKS[name] if said not in shown] == []


def test_the_page_of_profiles_leaves_out_what_is_small():
    versions = dict.fromkeys(("handcal", "numpy", "numba"), "1")
    machine = {"python": "3.11", "cores": 2, "versions": versions}
    profile = {"group": "start", "title": "calibrate 30 s", "asked_by": {"search": 10.0},
               "doing": {"importing numba": 3.8, "estimate.fit": 6.0, "effects": 0.2}}  # fmt: skip
    page = made("make_profiles").page({"machine": machine, "profiles": [profile]})
    line = "| calibrate 30 s | 10 | estimate.fit 60 %<br>importing numba 38 % | search 100 % |"
    assert page.endswith(f"\n{line}\n")
    assert "`start`" in page
