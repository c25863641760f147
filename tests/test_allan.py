"""Known noise is found again within its own sigma; the estimator against allantools; refusals."""

import json
import math
import re
from dataclasses import replace

import allantools
import numpy as np
import pytest
from lab_world import command as typed
from proved import proved

import handcal
from handcal.allan import analysis, overlapping, terms
from handcal.commands.allan import _span
from handcal.commands.allan import allan as command
from handcal.recordings.export import write_mcap
from handcal.recordings.inputs import load
from handcal.show.allan import allan_json, write_allan_report
from handcal.types import HandcalError, Imu, InputError, Recording

RATE = 100.0
N = np.array([1e-3] * 3 + [5e-3] * 3)
K = np.array([3e-4] * 3 + [1.5e-3] * 3)


def recording(seed, n=2**15, walk=True, seconds_of_motion=0.0):
    rng = np.random.default_rng(seed)
    x = N * math.sqrt(RATE) * rng.standard_normal((n, 6))
    if walk:
        x += np.cumsum(K / math.sqrt(RATE) * rng.standard_normal((n, 6)), axis=0)
    x[:, 5] += 9.80665
    moved = int(seconds_of_motion * RATE)
    x[:moved] += rng.standard_normal((moved, 6)) * 3.0
    return Recording("still.mcap", Imu(np.arange(n) / RATE, x[:, :3], x[:, 3:], np.ones(n, bool)))


@pytest.fixture(scope="module")
def analysed():
    return [analysis.analyse(recording(seed), (0.0, 1e4)) for seed in range(3)]


def test_white_noise_and_random_walk_are_found_within_theory(analysed):
    """18 channels. Four sigma; and sigma itself is what theory allows of such a record.

    N: an average of 2**15 squares cannot do better than 1 / sqrt(2 * 2**15) = 0.4 %. K: its
    knee is at sqrt(3) N / K = 5.8 s; some 30 independent stretches of twice that: 10 to 40 %.
    """
    walks = 0
    for result in analysed:
        for c, n, k in zip(result.channels, N, K, strict=True):
            white = c.term("N")
            assert abs(white.value - n) < 4 * white.sigma
            assert 0.0039 * n < white.sigma < 0.012 * n
            if walk := c.term("K"):
                walks += 1
                assert abs(walk.value - k) < 4 * walk.sigma
                assert 0.1 < walk.sigma / walk.value < 0.4
    assert walks >= 16


def test_white_noise_alone_shows_nothing_else_and_bounds_hold():
    result = analysis.analyse(recording(0, walk=False))
    for c in result.channels:
        assert [t.name for t in c.terms] == ["N"]
        assert {b.name for b in c.unseen} == {"Q", "B", "K", "R"}
        assert all(0 < b.at_most < math.inf for b in c.unseen)
        # a walk as large as that of the other recordings would have been seen
        assert (
            next(b for b in c.unseen if b.name == "K").at_most < K[analysis.CHANNELS.index(c.name)]
        )
    assert [s.name for s in result.suggested] == ["gyro_noise", "accel_noise"]
    assert result.warnings == ()


@pytest.mark.parametrize("name", ["Q", "B", "K", "R"])
def test_exact_curves_give_exact_coefficients(name):
    factors, freedom = analysis.averaging(2**17)
    octaves = np.isin(factors, 2.0 ** np.arange(40))
    tau = factors[octaves] / RATE
    value = {"N": 1e-3, name: {"Q": 1e-4, "B": 1e-3, "K": 1e-3, "R": 1e-4}[name]}
    laws = {n: (terms.LAWS[n][0] * v**2, terms.LAWS[n][1]) for n, v in value.items()}
    fit = terms.Fit(tau, sum(a * tau**p for a, p in laws.values()), freedom[:, octaves])
    found = fit.select()
    assert [terms.TERMS[k] for k in found] == sorted(laws, key=terms.TERMS.index)
    for k in found:
        assert fit.solve(found)[k] == pytest.approx(laws[terms.TERMS[k]][0], rel=1e-6)


def test_the_deviation_is_that_of_allantools_and_of_its_definition(analysed):
    r = analysed[0]
    x = np.column_stack([r.recording.imu.gyro, r.recording.imu.accel])
    for i, c in enumerate(r.channels):
        tau, dev, _, _ = allantools.oadev(x[:, i], rate=RATE, data_type="freq", taus=c.tau)
        np.testing.assert_allclose(c.tau, tau, rtol=1e-9)
        np.testing.assert_allclose(c.deviation, dev, rtol=1e-9)
        phase = np.r_[0.0, np.cumsum(x[:, i] - x[:, i].mean())] / RATE
        for k in (0, 5, -1):
            m = round(c.tau[k] * RATE)
            second = phase[2 * m :] - 2 * phase[m:-m] + phase[: -2 * m]
            expected = math.sqrt((second**2).mean() / 2) / c.tau[k]
            assert c.deviation[k] == pytest.approx(expected, rel=1e-9)
        assert np.all((c.low < c.deviation) & (c.deviation < c.high))


