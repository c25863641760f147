"""What explains a recording best while it is still being made."""

from __future__ import annotations

from worlds import recording_of

from handcal.explain.leading import Leading, leading
from handcal.live.turns import CHOICE
from handcal.search.budget import Budget
from handcal_sim import simulate

MOTIONS = [asked.motion for asked in CHOICE]


def led(scenario: str, **world: object) -> Leading:
    recording = recording_of(simulate(scenario, **world), "heading")
    return leading(recording, None, MOTIONS, Budget())


def test_an_error_leads_and_nothing_leads_without_one() -> None:
    found = led("three-turns", seed=1, effects={"accel_asymmetry": [0.0, 0.0, 0.02]})
    assert [m.effect for m in found.missing] == ["accel_asymmetry"]
    (z,) = [p for p in found.missing[0].parameters if p.name == "z"]
    assert abs(z.value - 0.02) < 4.0 * z.sigma
    assert led("three-turns", seed=2) == Leading((), ())
