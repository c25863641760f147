"""Mutated input of every kind, in-process, with time and memory watched.

``make fuzz N=100000 SEED=0``. Formats are those in the folder ``recordings/inputs``: a new one
is attacked without a line here, with the words that stand in its source as a dictionary, with
files of its endings made of the others' seeds, and with real recordings that it can read
where there are any. What ends in anything but a value or a HandcalError, takes over 10 s or
500 MB, is a failure; its input is kept.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import os
import re
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np
from format_files import WRITERS
from mcap.writer import CompressionType
from sample_recording import IMU, imu_json, imu_messages, sample, write_channels

import handcal
from handcal.device import apply, priors
from handcal.device import file as device_file
from handcal.explain import model_file
from handcal.fleet import sources
from handcal.lab import steady_tests_csv
from handcal.live.recorder import opened
from handcal.live.session import Session
from handcal.live.sources import browser
from handcal.recordings import inputs
from handcal.show.calibration.summary import calibration_json
from handcal.types import HandcalError
from handcal_sim.errors import SimulationError
from handcal_sim.sweep.grid import read_grid

SLOWEST_S, MOST_MB = 10, 500
MORE_MB = 100  # (what ran before in this process may have had more than all that)
LARGEST_SEED = 300_000
LARGEST_UNZIPPED = 4_000_000  # (a size that lies is no work for the mutation)
FORMATS = Path(inputs.__file__).parent
WORDS = (b"nan", b"NaN", b"inf", b"-1", b"0", b"", b"1e400", b"-1e-320", b"9223372036854775808",
         b"1e30", b"\x00", b"\xff\xff\xff\xff\xff\xff\xff\x7f", b"\n", b",", b";", b'"', b"{", b"[",
         b"null", b"true", b"\xef\xbb\xbf", b"\x1b[31m", b"<script>", b"../../x",
         b"1" * 5000)  # fmt: skip
_TOKEN = re.compile(rb'"(?:[^"\\\n]|\\.)*"|-?\d[\d.eE+-]*|[A-Za-z_]+')

Reader = Callable[[Path], object]


@dataclass(frozen=True)
class Seed:
    """A file that is well, and who reads it."""

    kind: str
    suffix: str
    content: bytes
    read: Reader


@dataclass
class Score:
    """What became of the executions of one kind."""

    executions: int = 0
    accepted: int = 0
    slowest_s: float = 0.0
    failures: dict[str, str] = field(default_factory=dict)


class TooSlow(BaseException):
    """Over the time that anything may take; nothing in between catches it."""


def seeds(rng: np.random.Generator) -> list[Seed]:
    """Of every reader; small, so that a change hits something."""
    out = [Seed(kind, suffix, content, inputs.load) for kind, suffix, content in _recordings()]
    out += list(_unknown_formats(out))
    result = json.dumps(calibration_json((_result(),))).encode()
    explained = result.replace(b"handcal/calibration/1", b"handcal/explanation/1")
    for content in (result, explained):
        out.append(Seed("result JSON, apply --from", ".json", content, apply.read))
        out.append(Seed("result JSON, calibrate --from", ".json", content, model_file.read))
    grid = b"[common]\nduration_s = 60.0\n[grid]\nheading_sigma_deg = [1.0, 5.0]\nr_h_rad = [0.1]\n"
    out.append(Seed("grid TOML", ".toml", grid, read_grid))
    table = rng.normal(size=(12, 6)).round(4).tolist()
    rows = "\n".join(",".join(map(str, row)) for row in table)
    bench = f"ax,ay,az,fx,fy,fz\n{rows}\n".encode()
    read = partial(steady_tests_csv.read, sequence="zyx", gravity=9.80665)
    return [*out, Seed("bench table", ".csv", bench, read), *_of_devices(result)]


def _of_devices(result: bytes) -> Iterator[Seed]:
    """What `device`, `fleet` and `live` read: files of devices, priors, manifests, batches."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "r.json"
        path.write_bytes(result)
        when = datetime(2026, 5, 1, tzinfo=UTC)
        session = device_file.session_of(path, device_file.read_result(path), "phone", when)
        device_file.write(device_file.Device("phone", (session,)), path)
        yield Seed("device TOML", ".toml", path.read_bytes(), device_file.read)
        learned = {("gyro_scale", a): priors.Learned(0.0, 1e-3, 1e-2, 1e-3, 4.0, 9) for a in "xyz"}
        priors.write(path, {"m": learned}, {"m": {"recordings": 9, "devices": 9}})
        yield Seed("priors TOML", ".toml", path.read_bytes(), priors.read)
    manifest = b"path,device,model,started\n.,a,m,2026-05-01T12:00:00Z\n/,b,m,\n"
    yield Seed("manifest", ".csv", manifest, sources.listed)
    batch = {"client": "c", "seq": 0, "t": [1.7e12 + 10 * k for k in range(20)], "agent": "ios",
             "gyro": [[1.0, 2.0, 3.0]] * 20, "accel": [[0.0, 0.1, 9.8]] * 20,
             "heading": [[1.7e12 + 10 * k, 90.0] for k in range(20)]}  # fmt: skip
    yield Seed("batch of live", ".json", json.dumps(batch).encode(), _live)


