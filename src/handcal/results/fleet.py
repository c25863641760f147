"""What `handcal fleet` writes of a fleet."""

from __future__ import annotations

from typing import Annotated, Literal, TypedDict

from handcal.results.kinds import AT_LEAST_0, Count, Fraction, Kind, Later, Number, Positive, Texts


class Fleet(TypedDict):
    """What a fleet tells: `fleet.json` in the folder of `--out`."""

    schema: Kind[Literal["handcal/fleet/1"]]
    version: Annotated[str, "Of the program that wrote it."]
    recordings: Annotated[_Recordings, "How many."]
    verdicts: Annotated[dict[str, int], "How often each verdict of `explain`."]
    models: Annotated[list[FleetModel], "By name."]
    failures: Annotated[list[_Failure], "Recordings without a result."]
    untold: Annotated[
        list[_Untold],
        "Recordings that are explained, and tell nothing of the devices of their model.",
    ]
    doubted: Later[
        Annotated[
            list[_Doubted],
            "Recordings that tell of the devices of their model, and whose explanation is "
            "doubtful; with `--anyway` also those of `trust` `none`.",
        ]
    ]


class _Recordings(TypedDict):
    done: Annotated[Count, "With a result."]
    failed: Annotated[Count, "Without."]


class FleetModel(TypedDict):
    """What the devices of one model have in common."""

    name: Annotated[str, "As the manifest says."]
    recordings: Annotated[Count, "With a result."]
    devices: Annotated[Count, "Of these."]
    populations: Annotated[list[FleetPopulation], "Of each parameter."]
    stacked: Annotated[list[FleetStacked], "Most probable first."]
    odd: Annotated[list[FleetOdd], "Oddest first."]
    changes: Later[
        Annotated[
            list[FleetChange], "How parameters change from one recording of a device to the next."
        ]
    ]
    law: Later[
        Annotated[
            FleetLaw | None,
            "The law without a name that the devices have in common; null: none that explains "
            "more than the catalogue's effects.",
        ]
    ]


class FleetPopulation(TypedDict):
    """One parameter over the devices of a model."""

    effect: Annotated[str, "Id of the effect."]
    name: Annotated[str, "Which of its parameters."]
    unit: Annotated[str, "SI; `1` for shares."]
    devices: Annotated[Count, "Of how many."]
    mean: Annotated[Number, "Of the true errors."]
    mean_sigma: Annotated[Number, "How well it is known."]
    spread: Annotated[
        Number, "Scale of the density of true errors, the estimates' own sigmas taken out."
    ]
    spread_from: Annotated[Number, "Where it is with 95 %."]
    spread_to: Annotated[Number, "Where it is with 95 %."]
    tail: Annotated[Literal["normal", "student_t"], "Which density has the evidence."]
    dof: Annotated[Number, "Of Student's t; null for the normal density."]
    turn_on: Annotated[
        Number,
        "By how much one device differs from one switching on to the next; null where it stays, "
        "or no device was seen twice.",
    ]
    usual: Annotated[float, "The catalogue's size."]
    told: Annotated[bool, "Whether the recordings tell the spread, so that it is in priors.toml."]
    of: Annotated[
        Literal["device", "occasion"],
        "Whether it is of the device, or of the occasion (the hand, the room, what stood in the "
        "file); priors are learned of devices alone.",
    ]


class FleetStacked(TypedDict):
    """Evidence for one effect, summed over devices."""

    effect: Annotated[str, "Id of the effect."]
    log_evidence_gain: Annotated[Number, "Nats of all devices having it over none."]
    over_single_devices: Annotated[
        Number, "Nats over at most half of them having it, each at its own size."
    ]
    probability: Annotated[
        float, "That devices of the model have it in common, after as many trials as there were."
    ]
    devices: Annotated[Count, "That could show it."]
    best_alone: Annotated[Number, "Nats that the best device gives alone."]


