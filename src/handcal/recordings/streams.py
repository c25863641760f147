"""The streams of a recording: one row a stream, and everything that differs between them.

A new stream is a new row. Files are read and written, units and topics chosen, clocks stretched
and signals made by what the row says. ``value`` is what ``types.Series`` holds, in SI.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from handcal.types import Array, Recording

DEGREE = np.pi / 180
# Beginning of the topics that hold what a model before and one after `explain` says was read.
TWINS = ("/before", "/after")
# What a warning of a recording says whose axes were not those of ``handcal``.
TURNED_TO_FLU = "turned to forward, left, up"
# How the warning begins of one that ``apply`` corrected.
CORRECTED = "Its readings were corrected by "

# Definitions of the parts of messages, as ROS 2 has them.
TYPES: Mapping[str, str] = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
}


@dataclass(frozen=True)
class Message:
    """A ROS 2 message: a header, then only float64.

    text: its definition, the header first. needed: names of the fields that are read, in the
    order of what they become. absent: fields whose -1 says that the sensor gave nothing (ROS
    convention). filled: what is written into fields that are not needed, where not zero.
    """

    schema: str
    text: str
    needed: tuple[str, ...]
    absent: tuple[str, ...] = ()
    filled: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def floats(self) -> tuple[str, ...]:
        """Names of the float64 behind the header, in their order."""
        return tuple(_floats(self.text.split("\n", 1)[1], ""))

    def index(self, names: tuple[str, ...]) -> list[int]:
        return [self.floats.index(name) for name in names]

    @property
    def definition(self) -> str:
        """The definition with all it refers to, as ROS 2 bags hold it."""
        used = {"std_msgs/Header", *_used(self.text)}
        parts = [f"MSG: {name}\n{text}" for name, text in TYPES.items() if name in used]
        return f"\n{'=' * 80}\n".join([self.text, *parts]) + "\n"


def _lines(text: str) -> list[tuple[str, str]]:
    return [(kind, name) for kind, name in (line.split() for line in text.splitlines())]


def _floats(text: str, prefix: str) -> Iterator[str]:
    for kind, name in _lines(text):
        if kind == "float64":
            yield prefix + name
        elif kind.startswith("float64["):
            yield from (f"{prefix}{name}.{i}" for i in range(int(kind[8:-1])))
        else:
            yield from _floats(TYPES[kind], f"{prefix}{name}.")


def _used(text: str) -> Iterator[str]:
    for kind, _ in _lines(text):
        if kind in TYPES:
            yield kind
            yield from _used(TYPES[kind])


@dataclass(frozen=True)
class Stream:
    """One row.

    topic: where it usually is; named: it is taken by that name alone, never for its schema.
    columns, unit: of its value (m, d). title: in a sentence. frame: frame_id that is written.
    decode, encode: from the message's needed fields to the value and back, where they differ.
    quantities: of which ``--units`` applies to what a message holds, for equal shares of the
    columns; units: of its own quantity, factors to SI, SI first; spellings: other names for them.
    csv: what a table calls it, where columns.toml does not say.
    observation: kind of observation that looks at it; without one it is known at any moment
    between two readings. circular: an angle, in (-pi, pi]. own_clock: its stamps are not the
    device's. planned_hz: in a planned motion it is read no more often than this.
    """

    name: str
    message: Message
    topic: str
    columns: tuple[str, ...]
    unit: str
    title: str
    frame: str = "imu"
    decode: Callable[[Array], Array] | None = None
    encode: Callable[[Array], Array] | None = None
    quantities: tuple[str, ...] = ()
    units: Mapping[str, float] = field(default_factory=dict)
    csv: tuple[str, ...] = ()
    spellings: Mapping[str, str] = field(default_factory=dict)
    observation: str = ""
    circular: bool = False
    own_clock: bool = False
    named: bool = False
    planned_hz: float = 1.0

    @property
    def inertial(self) -> bool:
        """It holds rate and force, as the IMU does."""
        return self.message is IMU

    @property
    def posed(self) -> bool:
        """It holds position and attitude."""
        return self.message is POSE


def yaw_of_quaternions(q_xyzw: Array) -> Array:
    """Yaw of body x (m, 1), rad, of quaternions (m, 4) in the order of ROS, of any length."""
    x, y, z, w = q_xyzw.T
    # Twice the half angle keeps the last bit for a pure yaw, which atan2 of the matrix loses.
    level = (x == 0) & (y == 0)
    yaw = np.arctan2(2 * (x * y + w * z), w * w + x * x - y * y - z * z)
    yaw = np.where(level, 2 * np.arctan2(z, w), yaw)
    yaw = np.where(np.any(q_xyzw != 0, axis=1), yaw, np.nan)
    return yaw[:, None]


def quaternions_of_yaw(value: Array) -> Array:
    """x y z w of pure yaws (m, 1), chosen so that they read back as the very same number.

    Rounding decides whether they do, so those that do not are tried again with z and w
    moved by a few units in the last place.
    """
    yaw = value[:, 0]
    z, w = np.sin(yaw / 2), np.cos(yaw / 2)
    for k in range(31 * 31):
        wrong = 2 * np.arctan2(z, w) != yaw
        if not wrong.any():
            break
        z = np.where(wrong, np.sin(yaw / 2) * (1 - k % 31 * 2.0**-53), z)
        w = np.where(wrong, np.cos(yaw / 2) * (1 - k // 31 * 2.0**-53), w)
    return np.column_stack([np.zeros_like(z), np.zeros_like(z), z, w])


def _parts(name: str, parts: str) -> tuple[str, ...]:
    return tuple(f"{name}.{part}" for part in parts)


IMU = Message(
    "sensor_msgs/msg/Imu",
    """std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance""",
    _parts("angular_velocity", "xyz") + _parts("linear_acceleration", "xyz"),
    ("angular_velocity_covariance.0", "linear_acceleration_covariance.0"),
    {"orientation.w": 1.0, "orientation_covariance.0": -1.0},
)
MAG = Message(
    "sensor_msgs/msg/MagneticField",
    """std_msgs/Header header
