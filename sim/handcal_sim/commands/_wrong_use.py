"""What the simulator refuses, said as every command of the program says it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def wrong_use() -> Iterator[None]:
    """Inside, a SimulationError becomes an InputError: one sentence, exit status 2."""
    from handcal.did_you_mean import did_you_mean
    from handcal.types import InputError
    from handcal_sim.errors import SimulationError, UnknownWord

    try:
        yield
    except SimulationError as problem:
        near = ""
        if isinstance(problem, UnknownWord):
            near = did_you_mean(problem.word, problem.known)
        raise InputError(f"{str(problem).rstrip('.')}.{near}") from None
