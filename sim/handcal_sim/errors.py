"""What may go wrong, said in a sentence."""

from __future__ import annotations


class SimulationError(ValueError):
    """A sentence for the user: what is wrong with a request."""