class FleetOdd(TypedDict):
    """A device or recording that is not expected."""

    who: Annotated[str, "The device, or the recording's path."]
    kind: Annotated[
        Literal["device", "recording", "gravity", "refused"],
        "A device unlike its population, a recording unlike its device's others, one that does "
        "not read gravity, or a device most of whose recordings were refused.",
    ]
    by_chance: Annotated[Number, "How many so far off are expected in the model by chance."]
    effect: Annotated[str, "That stands out most."]
    name: Annotated[str, "Which of its parameters."]
    value: Annotated[Number, "SI."]
    sigma: Annotated[Number, "SI."]
    mean: Annotated[Number, "What was expected."]
    deviation: Annotated[Number, "Of what was expected."]
    like: Annotated[str, "Another device that it rather is; empty where none."]
    reason: Annotated[str, "In a sentence."]
    left_out: Annotated[bool, "Whether populations are told without it."]


class FleetChange(TypedDict):
    """One parameter over the recordings of devices that were seen more than once."""

    effect: Annotated[str, "Id of the effect."]
    name: Annotated[str, "Of the parameter."]
    unit: Annotated[str, "SI."]
    recordings: Annotated[Count, "Of devices seen more than once."]
    days: Annotated[Positive, "The longest time between two recordings of one device."]
    turn_on: Annotated[Positive, "Standard deviation from one switching on to the next."]
    ageing: Annotated[Positive, "Standard deviation of what a random walk makes in a month."]
    slope: Annotated[
        Number, "By temperature, per K; null: the temperature is unknown, or was always the same."
    ]
    slope_sigma: Annotated[Number, AT_LEAST_0, "Of the slope."]
    slope_spread: Annotated[Number, AT_LEAST_0, "By how much devices differ in it."]
    shares: Annotated[_Shares, "Of the variance within devices, sigmas taken out."]
    steps: Annotated[list[_Step], "The clearest first."]


class _Shares(TypedDict):
    turn_on: Annotated[Fraction, "Of what differs at every switching on."]
    ageing: Annotated[Fraction, "Of the walk."]
    temperature: Annotated[Fraction, "Of the temperature."]
    step: Annotated[Fraction, "Of steps."]


class _Step(TypedDict):
    device: Annotated[str, "Which."]
    after: Annotated[str, "When the last recording before it began."]
    until: Annotated[str, "When the first recording behind it began."]
    size: Annotated[float, "By which it changed."]
    sigma: Annotated[Positive, "Of the size."]
    probability: Annotated[Fraction, "As many places as there were counted."]


class FleetLaw(TypedDict):
    """A law without a name that the devices of a model have in common; as an effect file in
    `laws/`."""

    formula: Annotated[str, "As `unnamed` of `explain` has it."]
    channels: Annotated[Texts, "To which it adds."]
    unit: Annotated[str, "Of its constant, SI."]
    mean: Annotated[float, "Of the devices' constants."]
    mean_sigma: Annotated[Positive, "Of the mean."]
    spread: Annotated[Positive, "Of the devices' constants."]
    log_evidence_gain: Annotated[float, "Nats of all devices having it over none."]
    over_single_devices: Annotated[float, "Nats over some devices having it, each at its own size."]
    probability: Annotated[Fraction, "As many laws and models as there were counted."]
    devices: Annotated[Count, "That tell of it."]
    best_alone: Annotated[float, "Nats that the best of them gives alone."]


class _Failure(TypedDict):
    path: Annotated[str, "Of the recording."]
    status: Annotated[str, "failed, timed_out, out_of_memory, unreachable, killed, crashed."]
    reason: Annotated[str, "In a sentence."]


class _Untold(TypedDict):
    path: Annotated[str, "Of the recording."]
    reason: Annotated[str, "In a sentence."]


class _Doubted(TypedDict):
    path: Annotated[str, "Of the recording."]
    trust: Annotated[Literal["good", "doubtful", "none"], "As of `explain --json`."]
    trust_reasons: Annotated[Texts, "Why it is not `good`."]
