"""A simulated world: a hand, a device in it, and what its sensors read.

Nothing of `handcal` is used here, and nothing here is used by it: an MCAP file is
all that passes between them, so that an error made twice does not cancel.

Truth is built from smooth functions of time that are differentiated analytically
and evaluated at the very instants at which a sensor samples; causes act in physical
form (a sensor at a place on a turning body, a clock that runs fast, a low pass).

Conventions: navigation frame east-north-up; `C_nb` takes body vectors to navigation;
specific force at rest reads +g upwards; a sensor reads truth plus error; SI units.

    world = simulate("three-turns", seed=7, effects={"gyro_scale": [0.01, 0, 0]})
    write(world, "turns.mcap")
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from handcal_sim.mcap_writer import write as write
    from handcal_sim.scenario import World as World
    from handcal_sim.scenario import simulate as simulate

__all__ = ["World", "simulate", "write"]


def __getattr__(name: str) -> Any:
    """Import numpy and the writer only where they are used: `--help` stays instant."""
    if name in ("simulate", "World"):
        from handcal_sim import scenario

        return getattr(scenario, name)
    if name == "write":
        from handcal_sim.mcap_writer import write

        return write
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
