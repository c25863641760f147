"""Parts of results that several kinds of them have."""

from __future__ import annotations

from typing import Annotated, NotRequired, TypedDict

from handcal.results.kinds import Count, Four, Later, Number, Vector


class Level(TypedDict):
    """A noise level."""

    name: Annotated[
        str, "`gyro_noise`, `hand_sway`, ...; of a noise effect `<effect>_<parameter>`."
    ]
    value: Annotated[Number, "In its unit."]
    unit: Annotated[str, "SI."]


class Recording(TypedDict):
    """What was read."""

    path: Annotated[str, "As given, or as found."]
    duration_s: Annotated[Number, "Its length; null of a table of tests."]
    imu_rate_hz: Annotated[Number, "Readings of the IMU in a second; null of a table of tests."]
    streams: Annotated[dict[str, Stream], "By stream: `imu`, `heading`, `mag`, ..."]
    assume: Annotated[str, "What was assumed of the hand: `fixed-point`, `rest-only`."]
    sha256: NotRequired[
        Annotated[
            str | None,
            "Of the file; null for a folder, or what was never a file.",
            "except of a table of tests",
        ]
    ]
    device: NotRequired[Annotated[str, "Which one it was.", "where the recording says so"]]
    model: NotRequired[Annotated[str, "Of the device.", "where the recording says so"]]
    read_noise: NotRequired[
        Annotated[
            _ReadNoise,
            "White noise that the readings themselves show, rad/s/sqrt(Hz), m/s^2/sqrt(Hz).",
            "of 100 readings or more",
        ]
    ]
    rest_noise: NotRequired[
        Annotated[
            _RestNoise,
            "The same of its longest rest; empty where it has none.",
            "of 100 readings or more",
        ]
    ]
    recorded: NotRequired[Annotated[str, "When it began, UTC.", "where the recording says so"]]
    temperature_degC: NotRequired[
        Annotated[Number, "The mean of its thermometer.", "with a thermometer"]
    ]
    vehicle: NotRequired[
        Annotated[
            dict[str, float],
            "Parameters of the vehicle's own calibration, and ids of its sensors as `topic.field`.",
            "of a log of PX4 or ArduPilot",
        ]
    ]
    corrected: NotRequired[
        Annotated[
            dict[str, str],
            "Results by which `handcal apply` had corrected the readings: name by sha256.",
            "of a recording that `handcal apply` wrote",
        ]
    ]


class Stream(TypedDict):
    """One stream of a recording."""

    samples: Annotated[Count, "How many readings."]
    topic: NotRequired[
        Annotated[str, "Where it was read.", "of a bag or a log of PX4 or ArduPilot"]
    ]


class _ReadNoise(TypedDict):
    gyro_noise: NotRequired[Annotated[float, "", "with a gyro"]]
    accel_noise: NotRequired[Annotated[float, "", "with an accelerometer"]]


class _RestNoise(TypedDict):
    gyro_noise: NotRequired[Annotated[float, "", "with a gyro at rest"]]
    accel_noise: NotRequired[Annotated[float, "", "with an accelerometer at rest"]]


class Parameter(TypedDict):
    """One estimated constant of an effect (`handcal effects` lists them)."""

    effect: Annotated[str, "Id of the effect, `gyro_bias` for one."]
    name: Annotated[str, "Which of its parameters: `x`."]
    value: Annotated[Number, "In its unit; of a walking bias its mean over the recording."]
    sigma: Annotated[Number, "Standard deviation of the value."]
    unit: Annotated[str, "SI; `1` for shares."]
    shown: Later[
        Annotated[
            bool,
            "Whether this motion showed it: sigma below half its prior's, or the value beyond "
            "three sigmas from zero.",
        ]
    ]
    given_model: NotRequired[
        Annotated[
            _GivenModel,
            "The same if, besides biases, there are only the effects that were found.",
            "where the covariance of all is known",
        ]
    ]
    observable: Annotated[bool, "The same as `shown`, its name before."]
    converged_at_s: Annotated[
        Number, "From when on its uncertainty no longer mattered; null where it never settled."
    ]


class _GivenModel(TypedDict):
    value: Annotated[Number, "In its unit."]
    sigma: Annotated[Number, "Standard deviation of the value."]


class CalibrationFit(TypedDict):
    """How well the model fits."""

    log_evidence: Annotated[Number, "Natural log; null where the method has none."]
    observations: Annotated[Count, "How many."]
    nis: NotRequired[
        Annotated[
            dict[str, Number],
            "By kind of observation: mean normalised innovation squared per degree of freedom; 1 "
            "is expected.",
            "of one recording",
        ]
    ]
    whiteness: NotRequired[
        Annotated[
            dict[str, Number],
            "By kind: lag-one autocorrelation of the innovations; 0 is right.",
            "of one recording",
        ]
    ]


class Untellable(TypedDict):
    """A parameter that the recording cannot show."""

    effect: Annotated[str, "Id of the effect."]
    name: Annotated[str, "Of the parameter."]
    sigma: Annotated[Number, "What is known of it all the same."]
    unit: Later[Annotated[str, "SI."]]


class MarkerRotation(TypedDict):
    """How the marker of a pose is turned on the device."""

    quaternion: Annotated[
        Four[float], "w x y z of the matrix that takes vectors in the IMU's axes to the marker's."
    ]
    sigma: Annotated[Vector, "rad, about the IMU's axes."]


class Quality(TypedDict):
    """How far dead reckoning by the device's readings is off, as they are and corrected: in a
    minute of turning by hand about all axes, begun from rest with attitude, velocity and place
    known. Of gyro and accelerometer at the recording's temperature; to first order in the errors,
    with the tails of their priors."""

    attitude: Drift
    position: Drift


class Drift(TypedDict):
    """The size of one error of dead reckoning, in the mean over what is known of the device."""

    unit: Annotated[str, "SI."]
    after_s: Annotated[float, "Of the motion."]
    expected: Annotated[float, "With the readings as they are."]
    p16: Annotated[float, "It is less with probability 16 %."]
    p84: Annotated[float, "It is less with probability 84 %."]
    corrected: Annotated[float, "What is expected with the errors that were found taken off."]
    usual_better: Annotated[
        float,
        "Share of usual devices, as the priors have them, whose readings as they are do better.",
    ]


class _Expected(TypedDict):
    effect: str
    name: str
    sigma: float
    unit: str
