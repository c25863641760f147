"""The climb from a fit to the likeliest model: select on the one matrix of the fit, fit what was
selected, and keep it if, and only if, the score rises.

Each turn works out the response of the model once. Proposals, in their order: names, steps and
noise from the matrix, beside the likeliest noise by a look of the filter; what no combination of
columns shows (``beyond_columns``); laws; a selection about a fit with all names. Of a choice that
fails, half is tried. If no proposal raises the score, the climb ends.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice

from handcal.effects import Effect
from handcal.estimate.case import name_of
from handcal.estimate.fit import fitted
from handcal.estimate.forked import in_parallel
from handcal.estimate.model import Model
from handcal.estimate.transfer import moved_to, without
from handcal.laws.short_windows import Courses
from handcal.model_score import better, of_use, prior, score
from handcal.search.beyond_columns import other_ways
from handcal.search.budget import Budget, Report
from handcal.search.noise_scan import Look, all_noise, looks_of
from handcal.search.plausible import sensible
from handcal.search.response import Levels, Response, held, response, sensor_of
from handcal.search.select import (
    Choice,
    Priors,
    Process,
    missed,
    present,
    processes_of,
    select,
)
from handcal.search.select_laws import Found, confirmed, courses_on, groups_of, laws_of

# Most turns. Every turn raises the score, so that a climb ends by itself.
TURNS = 40
# Nats that a proposal must promise; and groups of a sensor's laws that are fitted.
PROMISE, GROUPS = 0.5, 3
# Nats that noise gains at a few levels from which it is fitted, since its best level may gain more.
LOOK = 3.0
# Nats that a law may gain more in the place of something than about the fit with that.
BENT = 40.0
# Nats of score within which two fits are the same.
SAME = 0.1

# An effect that a proposal adds, and its noise levels in each recording.
Coming = tuple[Effect, Levels]


@dataclass(frozen=True, eq=False)
class Made:
    """What is worked out once for the windows of the same times, filled on demand: processes on
    trial, and courses of all drivers."""

    processes: dict[tuple[bytes, ...], list[Process]] = field(default_factory=dict)
    courses: dict[tuple[bytes, ...], dict[int, list[Courses]]] = field(default_factory=dict)

    def processes_in(self, r: Response) -> list[Process]:
        """Those that the windows can hold."""
        if r.windows.key not in self.processes:
            self.processes[r.windows.key] = processes_of(r)
        return [p for p in self.processes[r.windows.key] if held(p.effect, p.levels, r.windows)]

    def courses_in(self, r: Response) -> dict[int, list[Courses]]:
        """The courses of the drivers of each sensor."""
        if r.windows.key not in self.courses:
            self.courses[r.windows.key] = courses_on(r.windows)
        return self.courses[r.windows.key]


@dataclass(frozen=True, eq=False)
class Change:
    """Effects that come, the surest first, and ids of those that go."""

    come: Sequence[Coming]
    go: frozenset[str]

    def of(self, model: Model, worth: float) -> Model:
        """The model with it, fitted."""
        effects = [*(e for e in model.effects if e.id not in self.go), *(e for e, _ in self.come)]
        begin = [moved_to(f, effects) for f in model.parts]
        for n, f in enumerate(begin):
            own = {k: v for _, levels in self.come if levels for k, v in levels[n].items()}
            begin[n] = replace(f, levels={**f.levels, **own})
        return fitted(begin, effects, of_use=of_use(model, effects, worth))

    def half(self) -> Change | None:
        """Half of it: what comes goes on alone at last; None of a single change."""
        if len(self.come) > 1:
            return Change(self.come[: len(self.come) // 2], self.go)
        return Change(self.come, frozenset()) if self.come and self.go else None

    @property
    def names(self) -> frozenset[str]:
        """Names of what comes, or ids of what goes if nothing comes."""
        return frozenset(name_of(e.id) for e, _ in self.come) or self.go


@dataclass(frozen=True, eq=False)
class Climb:
    """What holds for all turns of a climb. kept: ids that no proposal removes; refused: names that
    none adds; named: only names, steps and noise are proposed, which takes seconds."""

    kept: frozenset[str]
    refused: frozenset[str]
    budget: Budget
    made: Made
    named: bool = False


def climbed(c: Climb, model: Model, report: Report) -> Model:
    """The model at the end of a climb."""
    for turn in range(TURNS):
        report(min(0.95, 0.15 + 0.1 * turn), model)
        if c.budget.spent("further effects"):
            c.budget.note("laws that have no name")
            break
        better_one = _next(c, model)
        if better_one is None:
            break
        model = better_one
    return model


def _next(c: Climb, model: Model) -> Model | None:
    """The first proposal that raises the score; None if none does."""
    r = response(model)
    priors, look, own = _priors(c, model), _look(c, model), {name_of(i) for i in model.ids}
    while True:
        now, best = select(r, priors, c.made.processes_in(r), model.chosen)
        promised = best.score - now.score
        ways: list[Callable[[], Model | frozenset[str]]] = []
        if promised >= PROMISE:
            ways.append(partial(_fitted, model, r, _change(r, priors, now, best)))
        if look is not None and (promised < PROMISE or _gain(model, look, r.worth) > promised):
            ways.append(partial(fitted, look.parts, look.effects))
            look = None
        ends = list(in_parallel(ways))
        better_ones = [m for m in ends if isinstance(m, Model) and raises(model, m, r.worth)]
        if better_ones:
            return max(better_ones, key=lambda m: score(m, r.worth))
        end = ends[0] if promised >= PROMISE and not isinstance(ends[0], Model) else frozenset()
        if not end - own - priors.refused or c.budget.spent("further effects"):
            break
        # (what failed alone is refused, until nothing new is promised)
        priors = replace(priors, refused=priors.refused | (end - own))
    if c.named:
        return None
    others = other_ways(model, r.worth, c.refused, c.kept)
    other = next((new for new in others if raises(model, new, r.worth)), None)
    if other is not None or c.budget.spent("laws that have no name"):
        return other
    return _with_law(c, model, r, priors, now) or _from_afar(c, model, r)


def _from_afar(c: Climb, model: Model, r: Response) -> Model | None:
    """The better model selected about a fit with all names. (The likelihood of strong errors is no
    quadratic: about a fit without them they promise less than they gain.)"""
    out = {*model.ids, *c.refused}
    new = [e for e in r.effects if "@" not in e.id and e.id not in out]
    whole = fitted(model.parts, [*model.effects, *new])
    if not whole.settled or not whole.log_evidence > model.log_evidence:
        return None
    there, priors = response(whole, r.worth), _priors(c, model)
    now, best = select(there, priors, c.made.processes_in(there), whole.chosen)
    end = _change(there, priors, now, best).of(whole, r.worth)
    return end if raises(model, end, r.worth) else None


def _gain(model: Model, look: Look, worth: float) -> float:
    """What the noise of a look gains of score."""
    return worth * look.gain + prior(look.effects[-1], [f.case for f in model.parts])


def raises(model: Model, new: Model, worth: float) -> bool:
    """Whether a fit has plausible parameters and a higher score. One that does not settle must gain
    more than its evidence swings by."""
    return sensible(new) and better(new, model, worth) > max(SAME, worth * new.swing)


def _priors(c: Climb, model: Model) -> Priors:
    always = {e.id for e in model.effects if e.process is None and (e.common or e.id in c.kept)}
    odds = partial(prior, cases=[f.case for f in model.parts])
    return Priors(odds, c.refused - {name_of(i) for i in model.ids}, frozenset(always))


def _change(r: Response, priors: Priors, now: Choice, choice: Choice) -> Change:
    """What a choice changes of the present one, the surest first."""
    lost, before = missed(r, priors, choice), now.effects
    there = choice.effects
    # (noise at other levels is another process)
    new = [i for i in there if i not in before or there[i][1] != before[i][1]]
    new = sorted(new, key=lambda i: -lost[i])
    return Change([there[i] for i in new], now.ids - (choice.ids - {*new}))


def _fitted(model: Model, r: Response, change: Change | None) -> Model | frozenset[str]:
    """The better model with a change or half of it, and so on; or the names in the smallest change
    that failed."""
    failed = frozenset[str]()
    while change is not None and change.names:
        new = change.of(model, r.worth)
        if raises(model, new, r.worth):
            return new
        failed, change = change.names, change.half()
    return failed


def _with_law(c: Climb, model: Model, r: Response, priors: Priors, choice: Choice) -> Model | None:
    """The model with a law, or a law in the place of what stood in for it."""
    lists: list[list[Found]] = []
    for sensor, courses in c.made.courses_in(r).items():
        found = list(laws_of(r, priors, choice, sensor, courses))
        spared = [e for e in r.filtered if sensor_of(e) == sensor and e.id not in c.kept]
        if spared:
            # (noise in the filter cannot be integrated out: a matrix without it)
            other = response(without(model, {e.id for e in spared}), r.worth)
            names = present(other, priors, choice.names)
            courses = c.made.courses_in(other)[sensor]
            found += laws_of(other, priors, names, sensor, courses, spared)
        lists += [[law for law in found if bool(law.go) == instead] for instead in (False, True)]
    ranked = [list(islice(groups_of(some), GROUPS)) for some in lists if some]
    for groups in sorted(ranked, key=lambda groups: -groups[0][0].score):
        for rivals in groups:
            laws = [law for law in rivals if _promises(model, r, choice, law)]
            changes = [Change([(law.effect, ())], law.go) for law in laws]
            ends = in_parallel(partial(change.of, model, r.worth) for change in changes)
            better_ones = [end for end in ends if raises(model, end, r.worth)]
            if better_ones:
                return max(better_ones, key=lambda m: score(m, r.worth))
            if rivals[0].go:
                break
    return None


def _promises(model: Model, r: Response, choice: Choice, law: Found) -> bool:
    """Whether a law promises to raise the score, by the windows and by a scan of its own. If it
    takes the place of something, its fit may gain more, since that bent the trajectory."""
    if law.go:
        return law.score > choice.score - BENT
    if law.score < choice.score + PROMISE:
        return False
    return law.score - law.nats + confirmed(model, law, r.worth) > choice.score + PROMISE


def _look(c: Climb, model: Model) -> Look | None:
    """The likeliest noise by looks of the filter; None if none gains ``LOOK``."""
    best = looks_of(model.parts, model.effects, all_noise({*model.ids, *c.refused}), 1)
    return next((look for look in best if look.gain > LOOK), None)
