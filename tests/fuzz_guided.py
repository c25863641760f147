"""The same attack as ``fuzz.py``, led by coverage: what reaches new lines is mutated further.

``make fuzz-guided N=100000 SEED=0``. libFuzzer (by atheris) keeps the inputs that reach something
new; how they are changed is half libFuzzer's own affair and half that of ``fuzz.mutated``, which
knows zip files and the readers' words. A failure is what it is in ``fuzz.py``.
"""

from __future__ import annotations

import argparse
import inspect
import os
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import FunctionType, ModuleType

import atheris
import fuzz
import numpy as np

# Only what reads somebody else's bytes is watched: lines of numpy's or of the filter's say nothing
# of a reader, and each costs time.
WATCHED = ("handcal.recordings", "handcal.documents", "handcal.device", "handcal.live",
           "handcal.fleet.sources", "handcal.explain.model_file", "handcal.lab.steady_tests_csv",
           "handcal_sim.sweep.grid")  # fmt: skip

# bytes; above the largest file to begin with, which would else be cut
LONGEST = 130_000
# Share of changes that begin again with a file that is well: what reached something new is mostly
# damaged, and of its children hardly one is read.
ANEW = 0.3


@dataclass
class Run:
    """What a run has seen so far."""

    options: argparse.Namespace
    place: Path
    words: list[bytes]
    known: list[bytes]
    readers: list[fuzz.Seed]
    most: float = 0.0
    scores: dict[str, fuzz.Score] = field(default_factory=dict)
    executions: int = 0

    def __call__(self, data: bytes) -> None:
        """One execution; the first byte says who reads the others."""
        if not data:
            return
        reader = self.readers[data[0] % len(self.readers)]
        score = self.scores.setdefault(reader.kind, fuzz.Score())
        content = data[1:]
        found = fuzz.execute(reader, content, self.place / f"x{reader.suffix}", score)
        self.executions += 1
        self.most = self.most or max(fuzz.MOST_MB, fuzz.peak_mb() + fuzz.MORE_MB)
        if found is None and fuzz.peak_mb() > self.most:
            found, self.most = f"memory: {fuzz.peak_mb():.0f} MB", fuzz.peak_mb() + fuzz.MORE_MB
        if found is not None and found not in score.failures:
            name = f"guided-{self.options.seed}-{self.executions}{reader.suffix}"
            score.failures[found] = name
            self.options.keep.mkdir(exist_ok=True)
            (self.options.keep / name).write_bytes(content)
        if self.executions == self.options.n:
            sys.stdout.flush()
            os._exit(fuzz.told(self.scores))  # (libFuzzer has no other end with a status of ours)


def changed(run: Run, data: bytes, most: int, seed: int) -> bytes:
    """An input changed, the reader kept."""
    rng = np.random.default_rng(seed)
    if rng.random() < ANEW:
        data = run.known[int(rng.integers(len(run.known)))]
    first, content = data[:1] or b"\0", data[1:]
    if rng.random() < 0.5:
        return first + fuzz.mutated(content, run.words, rng)[: most - 1]
    return first + atheris.Mutate(content, most - 1)


def watch() -> int:
    """Have atheris see the branches of what reads; how many functions."""
    from handcal.recordings import inputs

    inputs.formats()  # (which imports them)
    seen = set()
    for name, module in list(sys.modules.items()):
        if any(name == w or name.startswith(f"{w}.") for w in WATCHED):
            seen |= {f for f in functions(module) if f.__module__ == name}
    for function in seen:
        atheris.instrument_func(function)
    return len(seen)


def functions(module: ModuleType) -> Iterator[FunctionType]:
    """Of a module and its classes; what decorators have wrapped, too."""
    for value in vars(module).values():
        of_class = vars(value).values() if inspect.isclass(value) else ()
        for one in (value, *of_class):
            plain = getattr(one, "fget", None) or getattr(one, "__func__", one)
            plain = inspect.unwrap(plain) if callable(plain) else plain
            if isinstance(plain, FunctionType):
                yield plain


def main() -> None:
    """The command. Exit status 1 where anything failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=100_000, help="executions")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, default=Path("fuzz-out"), help="of failing inputs")
    options = parser.parse_args()
    known = fuzz.seeds(np.random.default_rng(options.seed))
    readers = list({(s.kind, s.suffix): s for s in known}.values())
    place = Path(tempfile.mkdtemp())
    corpus = place / "corpus"
    corpus.mkdir()
    at = {(s.kind, s.suffix): k for k, s in enumerate(readers)}
    whole = [bytes([at[s.kind, s.suffix]]) + s.content for s in known]
    for k, content in enumerate(whole):
        (corpus / f"{k}").write_bytes(content)
    print(f"{len(known)} files to begin with; {watch()} functions are watched")
    run = Run(options, place, [*fuzz.WORDS, *fuzz.dictionary()], whole, readers)
    atheris.Setup(
        ["fuzz_guided", str(corpus), f"-seed={options.seed + 1}", f"-max_len={LONGEST}",
         "-timeout=0", "-rss_limit_mb=0", "-handle_int=0", "-verbosity=0"],
        run,
        custom_mutator=lambda data, most, seed: changed(run, data, most, seed),
    )  # fmt: skip
    atheris.Fuzz()


if __name__ == "__main__":
    main()
