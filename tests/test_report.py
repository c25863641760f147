"""The HTML report: whole in one file, right in its numbers, and drawn by a browser."""

import re
from dataclasses import replace

import numpy as np
import pytest
from fake_result import fake_result

from handcal.show import drawing
from handcal.show.calibration import report
from handcal.types import Parameter


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    report.write_report(fake_result(hidden=True), path)
    return path


def test_the_page_is_whole_and_small(page):
    text = page.read_text(encoding="utf-8")
    assert len(text.encode()) < 1_500_000
    assert "http://" not in text
    assert "https://" not in text
    assert not re.search(r"(?:src|href)=\"(?!#)", text)
    assert "<script" not in text
    ids = re.findall(r'\bid="([^"]*)"', text)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'href="#([^"]*)"', text)) | set(
        re.findall(r"url\(#([^)]*)\)", text)
    ) <= set(ids)


def test_the_page_says_what_the_result_says(page):
    text = page.read_text(encoding="utf-8")
    for part in (
        "hand-motion.mcap",
        "12 of 13",
        "+0.6933",
        "gyro g-sensitivity",
        "3 readings of the",
        "consistent",
    ):
        assert part in text
    learnt = text.split("What was learnt</h2>")[1].split("</table>")[0]
    assert learnt.count("<tr>") == 1 + len(fake_result().parameters)
    for colour in drawing.PALETTE:
        assert colour not in text.split("</style>")[1]


def test_names_from_a_file_are_text_and_not_markup():
    result = fake_result(extra=False)
    recording = replace(result.recording, path="<img src=x onerror=alert(1)>.mcap")
    html = report.render(replace(result, recording=recording, warnings=("<b>bold</b>",)))
    assert "<img" not in html
    assert "<b>bold" not in html


@pytest.mark.parametrize(
    "effects",
    [
        (),
        ("gyro_scale", "gyro_misalignment"),
        ("accel_scale", "accel_misalignment"),
        ("gyro_g_sensitivity", "gyro_scale"),
    ],
)
def test_the_printed_python_undoes_the_errors(effects):
    """Readings made by the contract's definitions come back as the truth."""
    rng = np.random.default_rng(2)
    names = {
        "gyro_scale": "x y z",
        "accel_scale": "x y z",
        "gyro_misalignment": "xy xz yx yz zx zy",
        "accel_misalignment": "yx zx zy",
        "gyro_g_sensitivity": "xx xy xz yx yy yz zx zy zz",
    }
    result = fake_result(extra=False)
    extra = [
        Parameter(e, n, float(f"{rng.normal(0, 0.01):.5f}"), 1e-4, "1", 0.01, None)
        for e in effects
        for n in names[e].split()
    ]
    result = replace(result, parameters=(*result.parameters, *extra))
    omega, f = rng.normal(0, 2, (50, 3)), rng.normal(0, 9, (50, 3))
    gyro, accel = omega.copy(), f.copy()
    for p in result.parameters:
        i, j = "xyz".index(p.name[0]), "xyz".index(p.name[-1])
        target, cause = (accel, f) if p.effect.startswith("accel") else (gyro, omega)
        cause = f if p.effect == "gyro_g_sensitivity" else cause
        target[:, i] += p.value * (1.0 if p.effect.endswith("bias") else cause[:, j])
    scope = {"gyro": gyro, "accel": accel}
    exec(report.apply_code(result), scope)
    np.testing.assert_allclose(scope["gyro_true"], omega, atol=1e-9)
    np.testing.assert_allclose(scope["accel_true"], f, atol=1e-9)


def test_a_result_with_next_to_nothing_in_it_still_has_a_page():
    result = fake_result(heading=False, extra=False)
    empty = {k: replace(i, t=i.t[:0], residual=i.residual[:0], sigma=i.sigma[:0], nis=i.nis[:0])
             for k, i in result.innovations.items()}  # fmt: skip
    html = report.render(
        replace(result, innovations=empty, noise=(), rests=np.zeros((0, 2)), warnings=())
    )
    assert "no data" in html
    assert "Warnings" not in html


def test_lines_and_bands_end_where_nothing_was_read():
    t = np.r_[np.arange(0.0, 3.0, 0.01), np.arange(8.0, 9.0, 0.01)]
    gaps = drawing.gaps_of(t)
    assert gaps.round(2).tolist() == [[2.99, 8.0]]
    at, y, band = drawing.broken(t[::7], gaps, np.sin(t[::7]), np.ones((len(t[::7]), 3)))
    (hole,) = np.flatnonzero(np.isnan(y))
    assert 2.9 < at[hole - 1] < 3.0 < at[hole] < 8.0 <= at[hole + 1]
    assert np.isnan(band[hole]).all()
    assert len(drawing.broken(t[:5], gaps, t[:5])[0]) == 5


def test_thinning_keeps_the_peaks():
    t = np.arange(100_000) * 0.01
    y = np.sin(t)
    y[54_321] = 9.0
    thin_t, thin_y = drawing.envelope(t, y)
    assert len(thin_t) < 2 * drawing.POINTS + 4
    assert thin_y.max() == 9.0
    assert np.all(np.diff(thin_t) > 0)


@pytest.mark.parametrize(("width", "scheme"), [(1100, "light"), (375, "dark")])
def test_a_browser_without_network_draws_it_without_complaint(browser, page, width, scheme):
    context = browser.new_context(
        offline=True, viewport={"width": width, "height": 800}, color_scheme=scheme
    )
    tab = context.new_page()
    said, asked = [], []
    tab.on("console", lambda m: said.append(m.text))
    tab.on("pageerror", lambda e: said.append(str(e)))
    tab.on("request", lambda r: asked.append(r.url))
    tab.goto(page.as_uri())
    assert said == []
    assert asked == [page.as_uri()]
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    boxes = tab.evaluate(
        "[...document.querySelectorAll('svg')].map(s => s.getBoundingClientRect().height)"
    )
    assert len(boxes) == 13
    assert min(boxes) > 100
    context.close()
