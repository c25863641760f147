"""What only the simulator can work out for a recording, besides its explanation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from handcal_sim.prove import draw_budget, draw_strange
from handcal_sim.prove.given import Ticket

_FURTHER: Mapping[str, Callable[[Ticket, Mapping[str, Any]], dict[str, float]]] = {
    "budget": draw_budget.left,
    "strange": draw_strange.left,
    "latest": draw_strange.left,
}


def worked_out(ticket: Ticket, document: Mapping[str, Any]) -> dict[str, float]:
    """Figures by name; none for most suites."""
    work = _FURTHER.get(ticket.suite)
    return {} if work is None else work(ticket, document)