@pytest.mark.parametrize(("noise", "alpha"), [("white", 0), ("flicker", -1), ("walk", -2)])
def test_degrees_of_freedom_and_bands_are_those_of_allantools(noise, alpha):
    """Greenhall's formula is for bandlimited noise; sampled noise differs by 1/m, or its square.

    Beyond 100 steps allantools takes its sum at 100 and rounds its tables to three digits.
    """
    for n in (1000, 2**15):
        for m in (64, 100, n // 10, n // 4):
            theirs = float(allantools.edf_greenhall(alpha, 2, m, n + 1, overlapping=True))
            ours = overlapping.freedom(noise, m, n)
            assert ours == pytest.approx(theirs, rel=0.003 if m > 64 else 1.0 / m)
    edf, dev = np.array([2.3, 17.0, 4000.0]), np.array([1.0, 2e-4, 3.0])
    low, high = overlapping.band(dev, edf, 0.95)
    for d, e, a, b in zip(dev, edf, low, high, strict=True):
        np.testing.assert_allclose((a, b), allantools.confidence_interval(d, e, ci=0.95))


def test_degrees_of_freedom_of_a_sampled_walk_are_exact():
    """From the covariance of its second differences, term by term."""
    n, m = 60, 5
    weight = np.zeros(n)
    weight[:m], weight[m : 2 * m] = 1.0, -1.0
    rows = np.array([np.roll(weight, k) for k in range(n - 2 * m + 1)])
    steps = rows @ np.tril(np.ones((n, n)))
    covariance = steps @ steps.T
    exact = np.trace(covariance) ** 2 / (covariance**2).sum()
    assert overlapping.freedom("walk", m, n) == pytest.approx(exact, rel=1e-9)


def test_a_record_too_short_for_an_averaging_time_is_a_sentence():
    with pytest.raises(HandcalError, match="too short"):
        overlapping.deviation(np.arange(9.0), 1.0, np.array([5.0]))


def test_degrees_of_freedom_are_those_of_white_noise():
    """Scatter of the variance over 400 draws, its sigma 1/sqrt(2 * 400) = 3.5 %; four of them."""
    n = 1024
    factors, freedom = analysis.averaging(n)
    draws = [overlapping.deviation(np.random.default_rng(s).standard_normal(n), 1.0, factors) ** 2
             for s in range(400)]  # fmt: skip
    seen = 2 * np.mean(draws, axis=0) ** 2 / np.var(draws, axis=0, ddof=1)
    np.testing.assert_allclose(np.sqrt(seen / freedom[0])[:12], 1.0, atol=0.15)


def test_the_longest_rest_is_taken_and_moved_devices_are_refused():
    result = analysis.analyse(recording(1, 2**14, walk=False, seconds_of_motion=20.0))
    assert result.span[0] == pytest.approx(20.0, abs=1.0)
    with pytest.raises(HandcalError, match="longest rest lasts"):
        analysis.analyse(recording(1, 5000, walk=False))
    with pytest.raises(HandcalError, match="without gaps"):
        analysis.analyse(recording(1, walk=False), (0.0, 10.0))
    with pytest.raises(InputError, match="--span"):
        analysis.analyse(recording(1, walk=False), (1e5, 2e5))


def test_gaps_invalid_samples_and_dead_channels_are_said():
    r = recording(2, 2**14, walk=False)
    t, valid = r.imu.t.copy(), r.imu.valid.copy()
    t[12000:] += 5.0
    valid[100] = False
    cut = Recording(r.path, Imu(t, r.imu.gyro, r.imu.accel, valid))
    result = analysis.analyse(cut, (0.0, 1e4))
    assert result.span == pytest.approx((t[101], t[11999]))
    assert any("only 1.0 to 120.0 s" in w for w in result.warnings)
    dead = Recording(r.path, Imu(r.imu.t, np.zeros_like(r.imu.gyro), r.imu.accel, r.imu.valid))
    with pytest.raises(HandcalError, match="gyro_x reads the same"):
        analysis.analyse(dead, (0.0, 1e4))


def test_slow_motion_and_a_low_pass_filter_are_said():
    r = recording(3, walk=False)
    accel, angle = r.imu.accel.copy(), np.radians(np.linspace(0, 1, 2**15))
    accel[:, 0] += 9.8 * np.sin(angle)
    tilted = Recording(r.path, Imu(r.imu.t, r.imu.gyro, accel, r.imu.valid))
    assert any("Slow motion" in w for w in analysis.analyse(tilted, (0.0, 1e4)).warnings)
    window = np.ones(8) / 8
    smooth = np.column_stack([np.convolve(g, window, "same") for g in r.imu.gyro.T])
    filtered = analysis.analyse(
        Recording(r.path, Imu(r.imu.t, smooth, r.imu.accel, r.imu.valid)), (0.0, 1e4)
    )
    assert any("low-pass" in w for w in filtered.warnings)
    for c in filtered.channels[:3]:
        white = c.term("N")  # without the margin beyond the first octave that fits: 11 %, 5 sigma
        assert white.value == pytest.approx(1e-3, abs=4 * white.sigma)
        assert white.value == pytest.approx(1e-3, rel=0.1)


@pytest.mark.parametrize("text", ["5", "a,b", "1,2,3", "nan,5", "0,inf"])
def test_a_span_that_is_none_is_a_sentence(text):
    with pytest.raises(InputError, match="--span"):
        _span(text)


def test_command_page_and_json(tmp_path, capsys, analysed):
    source, out, page = (tmp_path / n for n in ("a.mcap", "a.json", "a.html"))
    write_mcap(recording(0, 2**14), source)
    command(source, span="0,150", json=out, report=page)
    said = json.loads(out.read_text())
    assert said["schema"] == "handcal/allan/1"
    assert [c["channel"] for c in said["channels"]] == list(analysis.CHANNELS)
    assert "gyro_noise" in capsys.readouterr().out
    html = page.read_text()
    assert html.count("<svg") == 8
    assert "http" not in html.replace("http-equiv", "")
    assert not re.search(r"[a-z]\.[A-Z]", " ".join(re.findall(r"<p.*?</p>", html, re.DOTALL)))
    assert said["span_s"][1] == pytest.approx(150.0, abs=0.1)
    assert json.dumps(allan_json(analysed[0]), allow_nan=False)


def test_a_whole_minute_is_enough():
    """Sixty seconds of samples last one interval less than sixty seconds."""
    assert analysis.analyse(recording(1, 2**14, walk=False), (0.0, 60.0)).span[0] == 0.0


# --- one sensor, and lost samples (issue 75) ----------------------------------------------------


def without(whole, share, in_a_row=1):
    """The recording with a share of its samples lost, so many in a row."""
    keep = np.random.default_rng(9).random(len(whole.imu.t)) > share / in_a_row
    for _ in range(in_a_row - 1):
        keep[1:] &= keep[:-1] | ~np.r_[True, keep[:-2]]
    imu = whole.imu
    return replace(whole, imu=Imu(imu.t[keep], imu.gyro[keep], imu.accel[keep], imu.valid[keep]))


@pytest.mark.parametrize("share", [0.002, 0.02, 0.05])
def test_lost_samples_are_interpolated_and_said(share):
    whole = recording(0, walk=False)
    lossy = without(whole, share)
    result = analysis.analyse(lossy)
    assert result.span[1] - result.span[0] > 0.99 * whole.duration_s
    lost = len(whole.imu.t) - len(lossy.imu.t)
    (said,) = (w for w in result.warnings if "interpolated" in w)
    assert abs(int(said.split()[0]) - lost) <= 2  # (one at the very end is none)
    for c, n in zip(result.channels, N, strict=True):
        white = c.term("N")
        assert abs(white.value - n) < 4 * white.sigma + 0.75 * share * n


def test_late_stamps_are_no_losses():
    """A sample that came late has a short interval behind it."""
    whole = recording(0, walk=False)
    t = whole.imu.t.copy()
    t[[10_000, 20_000]] += 0.7 / RATE
    result = analysis.analyse(replace(whole, imu=replace(whole.imu, t=t)), (0.0, 1e4))
    assert not any("interpolated" in w for w in result.warnings)


def test_more_than_a_tenth_lost_is_not_made_up():
    with pytest.raises(HandcalError, match="without gaps"):
        analysis.analyse(without(recording(0), 0.15))


@pytest.mark.parametrize("sensor", ["gyro", *proved("accel")])
def test_one_sensor_alone_is_analysed_and_refused_elsewhere(sensor, tmp_path, capsys, monkeypatch):
    whole = recording(0)
    value = getattr(whole.imu, sensor)
    names = ",".join(f"{sensor[0]}{axis}" for axis in "xyz")
    path, page = tmp_path / "one.csv", tmp_path / "one.html"
    np.savetxt(path, np.c_[whole.imu.t, value], delimiter=",", header=f"t,{names}", comments="")
    result = analysis.analyse(load(path, needs=()))
    both = analysis.analyse(whole)
    assert [c.name for c in result.channels] == [f"{sensor}_{axis}" for axis in "xyz"]
    assert result.span == both.span
    own = [c for c in both.channels if c.sensor == sensor]
    for c, same in zip(result.channels, own, strict=True):
        np.testing.assert_allclose(c.deviation, same.deviation, rtol=1e-9)
    write_allan_report(result, page)
    assert page.read_text().count("<svg") == 4
    assert len(allan_json(result)["channels"]) == 3
    status, _, said = typed(monkeypatch, capsys, "calibrate", path)
    assert status == 2
    assert "Only handcal allan takes a gyroscope or an accelerometer alone" in said
    with pytest.raises(InputError, match="alone"):
        handcal.calibrate(handcal.read(path, needs=()))


def test_files_of_one_sensor_and_with_losses(cases):
    gyro = analysis.analyse(load(cases / "gyro_only.csv", needs=()))
    assert {c.sensor for c in gyro.channels} == {"gyro"}
    lossy = analysis.analyse(load(cases / "still_2_percent_lost.csv"))
    assert lossy.span[1] - lossy.span[0] > 230.0
    assert any("lost samples of" in w for w in lossy.warnings)
