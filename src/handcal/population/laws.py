"""A law without a name that the devices of a model have in common."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from handcal.population.deconvolved import LEAST, Population, population
from handcal.population.grouped import devices, owners, telling
from handcal.population.stacked import FOUND, Stack, stack
from handcal.types import Array

# Laws whose evidence is worked out in full: those of the largest sums of evidence for one constant.
LOOKED_AT = 60


@dataclass(frozen=True)
class Asked:
    """Laws that recordings were asked about: usual (k,), the constant of each that is clearly
    visible, SI; said(i): the formula; named(i): whether the catalogue has it."""

    usual: Array
    said: Callable[[int], str]
    named: Callable[[int], bool]


@dataclass(frozen=True)
class CommonLaw:
    """index: of the law among those that were asked about; evidence for it over the devices; the
    population of its constant (SI), and the devices' own values (d,) and sigmas (d,)."""

    index: int
    stack: Stack
    population: Population
    value: Array
    sigma: Array


def common_law(
    laws: Asked, value: Array, sigma: Array, names: Sequence[str], trials: int
) -> CommonLaw | None:
    """The law that explains the recordings of all devices best, value and sigma (n, k); None where
    none is more probable than not. names (n,): of the devices; trials: laws times models."""
    who = owners(names)
    promising = np.argsort(-_simple(value, sigma, laws.usual))[:LOOKED_AT]
    best: tuple[Stack, int] | None = None
    for i in promising.tolist():
        d = devices(*telling(value[:, i], sigma[:, i], who))
        if len(d.value) < LEAST or laws.named(i):
            continue
        found = stack(laws.said(i), [(d.value, d.sigma)], laws.usual[i : i + 1], trials)
        if best is None or found.gain > best[0].gain:
            best = found, i
    if best is None or best[0].probability <= FOUND:
        return None
    found, i = best
    told = telling(value[:, i], sigma[:, i], who)
    d = devices(*told)
    return CommonLaw(i, found, population(*told), d.value, d.sigma)


def _simple(value: Array, sigma: Array, usual: Array) -> Array:
    """Nats (k,) of one constant for all recordings, under the prior of its usual size."""
    w = np.where(np.isfinite(sigma) & np.isfinite(value), 1.0 / sigma**2, 0.0)
    total, product = w.sum(axis=0), np.where(w > 0.0, w * value, 0.0).sum(axis=0)
    wide = 1.0 + total * usual**2
    return np.asarray(0.5 * product**2 * usual**2 / wide - 0.5 * np.log(wide))


def better(law: CommonLaw, stacks: Sequence[Stack]) -> bool:
    """Whether the law explains more than every effect of the catalogue that devices may have in
    common: only then has it no name."""
    return all(law.stack.gain > s.gain for s in stacks)