def _live(path: Path) -> None:
    place = path.with_name("growing.mcap")
    place.unlink(missing_ok=True)
    recorder = opened(place)
    try:
        session = Session(recorder)
        session.take(browser.parse(path.read_bytes()))
        session.status()
    finally:
        recorder.growing.file.close()


def _result() -> handcal.Result:
    levels = {"gyro_noise": 1e-3, "accel_noise": 1e-2, "sway": 0.004, "sway_per_rate": 0.004,
              "sway_time": 0.5, "position_noise": 3e-4}  # fmt: skip
    recording = sample(n=300, streams=False)
    return handcal.calibrate(recording, ["gyro_scale"], assume="fixed-point", noise=levels)


def _recordings() -> Iterator[tuple[str, str, bytes]]:
    recording = sample(n=210, streams=False)
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "a.mcap"
        for encoding, messages in (
            ("cdr", imu_messages(recording)),
            ("json", imu_json(recording)),
        ):
            channels = [("/imu", IMU, encoding)]
            write_channels(path, channels, messages, compression=CompressionType.NONE, crcs=False)
            yield "mcap", ".mcap", path.read_bytes()
    t, numbers = recording.imu.t, np.hstack([recording.imu.gyro, recording.imu.accel])
    rows = [
        ",".join(map(repr, [s, *row])) for s, row in zip(t.tolist(), numbers.tolist(), strict=True)
    ]
    yield "plain_csv", ".csv", ("\n".join(["t,gx,gy,gz,ax,ay,az", *rows]) + "\n").encode()
    members = {"Metadata.csv": "version,platform,standardisation\n3,android,false\n"}
    sensors = (("Gyroscope", recording.imu.gyro), ("Accelerometer", recording.imu.accel))
    for sensor, value in sensors:
        lines = [f"{1_700_000_000_000_000_000 + round(s * 1e9)},{s},{x},{y},{z}"
                 for s, (x, y, z) in zip(t.tolist(), value.tolist(), strict=True)]  # fmt: skip
        members[f"{sensor}Uncalibrated.csv"] = "\n".join(["time,seconds_elapsed,x,y,z", *lines])
    yield "sensor_logger", ".zip", _zipped({k: v.encode() for k, v in members.items()})
    entries = [{"sensor": "x", "platform": "android"}] + [
        {"sensor": f"{sensor}Uncalibrated",
         "time": str(1_700_000_000_000_000_000 + round(s * 1e9)),
         **dict(zip("xyz", map(str, v), strict=True))}
        for sensor, value in sensors
        for s, v in zip(t.tolist(), value.tolist(), strict=True)
    ]  # fmt: skip
    yield "sensor_logger", ".json", json.dumps(entries).encode()
    for kind, written in WRITERS.items():
        for ending, write in written:
            yield kind, ending, write(recording)