geometry_msgs/Vector3 magnetic_field
float64[9] magnetic_field_covariance""",
    _parts("magnetic_field", "xyz"),
)
TEMPERATURE = Message(
    "sensor_msgs/msg/Temperature",
    "std_msgs/Header header\nfloat64 temperature\nfloat64 variance",
    ("temperature",),
)
QUATERNION = Message(
    "geometry_msgs/msg/QuaternionStamped",
    "std_msgs/Header header\ngeometry_msgs/Quaternion quaternion",
    _parts("quaternion", "xyzw"),
)
POSE = Message(
    "geometry_msgs/msg/PoseStamped",
    "std_msgs/Header header\ngeometry_msgs/Pose pose",
    _parts("pose.position", "xyz") + _parts("pose.orientation", "wxyz"),
)
_INERTIAL = tuple(f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz")

_TABLE = (
    Stream(
        "imu", IMU, "/imu", _INERTIAL, "rad/s, m/s^2", "IMU",
        quantities=("gyro", "accel"), planned_hz=50.0,
    ),
    # a turntable, or a trusted IMU on the same body
    Stream(
        "reference", IMU, "/reference", _INERTIAL, "rad/s, m/s^2", "reference",
        quantities=("gyro", "accel"), observation="known_input", own_clock=True, named=True,
        planned_hz=50.0,
    ),
    # yaw of body x
    Stream(
        "heading", QUATERNION, "/heading", ("yaw",), "rad", "heading", "map",
        yaw_of_quaternions, quaternions_of_yaw,
        units={"rad": 1.0, "deg": DEGREE, "rad-cw": -1.0, "deg-cw": -DEGREE},
        spellings={"radcw": "rad-cw", "degcw": "deg-cw"},
        observation="heading", circular=True, planned_hz=10.0,
    ),
    # in body axes
    Stream(
        "mag", MAG, "/mag", ("x", "y", "z"), "tesla", "magnetometer", quantities=("mag",),
        units={"t": 1.0, "mt": 1e-3, "ut": 1e-6, "nt": 1e-9, "gauss": 1e-4, "mgauss": 1e-7},
        spellings={"g": "gauss", "mg": "mgauss"},
        observation="magnetometer",
        planned_hz=10.0,
    ),
    Stream(
        "temperature", TEMPERATURE, "/temperature", ("temperature",), "degC", "temperature",
        quantities=("temperature",), units={"degc": 1.0},
    ),
    # position, and quaternion of C_wb: the marker's axes in the pose's world
    Stream(
        "pose", POSE, "/pose", ("x", "y", "z", "qw", "qx", "qy", "qz"), "m, 1", "pose", "world",
        observation="pose", own_clock=True, planned_hz=25.0,
    ),
)  # fmt: skip
STREAMS: dict[str, Stream] = {stream.name: stream for stream in _TABLE}


def message_of(schema: str) -> Message | None:
    """The message of a schema, None if no stream is one of those."""
    return next((s.message for s in STREAMS.values() if s.message.schema == schema), None)


def observed_by(kind: str) -> Stream | None:
    """The stream that a kind of observation looks at; None for a pseudo-observation."""
    return next((s for s in STREAMS.values() if s.observation == kind), None)


def as_corrected(recording: Recording, corrected: Mapping[str, str]) -> Recording:
    """The recording as one from which errors were taken off, which its warnings say; corrected:
    names of the results by sha256, none for a raw one."""
    others = [said for said in recording.warnings if not said.startswith(CORRECTED)]
    if corrected:
        names = ", ".join(corrected.values())
        others.append(
            f"{CORRECTED}{names} (`handcal apply`): what is found in them is what that left."
        )
    return replace(recording, corrected=corrected, warnings=tuple(others))
