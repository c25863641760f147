"""Parts that several results of the simulator have."""

from __future__ import annotations

from typing import Annotated, TypedDict

from handcal.results.kinds import Count, Number, Two


class Share(TypedDict):
    """A count as a share."""

    n: Annotated[Count, "Of how many."]
    count: Annotated[Count, "How many."]
    share: Annotated[Number, "Null of none."]
    interval: Annotated[Two[float], "Wilson's, 95 %."]