def _unknown_formats(known: list[Seed]) -> Iterator[Seed]:
    """Seeds of formats for which there is none above: endings and words from their source."""
    for module in sorted(FORMATS.glob("[a-z]*.py")):
        if module.stem in {s.kind for s in known}:
            continue
        source = module.read_text(encoding="utf-8")
        endings = sorted(set(re.findall(r"[\"(/ ](\.[a-z0-9]{2,6})\b", source))) or [".bin"]
        words = dictionary((module,))
        for ending in endings:
            for whole in (b",".join(words), b"\n".join(words), *(s.content for s in known)):
                yield Seed(module.stem, ending, whole, inputs.load)
        yield from _real(module.stem, endings)


def _real(kind: str, endings: list[str]) -> Iterator[Seed]:
    """Real recordings of such an ending, where the folder of them is at hand."""
    folder = Path(os.environ.get("HANDCAL_RECORDINGS", "no-such-folder"))
    for path in sorted(p for p in folder.rglob("*") if p.suffix.lower() in endings):
        if path.is_file() and path.stat().st_size <= LARGEST_SEED:
            yield Seed(kind, path.suffix, path.read_bytes(), inputs.load)


def dictionary(modules: tuple[Path, ...] = ()) -> list[bytes]:
    """The words that the readers know: every string in their sources."""
    found: set[bytes] = set()
    for module in modules or tuple(FORMATS.glob("*.py")):
        for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str | bytes):
                word = node.value.encode() if isinstance(node.value, str) else node.value
                found |= {word} if 0 < len(word) <= 40 else set()
    return sorted(found)


def _zipped(members: dict[str, bytes]) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return out.getvalue()


def _unzipped(content: bytes) -> dict[str, bytes]:
    """What is in a zip file; nothing, of one that was damaged before."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if sum(m.file_size for m in archive.infolist()) > LARGEST_UNZIPPED:
                return {}
            return {n: archive.read(n) for n in archive.namelist()}
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, ValueError,
            RuntimeError, OSError):  # fmt: skip
        return {}


def mutated(content: bytes, words: list[bytes], rng: np.random.Generator) -> bytes:
    """One to four changes; of a zip file mostly to what is inside, where checks end."""
    members = _unzipped(content) if content[:2] == b"PK" and rng.random() < 0.8 else {}
    if members:
        one = sorted(members)[int(rng.integers(len(members)))]
        return _zipped(members | {one: mutated(members[one], words, rng)})
    for _ in range(int(rng.integers(1, 4))):
        content = CHANGES[int(rng.integers(len(CHANGES)))](content, words, rng)
    return content


def _bit(c: bytes, _: list[bytes], rng: np.random.Generator) -> bytes:
    if not c:
        return c
    at = int(rng.integers(len(c)))
    return c[:at] + bytes([c[at] ^ 1 << int(rng.integers(8))]) + c[at + 1 :]


def _cut(c: bytes, _: list[bytes], rng: np.random.Generator) -> bytes:
    if rng.random() < 0.5:
        return c[: max(0, len(c) - int(rng.integers(60)))]
    return c[: int(rng.integers(len(c) + 1))]


def _moved(c: bytes, _: list[bytes], rng: np.random.Generator) -> bytes:
    """A stretch is left out, or comes somewhere again."""
    a, at = (int(x) for x in rng.integers(len(c) + 1, size=2))
    b = a + int(2 ** rng.uniform(0, 12))
    return c[:a] + c[b:] if rng.random() < 0.5 else c[:at] + c[a:b] + c[at:]


def _word(c: bytes, words: list[bytes], rng: np.random.Generator) -> bytes:
    """A word of the readers over or between what is there."""
    at, new = int(rng.integers(len(c) + 1)), words[int(rng.integers(len(words)))]
    return c[:at] + new + c[at + len(new) * int(rng.integers(2)) :]


def _token(c: bytes, words: list[bytes], rng: np.random.Generator) -> bytes:
    """A number, name or string becomes another; half of the time one near the beginning."""
    found = list(_TOKEN.finditer(c[:20_000]))
    if not found:
        return _bit(c, words, rng)
    last = len(found) if rng.random() < 0.5 else min(30, len(found))
    token = found[int(rng.integers(last))]
    return c[: token.start()] + words[int(rng.integers(len(words)))] + c[token.end() :]


def _lines(c: bytes, _: list[bytes], rng: np.random.Generator) -> bytes:
    """Lines in another order."""
    lines = c.split(b"\n")
    a = int(rng.integers(len(lines) + 1))
    b = a + int(2 ** rng.uniform(1, 8))
    return b"\n".join(lines[:a] + lines[a:b][::-1] + lines[b:])


CHANGES = (_bit, _bit, _bit, _cut, _moved, _word, _token, _token, _token, _lines)


@contextmanager
def _watch() -> Iterator[None]:
    def late(_signal: int, _frame: object) -> None:
        raise TooSlow(f"over {SLOWEST_S} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(SLOWEST_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def peak_mb() -> float:
    """The most memory that this process has had, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def execute(seed: Seed, content: bytes, path: Path, score: Score) -> str | None:
    """One execution; the place of the failure, if it is one."""
    path.write_bytes(content)
    score.executions += 1
    started, place = time.process_time(), None
    try:
        with _watch(), warnings.catch_warnings():
            warnings.simplefilter("error")
            seed.read(path)
        score.accepted += 1
    except (HandcalError, SimulationError):
        pass
    except (Exception, TooSlow) as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        ours = [f for f in traceback.extract_tb(error.__traceback__) if "handcal" in f.filename]
        at = ours[-1] if ours else last
        place = f"{type(error).__name__} {Path(at.filename).name}:{at.lineno}: {str(error)[:120]}"
    score.slowest_s = max(score.slowest_s, time.process_time() - started)
    return place


