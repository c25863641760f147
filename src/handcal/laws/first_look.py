"""Which of all blocks of laws a long recording is asked about: those that do well in its first
part. (What a law does to a recording it does to a fourth of it too; and there a scan of all takes a
fourth of the time.)"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from handcal.effects import Effect
from handcal.estimate.columns import Ground
from handcal.estimate.first_part import first_part
from handcal.estimate.forked import in_parallel
from handcal.estimate.model import Model
from handcal.estimate.quadratic import Quadratic
from handcal.estimate.scan import grounds, scan
from handcal.laws.drivers import TIME, WARM, Driver
from handcal.laws.law_effect import AXES_OF, SENSORS
from handcal.laws.over_drivers import Block, ways
from handcal.laws.weighing import Beside, beside, gains, weighed

# Of the blocks of each sensor, the share that is looked at in the whole of a long recording, and
# how many at the least.
LIKELIEST, FEWEST = 0.15, 10


@dataclass(frozen=True, eq=False)
class FirstLook:
    """The first part of the recordings about a model, and scans of blocks there, by vocabulary;
    worth: what evidence counts for (None: as the scans have it)."""

    model: Model
    base: Sequence[Ground]
    worth: float | None
    scanned: dict[str, list[tuple[list[Block], Quadratic]]] = field(default_factory=dict)

    def likeliest(
        self, name: str, chunks: Sequence[list[Block]], known: Sequence[Effect]
    ) -> list[Block]:
        """Blocks of a vocabulary that may gain most in the whole beside these effects: those that
        gain most here, of each sensor, and what is slow, of which this does not show all."""
        if name not in self.scanned:
            looks = (
                partial(scan, self.model, [b.effect for b in c], self.base, self.worth)
                for c in chunks
            )
            self.scanned[name] = list(zip(chunks, in_parallel(looks), strict=True))
        pairs = self.scanned[name]
        worth = float(np.median([q.worth for _, q in pairs])) if pairs else 1.0
        gain: dict[str, float] = {}
        for chunk, q in pairs:
            seen = beside(weighed(q, worth), known, [b.effect for b in chunk])
            gain |= {b.effect.id: _most(b, seen) for b in chunk}
        all_ = [b for chunk in chunks for b in chunk]
        out = [b for b in all_ if _slow(b.driver)]
        for sensor in range(len(SENSORS)):
            own = [b for b in all_ if b.sensor == sensor and not _slow(b.driver)]
            own.sort(key=lambda b: -gain[b.effect.id])
            out += own[: max(FEWEST, math.ceil(LIKELIEST * len(own)))]
        return out


def first_look(model: Model, worth: float | None = None) -> FirstLook | None:
    """About this model; None where its recordings have no first part."""
    part = first_part(model)
    return None if part is None else FirstLook(part, grounds(part), worth)


def _slow(driver: Driver) -> bool:
    """Whether a driver goes with time or warmth, of which a part of a recording does not show
    all."""
    return driver.free or WARM in driver.name or driver.over == TIME.name


def _most(block: Block, seen: Beside) -> float:
    """About what a block gains: as a law of one axis, of all alike, or of each its own. (Whether
    that has a name takes longer to find out.)"""
    tried = [(b, G) for _, each, b, G in ways(block, seen) if not each]
    one, roots, axes = block.forms[0].constants, block.roots, len(AXES_OF[block.sensor])
    many = (len(tried), *roots.shape)
    found = gains(
        np.broadcast_to(np.stack([b for b, _ in tried])[:, None], many[:3]).reshape(-1, one),
        np.broadcast_to(np.stack([G for _, G in tried])[:, None], many).reshape(-1, one, one),
        np.broadcast_to(roots, many).reshape(-1, one, one),
    )
    best = found.reshape(many[:2]).max(axis=1)
    return float(max(best.max(), np.maximum(best[:axes], 0.0).sum()))
