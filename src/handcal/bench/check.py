"""Whether handcal has become slower beside other programs than it once was.

Only ratios are compared, each taken within one run: they hardly depend on the machine. Of either
run the best of its rounds counts: what else is at work on a machine, or beside it on the same core,
only makes them worse (the median of one machine code went from 0.44 to 0.74 within an hour, its
best round from 0.41 to 0.49).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from handcal.bench.timing import Figure, Found

# A ratio may be worse by so much: the best of seven rounds of one machine code differ by a fifth.
SLOWER = 1.3


class Compared(NamedTuple):
    """The best round of a ratio then and now, and how many times worse it is (under 1: better)."""

    title: str
    then: float
    now: float
    worse: float

    @property
    def passed(self) -> bool:
        """Whether it is not much worse."""
        return self.worse <= SLOWER


def compared(found: Found, kept: Sequence[Mapping[str, Any]]) -> Iterator[Compared]:
    """Every ratio that was measured now and is among the ``figures`` of an earlier result."""
    then = {f["title"]: f["rounds"] for f in kept}
    for one in found:
        if isinstance(one, Figure) and one.unit == "x" and one.title in then:
            best = max if one.more_is_better else min
            before, now = float(best(then[one.title])), float(best(one.rounds))
            worse = before / now if one.more_is_better else now / before
            yield Compared(one.title, before, now, worse)