def fuzz(n: int, seed: int, keep: Path | None = None) -> dict[str, Score]:
    """n executions, the kinds in turn, by kind. Failing inputs go to ``keep``."""
    rng = np.random.default_rng(seed)
    all_seeds = seeds(rng)
    kinds = sorted({s.kind for s in all_seeds})
    of_kind = {kind: [s for s in all_seeds if s.kind == kind] for kind in kinds}
    words = [*WORDS, *dictionary()]
    scores = {kind: Score() for kind in kinds}
    with tempfile.TemporaryDirectory() as name:
        most = max(MOST_MB, peak_mb() + MORE_MB)
        for k in range(n):
            kind = kinds[k % len(kinds)]
            one = of_kind[kind][int(rng.integers(len(of_kind[kind])))]
            content = mutated(one.content, words, rng)
            place = execute(one, content, Path(name) / f"x{one.suffix}", scores[kind])
            if place is None and peak_mb() > most:
                place, most = f"memory: {peak_mb():.0f} MB", peak_mb() + MORE_MB
            if place is not None and place not in scores[kind].failures:
                scores[kind].failures[place] = f"{k}{one.suffix}"
                if keep:
                    keep.mkdir(exist_ok=True)
                    (keep / f"{seed}-{k}{one.suffix}").write_bytes(content)
    return scores


def main() -> int:
    """The command. Exit status 1 where anything failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=10_000, help="executions")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, default=Path("fuzz-out"), help="of failing inputs")
    options = parser.parse_args()
    return told(fuzz(options.n, options.seed, options.keep))


def told(scores: dict[str, Score]) -> int:
    """Print what became of a run; the exit status."""
    print("| input | executions | read all the same | refused with reason | slowest, s | failed |")
    print("|---|---|---|---|---|---|")
    for kind, s in scores.items():
        refused = s.executions - s.accepted - len(s.failures)
        print(f"| {kind} | {s.executions} | {s.accepted} | {refused} | {s.slowest_s:.2f} "
              f"| {len(s.failures)} |")  # fmt: skip
    print(f"\nPeak memory {peak_mb():.0f} MB.")
    for kind, s in scores.items():
        for place, file in s.failures.items():
            print(f"{kind}: {place} ({file})", file=sys.stderr)
    return 1 if any(s.failures for s in scores.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
