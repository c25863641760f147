"""What `handcal fleet` keeps of one recording."""

from __future__ import annotations

from typing import Annotated, Literal, NotRequired, TypedDict

from handcal.results.kinds import Count, Kind, Number, Texts


class FleetRecording(TypedDict):
    """What `handcal fleet` keeps of one recording: `recordings/KEY.json` in the folder of
    `--out`."""

    schema: Kind[Literal["handcal/fleet-recording/1"]]
    version: Annotated[str, "Of the program that wrote it."]
    key: Annotated[str, "Name of this file."]
    path: Annotated[str, "As it was read."]
    sha256: Annotated[str, "Of its bytes."]
    status: Annotated[
        Literal["done", "failed", "timed_out", "out_of_memory", "unreachable", "killed", "crashed"],
        "What became of it.",
    ]
    reason: Annotated[str, "Why there is no result, in a sentence."]
    tries: Annotated[Count, "How often it was begun."]
    seconds: Annotated[Number, "It took."]
    peak: Annotated[Count, "Bytes of memory."]
    deadline: Annotated[Number, "Seconds it had."]
    memory: Annotated[Count, "Bytes it had."]
    budget: Annotated[Number, "Of `--budget`."]
    priors: Annotated[_Priors | None, "With which priors it was made; null: the catalogue's."]
    said: NotRequired[
        Annotated[str, "The last words of a process that crashed.", "with status `crashed`"]
    ]
    recording: NotRequired[
        Annotated[_KeptRecording, "As of `explain --json`.", "with status `done`"]
    ]
    device: NotRequired[
        Annotated[str, "What the file says of its device; empty: nothing.", "with status `done`"]
    ]
    model: NotRequired[
        Annotated[str, "What the file says of its model; empty: nothing.", "with status `done`"]
    ]
    gravity: NotRequired[
        Annotated[Number, "Median of what the accelerometer reads, m/s^2.", "with status `done`"]
    ]
    verdict: NotRequired[Annotated[str, "Of `explain`.", "with status `done`"]]
    named: NotRequired[
        Annotated[
            list[
                Annotated[
                    _Named, "An entry of `missing` of `explain --json`, without words and sizes."
                ]
            ],
            "What `explain` named.",
            "with status `done`",
        ]
    ]
    unnamed: NotRequired[Annotated[Texts, "Formulas of what has no name.", "with status `done`"]]
    hypotheses: NotRequired[
        Annotated[
            list[Annotated[_KeptHypothesis, "One effect."]],
            "Of each effect that was on trial.",
            "with status `done`",
        ]
    ]
    told: NotRequired[
        Annotated[
            list[Annotated[_Told, "One parameter."]],
            "Of each parameter, whether or not its effect was named.",
            "with status `done`",
        ]
    ]
    information: NotRequired[
        Annotated[
            _Information,
            "Log-likelihood b'u - u'G u / 2 of all parameters at once, in units of the "
            "catalogue's sizes.",
            "with status `done`",
        ]
    ]
    laws: NotRequired[
        Annotated[
            _FleetRecordingLaws,
            "Of the laws without a name that devices may have in common, what it tells.",
            "with status `done`",
        ]
    ]
    held_out: NotRequired[Annotated[_KeptHeldOut, "As of `explain --json`.", "with status `done`"]]
    warnings: NotRequired[Annotated[Texts, "As of `explain --json`.", "with status `done`"]]
    trust: NotRequired[
        Annotated[
            Literal["good", "doubtful", "none"], "As of `explain --json`.", "with status `done`"
        ]
    ]
    trust_reasons: NotRequired[Annotated[Texts, "Why it is not `good`.", "with status `done`"]]
    untold: NotRequired[
        Annotated[
            str,
            "Why it tells nothing of the devices of its model: beside what was found, no fit "
            "holds with what every device has.",
            "with status `done`, in the place of `information` and `laws`",
        ]
    ]


class _Priors(TypedDict):
    path: Annotated[str, "Of the file."]
    model: Annotated[str, "Which model of it."]
    sha256: Annotated[str, "Of the file."]
    recordings: Annotated[Count, "Of how many it was learned."]
    devices: Annotated[Count, "Of how many it was learned."]


class _KeptRecording(TypedDict):
    path: Annotated[str, "As it was read."]
    duration_s: Annotated[Number, "Of the recording."]
    imu_rate_hz: Annotated[Number, "Of the IMU."]
    streams: Annotated[Texts, "Which it has."]
    assume: Annotated[str, "What was taken for granted about the hand."]
    sha256: Annotated[str | None, "Of its bytes; null for a folder."]
    recorded: NotRequired[Annotated[str, "When it began.", "where the recording says so"]]
    temperature_degC: NotRequired[Annotated[Number, "Mean.", "where it has a temperature"]]


class _Named(TypedDict):
    effect: Annotated[str, "Id."]
    probability: Annotated[Number, "That it is there."]
    log_evidence_gain: Annotated[Number, "Nats."]
    indistinguishable_from: Annotated[Texts, "Ids."]
    parameters: Annotated[list[Annotated[_NamedParameter, "One parameter."]], "Its parameters."]


class _NamedParameter(TypedDict):
    name: Annotated[str, "Which parameter."]
    value: Annotated[Number, "SI."]
    sigma: Annotated[Number, "SI."]
    unit: Annotated[str, "SI."]


class _KeptHypothesis(TypedDict):
    effect: Annotated[str, "Id."]
    alone: Annotated[Number, "Nats over the baseline."]
    probability: Annotated[Number, "That it is there."]


class _Told(TypedDict):
    effect: Annotated[str, "Id of the effect."]
    name: Annotated[str, "Which of its parameters."]
    value: Annotated[Number, "What the recording alone says, without any prior."]
    sigma: Annotated[Number, "Of the value."]
    unit: Annotated[str, "SI; `1` for shares."]
    prior_sigma: Annotated[Number, "The catalogue's size."]
    together: Annotated[bool, "Estimated with the others of every recording, or alone beside them."]


class _Information(TypedDict):
    names: Annotated[list[Texts], "Effect and name of each parameter u."]
    b: Annotated[str, "(k,) in base64 of little-endian float64."]
    G: Annotated[str, "Lower triangle of (k, k) by rows, likewise."]


class _FleetRecordingLaws(TypedDict):
    count: Annotated[Count, "Laws that it was asked about."]
    told: Annotated[
        str, "Value and sigma of each, SI (nan: not told), as little-endian float32 in base64."
    ]


class _KeptHeldOut(TypedDict):
    log_score_before: NotRequired[Annotated[Number, "Nats.", "where anything was held out"]]
    log_score_after: NotRequired[Annotated[Number, "Nats.", "where anything was held out"]]
    residual_rms_before: NotRequired[
        Annotated[dict[str, float], "By channel.", "where anything was held out"]
    ]
    residual_rms_after: NotRequired[
        Annotated[dict[str, float], "By channel.", "where anything was held out"]
    ]
