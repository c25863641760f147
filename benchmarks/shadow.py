"""The search on one matrix beside today's `search()`: names, noise, score, fits and seconds.

    python benchmarks/shadow.py [FILE ...] [--drawn SUITE:N ...] [--alone] [--loud]

Each recording is fitted with what every device has; both searches begin there. The one on a
matrix: response, select, one fit. The fit is kept if, and only if, the score rises; else half of
its changes are tried. Seconds are processor time.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from judge_cases import Case, written

from handcal.effects import Effect
from handcal.estimate import fit
from handcal.estimate.baseline import baseline, dense
from handcal.estimate.case import case_of, name_of
from handcal.estimate.fit import fitted
from handcal.estimate.model import Fitted, Model
from handcal.estimate.transfer import moved_to
from handcal.laws import short_windows
from handcal.model_score import better, of_use, prior, score
from handcal.recordings import inputs
from handcal.search.climb.state import sensible
from handcal.search.multistart import search
from handcal.search.noise_scan import Look, all_noise, looks_of
from handcal.search.response import Response, held, response
from handcal.search.select import Priors, missed, select
from handcal.search.select_laws import best_laws, confirmed, courses_on

TURNS = 30
# Nats below the model's score down to which a rival of the beam is fitted; and that noise of a
# short memory must gain at a look of the filter, and a law.
CLOSE, LOOK, LAW = 3.0, 10.0, 0.5
Courses = dict[int, list[short_windows.Courses]]
Coming = tuple[Effect, Mapping[str, float]]
Say = Callable[[str], None]


@dataclass(frozen=True)
class Change:
    """Effects that come, with their noise levels, the surest first; and ids of those that go."""

    come: Sequence[Coming]
    go: frozenset[str]

    def of(self, model: Model, worth: float) -> Model:
        """The model with it, fitted."""
        effects = [*(e for e in model.effects if e.id not in self.go), *(e for e, _ in self.come)]
        levels = {k: v for _, own in self.come for k, v in own.items()}
        begin = (moved_to(f, effects) for f in model.parts)
        parts = [replace(f, levels={**f.levels, **levels}) for f in begin]
        return fitted(parts, effects, of_use=of_use(model, effects, worth))

    def half(self) -> Change | None:
        """Half of it: what comes goes on alone at last; None of a single change."""
        if len(self.come) > 1:
            return Change(self.come[: len(self.come) // 2], self.go)
        return Change(self.come, frozenset()) if self.come and self.go else None

    def __str__(self) -> str:
        return " ".join([*(f"+{e.id}" for e, _ in self.come), *(f"-{i}" for i in sorted(self.go))])


def climbed(model: Model, say: Say) -> Model:
    """The end of the search on matrices from a fit."""
    refused: frozenset[str] = frozenset()
    courses: Courses = {}
    for _ in range(TURNS):
        better_one, failed = _turn(model, refused, courses, say)
        if better_one is None and not failed:
            return model
        model, refused = (
            (model, refused | failed) if better_one is None else (better_one, frozenset())
        )
    return model


def _turn(
    model: Model, refused: frozenset[str], courses: Courses, say: Say
) -> tuple[Model | None, frozenset[str]]:
    """A better model, or what was fitted in vain and alone."""
    cases = [f.case for f in model.parts]
    r = response(model)
    worth, have = r.quadratic.worth, {*model.chosen, *r.levels}
    kept = [e for e in model.effects if e.process is None]
    always = frozenset(e.id for e in kept if e.common or e.id in refused)
    priors = Priors(partial(prior, cases=cases), refused - {name_of(i) for i in model.ids}, always)
    first, best = select(r, priors, model.chosen)
    say(f"  {model.log_evidence:.1f}, matrix {first.score:.1f}, {len(r.quadratic.b)} columns")

    def tried(come: Mapping[str, Coming], ids: frozenset[str], promised: float) -> Model | Change:
        """The better model with these effects, or the smallest change that was fitted in vain."""
        change: Change | None = Change(list(come.values()), frozenset(have - ids))
        while change is not None:
            new = change.of(model, worth)
            gained = better(new, model, worth)
            say(f"    {change}: {promised - first.score:.1f} promised, {gained:.1f}")
            if sensible(new) and gained > worth * new.swing:
                return new
            last, change = change, change.half()
        return last

    look = _look(model, refused, r)
    if look is not None and worth * look.gain > best[0].score - first.score:
        new, added = fitted(look.parts, look.effects), look.effects[-1].id
        gained = better(new, model, worth)
        say(f"    look +{added}: {worth * look.gain:.1f} promised, {gained:.1f}")
        if sensible(new) and gained > worth * new.swing:
            return new, frozenset()
        return None, frozenset({added})
    failed: set[str] = set()
    for choice in best:
        vain = {name_of(i) for i in choice.ids ^ have} & failed
        if choice.score < first.score - CLOSE or choice.ids == have or vain:
            continue
        lost = missed(r, priors, choice)
        new = sorted(choice.ids - have, key=lambda i: -lost[i])
        end = tried({i: choice.effects[i] for i in new}, choice.ids, choice.score)
        if isinstance(end, Model):
            return end, frozenset()
        failed |= {name_of(e.id) for e, _ in end.come} or end.go
    if failed - refused:
        return None, frozenset(failed)
    if not courses:
        courses |= courses_on(r)
    for rivals in best_laws(r, priors, best[0], courses):
        ends = []
        for law in rivals:
            surely = law.score - law.nats + confirmed(model, law, worth)
            if min(law.score, surely) > best[0].score + LAW:
                come = {law.effect.id: (law.effect, dict[str, float]())}
                ends.append(tried(come, law.beside.ids | come.keys(), surely))
                failed.add(law.effect.id)
        models = [end for end in ends if isinstance(end, Model)]
        if models:
            return max(models, key=lambda m: score(m, worth)), frozenset()
    return None, frozenset(failed - refused)


def _look(model: Model, refused: frozenset[str], r: Response) -> Look | None:
    """The likeliest noise by a look of the filter, if it has a level too short for windows."""
    out = [e for e in all_noise() if e.id not in {*model.ids, *refused}]
    looks = looks_of(model.parts, model.effects, out, len(out))
    for look in looks:
        e = look.effects[-1]
        levels = {lv.name: look.parts[0].levels[lv.name] for lv in e.levels}
        if look.gain > LOOK and not (e in r.noise and held(e, levels, r.windows)):
            return look
    return None


@dataclass(frozen=True)
class End:
    """Where a search ended, with how many fits, in how many seconds of the processor."""

    model: Model
    fits: int
    seconds: float


def _measured(search_from: Callable[[], Model]) -> End:
    began, fits = time.process_time(), []
    plain = fit.begun

    def counted(f: Fitted, effects: Sequence[Effect]) -> Fitted:
        fits.append(f)
        return plain(f, effects)

    fit.begun = counted
    try:
        end = search_from()
    finally:
        fit.begun = plain
    return End(end, len(fits), time.process_time() - began)


def compared(file: Path, alone: bool, say: Say) -> str:
    """A row: what either search found, score of the matrix's end less today's, fits, seconds."""
    base = dense(baseline([case_of(inputs.load(file))]))
    new = _measured(lambda: climbed(base, say))
    if alone:
        return f"{file.stem}: {_said(new, base)}"
    old = _measured(lambda: search(base).model)
    worth = response(old.model).quadratic.worth
    apart = better(new.model, old.model, worth)
    nats = new.model.log_evidence - old.model.log_evidence
    same = "same" if set(new.model.ids) == set(old.model.ids) else "DIFFERENT"
    return (
        f"{file.stem}: {same}, score {apart:+.1f}, evidence {nats:+.1f}"
        f"\n  matrix {_said(new, base)}\n  today  {_said(old, base)}"
    )


def _said(end: End, base: Model) -> str:
    found = [i for i in end.model.ids if i not in base.ids]
    return f"{end.fits} fits, {end.seconds:.1f} s: {', '.join(found) or 'nothing'}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path, nargs="*")
    parser.add_argument("--drawn", nargs="*", default=[], metavar="SUITE:N")
    parser.add_argument("--alone", action="store_true", help="leave today's search out")
    parser.add_argument("--loud", action="store_true", help="say what is fitted")
    given = parser.parse_args()
    say: Say = partial(print, flush=True) if given.loud else lambda _: None
    # (one process: its fits are counted, and its seconds are all: on one core there are no copies)
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    with tempfile.TemporaryDirectory() as folder:
        drawn = (d.split(":") for d in given.drawn)
        cases = [Case(f"{suite}_{n}", suite, quick=False, number=int(n)) for suite, n in drawn]
        for file in [*given.file, *(written(c, Path(folder))[0] for c in cases)]:
            print(compared(file, given.alone, say), flush=True)


if __name__ == "__main__":
    main()
