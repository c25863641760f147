"""Whether handcal has become slower beside other programs than it once was.

Only ratios are compared, each taken within one run: they hardly depend on the machine.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from handcal.bench.timing import Figure, Found

# A ratio may be worse by so much: the medians of one machine code differ by a quarter.
SLOWER = 1.3


class Compared(NamedTuple):
    """A ratio then and now, and how many times worse it is (under 1: better)."""

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
    then = {f["title"]: float(f["median"]) for f in kept}
    for one in found:
        if isinstance(one, Figure) and one.unit == "x" and one.title in then:
            before = then[one.title]
            worse = before / one.value if one.more_is_better else one.value / before
            yield Compared(one.title, before, one.value, worse)
