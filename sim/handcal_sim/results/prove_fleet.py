"""What `handcal prove --suite fleet --json` writes."""

from __future__ import annotations

from typing import Annotated, Literal, TypedDict

from handcal.results.kinds import Count, Floats, Kind, Number, Two
from handcal_sim.results.parts import Share


class FleetProof(TypedDict):
    """A simulated fleet given to `handcal fleet`, and what it tells beside the truth."""

    schema: Kind[Literal["handcal-sim/prove-fleet/1"]]
    n: Annotated[Count, "Recordings."]
    seed: Annotated[Count, "Same seed, same fleet."]
    devices: Annotated[Count, "That were drawn."]
    means_within_3_sigma: Annotated[Share, "Means of scale errors, of nought."]
    spreads_within: Annotated[
        Share, "95 % intervals that hold the spread with which devices were drawn."
    ]
    laws: Annotated[dict[str, str], "The law without a name of each model that has one."]
    law_found: Annotated[bool, "Whether that of the model `law` is the cubic."]
    laws_elsewhere: Annotated[Count, "Models that have none and were said to."]
    odd: Annotated[ShareOfOdd, "Odd devices among the first one and a half times as many."]
    broken: Annotated[Share, "Broken files that are rows."]
    slopes: Annotated[Floats, "Of the gyro's bias by temperature in the model `warm`, sigmas off."]
    shares: Annotated[
        dict[str, dict[str, float]], "What makes that bias change, by axis, as in fleet.json."
    ]
    taught: Annotated[
        _Taught, "What learned priors are worth for devices that they were not learned from."
    ]
    mislabelled: Annotated[
        ShareOfMislabelled, "Recordings under the name of another device that are told."
    ]
    smaller: Annotated[_Smaller, "Fleets of ten devices of one model each."]


class ShareOfOdd(TypedDict):
    """Odd devices among the first."""

    n: Annotated[Count, "Of how many."]
    count: Annotated[Count, "How many."]
    share: Annotated[Number, "Null of none."]
    interval: Annotated[Two[float], "Wilson's, 95 %."]
    told: Annotated[Count, "Devices that are said to be odd."]
    places: Annotated[
        dict[str, int | None],
        "By device and what is odd, at which place it stands; null where it is not told.",
    ]


class _Taught(TypedDict):
    seconds: Annotated[float, "Length of each new recording."]
    rows: Annotated[list[_Rows], "One a model of new devices and motion."]


class _Rows(TypedDict):
    model: Annotated[str, "Of the new devices."]
    priors: Annotated[str, "The model whose priors are used."]
    motion: Annotated[str, "Of the first recording; the second one is by a free hand."]
    effects: Annotated[
        dict[str, float], "Root mean square errors with priors over those without, by effect."
    ]
    all: Annotated[Number, "The same of all, errors in the devices' spreads."]
    all_best: Annotated[
        Number, "With the density that devices were drawn from in place of learned priors."
    ]
    estimates: Annotated[Count, "How many numbers that is."]
    leave_room: Annotated[
        Count, "Those whose sigma without priors is at least three quarters of the devices' spread."
    ]
    room: Annotated[
        Number, "Root mean square errors of these, with over without; null where there are none."
    ]
    room_best: Annotated[Number, "The same with the density that devices were drawn from."]
    foretold: Annotated[
        ShareForetold,
        "Devices whose second recording is the better foretold by what the first says with priors.",
    ]


class ShareForetold(TypedDict):
    """Devices whose second recording is the better foretold."""

    n: Annotated[Count, "Of how many."]
    count: Annotated[Count, "How many."]
    share: Annotated[Number, "Null of none."]
    interval: Annotated[Two[float], "Wilson's, 95 %."]
    median_gain: Annotated[float, "Nats."]


class ShareOfMislabelled(TypedDict):
    """Recordings under another device's name."""

    n: Annotated[Count, "Of how many."]
    count: Annotated[Count, "How many."]
    share: Annotated[Number, "Null of none."]
    interval: Annotated[Two[float], "Wilson's, 95 %."]
    whose: Annotated[Count, "Of which it is said whose they are."]
    others: Annotated[Count, "Others that are told."]


class _Smaller(TypedDict):
    fleets: Annotated[Count, "How many."]
    means_within_3_sigma: Annotated[Share, "As of the whole."]
    spreads_within: Annotated[Share, "As of the whole."]
