"""A recording written in every format by its documented layout, small, for tests and the fuzzer.

Nothing here shares code with the readers: what a format's documentation says of units, signs,
axes and clocks stands here a second time.
"""

from __future__ import annotations

import io
import struct
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from sample_recording import START_NS, sample
from scipy.spatial.transform import Rotation

from handcal.types import Recording

G = 9.80665
# From ARKit's world (y up) to one with z up: x stays, y becomes z.
Z_UP = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
Files = Mapping[str, bytes]


def stamps(recording: Recording) -> list[int]:
    """Of the IMU, ns since 1970."""
    return (START_NS + np.rint(recording.imu.t * 1e9).astype(np.int64)).tolist()


def rows(header: str, *columns: Iterable[object], separator: str = ",") -> bytes:
    """A table in text; numbers in full."""
    lines = [separator.join(map(str, row)) for row in zip(*columns, strict=True)]
    return ("\n".join([header, *lines] if header else lines) + "\n").encode()


def zipped(files: Files) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return out.getvalue()


def _pose(recording: Recording) -> tuple[list[int], np.ndarray]:
    pose = recording.streams["pose"]
    return (START_NS + np.rint(pose.t * 1e9).astype(np.int64)).tolist(), pose.value


def _y_up(pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places and quaternions w x y z in a world with y up."""
    half = np.sqrt(0.5)
    w, x, y, z = pose[:, 3:].T  # a turn of -90 deg about x before them
    q = half * np.column_stack([w + x, x - w, y + z, z - y])
    return pose[:, :3] @ Z_UP, q


def ios_logger(r: Recording) -> Files:
    seconds = [f"{ns / 1e9:.6f}" for ns in stamps(r)]
    files = {
        "Gyro.txt": rows("", seconds, *r.imu.gyro.T.tolist()),
        "Accel.txt": rows("", seconds, *(-r.imu.accel / G).T.tolist()),
    }
    if r.streams:
        mag, (ns, pose) = r.streams["mag"], _pose(r)
        at = [f"{(START_NS + round(t * 1e9)) / 1e9:.6f}" for t in mag.t.tolist()]
        files["Magnet.txt"] = rows("", at, *(mag.value * 1e6).T.tolist())
        place, q = _y_up(pose)
        at = [f"{n / 1e9:.6f}" for n in ns]
        files["ARposes.txt"] = rows("", at, *place.T.tolist(), *q.T.tolist())
    return files


def phyphox(r: Recording, separator: str = ";", brand: str = "Apple") -> Files:
    """The same readings as phyphox on iOS writes them, 9.81 to a g."""

    def table(unit: str, t: np.ndarray, value: np.ndarray) -> bytes:
        header = separator.join(f'"{n}"' for n in ("Time (s)", *(f"{a} ({unit})" for a in "XYZ")))
        return rows(header, t.tolist(), *value.T.tolist(), separator=separator)

    scale = 9.81 / G if brand == "Apple" else 1.0
    files = {
        "Gyroscope.csv": table("rad/s", r.imu.t, r.imu.gyro),
        "Accelerometer.csv": table("m/s^2", r.imu.t, r.imu.accel * scale),
        "Linear Accelerometer.csv": table("m/s^2", r.imu.t, r.imu.accel * 0.01),
        "meta/device.csv": separator.join(['"property"', '"value"']).encode()
        + b"\n"
        + separator.join(['"deviceBrand"', f'"{brand}"']).encode(),
        "meta/time.csv": separator.join(['"event"', '"experiment time"', '"system time"']).encode()
        + b"\n"
        + separator.join(['"START"', "0.0", repr(START_NS / 1e9)]).encode(),
    }
    if r.streams:
        mag = r.streams["mag"]
        files["Magnetometer.csv"] = table("\u00b5T", mag.t, mag.value * 1e6)
    return files


def phyphox_table(r: Recording) -> bytes:
    """The one table of an experiment of one's own that records both sensors."""
    names = ["Time (s)", *(f"{sensor} {axis} ({unit})" for sensor, unit in
             (("Gyroscope", "rad/s"), ("Acceleration", "m/s^2")) for axis in "xyz")]  # fmt: skip
    value = np.column_stack([r.imu.t, r.imu.gyro, r.imu.accel])
    return rows(",".join(f'"{n}"' for n in names), *value.T.tolist())


def workbook(sheets: Mapping[str, list[list[object]]]) -> bytes:
    """An .xls of numbers and text: a BIFF8 stream in a compound file of one stream."""

    def record(kind: int, data: bytes) -> bytes:
        return struct.pack("<HH", kind, len(data)) + data

    def begin(kind: int) -> bytes:
        return record(0x0809, struct.pack("<HHHHII", 0x0600, kind, 0, 0, 0, 0))

    def cell(row: int, column: int, value: object) -> bytes:
        head = struct.pack("<HHH", row, column, 0)
        if isinstance(value, str):
            return record(0x0204, head + struct.pack("<HB", len(value), 0) + value.encode("latin1"))
        return record(0x0203, head + struct.pack("<d", value))

    end = record(0x000A, b"")
    bodies = [
        begin(0x0010)
        + b"".join(cell(i, j, v) for i, row in enumerate(table) for j, v in enumerate(row))
        + end
        for table in sheets.values()
    ]
    lengths = [12 + len(name) for name in sheets]
    offset, bounds = 20 + sum(lengths) + len(end), b""
    for name, body in zip(sheets, bodies, strict=True):
        bounds += record(0x0085, struct.pack("<IHBB", offset, 0, len(name), 0) + name.encode())
        offset += len(body)
    return _compound(begin(0x0005) + bounds + end + b"".join(bodies))


def _compound(stream: bytes) -> bytes:
    """A compound file whose one stream is the Workbook: table of sectors, folder, stream."""
    stream += b"\0" * max(0, 4096 - len(stream))
    size, free = -(-len(stream) // 512), 0xFFFFFFFF
    head = struct.pack(
        "<8s16xHHHHH6xIIIIIIIII",
        b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", 0x3E, 3, 0xFFFE, 9, 6,
        0, 1, 1, 0, 4096, 0xFFFFFFFE, 0, 0xFFFFFFFE, 0,
    )  # fmt: skip
    head += struct.pack("<109I", 0, *[free] * 108)
    assert 2 + size <= 128
    chain = [0xFFFFFFFD, 0xFFFFFFFE, *range(3, 2 + size), 0xFFFFFFFE]
    table = struct.pack("<128I", *chain, *[free] * (128 - len(chain)))
    folder = b""
    for name, kind, child, start, length in (
        ("Root Entry", 5, 1, 0xFFFFFFFE, 0),
        ("Workbook", 2, free, 2, len(stream)),
        ("", 0, free, 0, 0),
        ("", 0, free, 0, 0),
    ):
        text = name.encode("utf-16-le") + b"\0\0" if name else b""
        folder += struct.pack(
            "<64sHBBIII16xI16xII4x", text, len(text), kind, 1, free, free, child, 0, start, length
        )
    return head + table + folder + stream + b"\0" * (512 * size - len(stream))


def phyphox_xls(r: Recording) -> bytes:
    def sheet(unit: str, name: str, value: np.ndarray) -> list[list[object]]:
        header: list[object] = ["Time (s)", *(f"{name} {axis} ({unit})" for axis in "xyz")]
        return [header, *np.column_stack([r.imu.t, value]).tolist()]

    return workbook(
        {
            "Raw Data": sheet("rad/s", "Gyroscope", r.imu.gyro),
            "Acceleration": sheet("m/s^2", "Acceleration", r.imu.accel),
            "Metadata Device": [["property", "value"], ["deviceBrand", "google"]],
            "Metadata Time": [["event", "experiment time", "system time"],
                              ["START", 0.0, START_NS / 1e9]],
        }
    )  # fmt: skip


def euroc(r: Recording, pose: str = "vicon0") -> Files:
    ns = stamps(r)
    header = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1]"
    header += ",a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
    files = {
        "mav0/imu0/data.csv": rows(header, ns, *r.imu.gyro.T.tolist(), *r.imu.accel.T.tolist())
    }
    if r.streams:
        at, value = _pose(r)
        header = "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m]"
        header += ", q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"
        files[f"mav0/{pose}/data.csv"] = rows(header, at, *value.T.tolist())
    return files


def stray_scanner(r: Recording) -> Files:
    t = [f"{5000 + x:.9f}" for x in r.imu.t.tolist()]
    header = "timestamp, a_x, a_y, a_z, alpha_x, alpha_y, alpha_z"
    accel = (-r.imu.accel / G).T.tolist()
    files = {"imu.csv": rows(header, t, *accel, *r.imu.gyro.T.tolist(), separator=", ")}
    if r.streams:
        pose = r.streams["pose"]
        place, q = _y_up(pose.value)
        at = [f"{5000 + x:.9f}" for x in pose.t.tolist()]
        frame = [f"{k:06d}" for k in range(len(at))]
        header = "timestamp, frame, x, y, z, qx, qy, qz, qw"
        columns = [*place.T.tolist(), *q[:, [1, 2, 3, 0]].T.tolist()]
        files["odometry.csv"] = rows(header, at, frame, *columns, separator=", ")
    return files


def _matrices(pose: np.ndarray) -> np.ndarray:
    """Rotation and place (m, 3, 4) in a world with y up."""
    place, q = _y_up(pose)
    turns = Rotation.from_quat(q, scalar_first=True).as_matrix()
    return np.concatenate([turns, place[:, :, None]], axis=2)


def _boot_ns(t: np.ndarray) -> list[int]:
    """Since the phone was switched on."""
    return (9_000_000_000_000 + np.rint(t * 1e9).astype(np.int64)).tolist()


def mars_csv(r: Recording, apple: bool = False) -> bytes:
    """gyro_accel.csv of MARS logger; of an iPhone 9.80 to a g."""
    head = "Timestamp[nanosec],gx[rad/s],gy[rad/s],gz[rad/s],ax[m/s^2],ay[m/s^2],az[m/s^2]"
    value = [*r.imu.gyro.T.tolist(), *(r.imu.accel * (9.80 / G if apple else 1.0)).T.tolist()]
    t = _boot_ns(r.imu.t)
    if apple:
        return rows(head.replace(",", ", "), t, *value, separator=", ")
    return rows(f"{head},Unix time[nanosec]", t, *value, stamps(r))


def mars_logger(r: Recording) -> Files:
    files = {"2026_01_02/gyro_accel.csv": mars_csv(r), "2026_01_02/frame_timestamps.txt": b"1\n"}
    if r.streams:
        pose = r.streams["pose"]
        place, q = _y_up(pose.value)
        head = "timestamp_ns,world_origin_id,tracking_state,tx_m,ty_m,tz_m,qx,qy,qz,qw"
        n = len(pose.t)
        text = [*place.T.tolist(), *q[:, [1, 2, 3, 0]].T.tolist()]
        columns = [_boot_ns(pose.t), [1] * n, ["TRACKING"] * n, *text]
        files["2026_01_02/arcore_poses.csv"] = rows(head, *columns)
    return files


def mars_logger_arkit(r: Recording) -> Files:
    """As newer versions for iOS write it."""
    names = [f"user_acceleration_{a}_g" for a in "xyz"]
    names += [f"rotation_rate_{a}_rad_s" for a in "xyz"] + [f"gravity_{a}_g" for a in "xyz"]
    head = ",".join(["motion_timestamp_s", "unix_timestamp_s", *names])
    down = np.tile([0.1, -0.2, -0.9], (len(r.imu.t), 1))
    t = [f"{ns / 1e9:.9f}" for ns in _boot_ns(r.imu.t)]
    value = np.hstack([-r.imu.accel / G - down, r.imu.gyro, down]).T.tolist()
    files = {"imu.csv": rows(head, t, t, *value)}
    if r.streams:
        pose = r.streams["pose"]
        n, matrices = len(pose.t), _matrices(pose.value)
        whole = np.concatenate([matrices, np.tile([0.0, 0.0, 0.0, 1.0], (n, 1, 1))], axis=1)
        names = [f"transform_m{row}{column}" for column in range(4) for row in range(4)]
        head = ",".join(["frame_timestamp_s", "unix_timestamp_s", *names, "tracking_state"])
        t = [f"{ns / 1e9:.9f}" for ns in _boot_ns(pose.t)]
        value = whole.transpose(0, 2, 1).reshape(n, 16).T.tolist()
        files["frames.csv"] = rows(head, t, t, *value, ["normal"] * n)
    return files


def data_logger(r: Recording, apple: bool = False) -> Files:
    """Of the apps by P. Kim; of an iPhone Apple's sign and 9.81 to a g."""

    def table(t: np.ndarray, *value: np.ndarray) -> bytes:
        return b"# Created at Thu Jan 02 in Seoul\n" + rows(
            "", _boot_ns(t), *np.hstack(value).T.tolist(), [""] * len(t), separator=" "
        )

    files = {
        "gyro_uncalib.txt": table(r.imu.t, r.imu.gyro),
        "gyro.txt": table(r.imu.t, r.imu.gyro * 0.9),
        "acce.txt": table(r.imu.t, r.imu.accel * (-9.81 / G if apple else 1.0)),
        ("heading.txt" if apple else "rv.txt"): b"# Created at Thu Jan 02 in Seoul\n",
    }
    if r.streams:
        mag, pose = r.streams["mag"], r.streams["pose"]
        files["magnet_uncalib.txt"] = table(mag.t, mag.value * 1e6)
        if apple:
            files["ARKit_camera_pose.txt"] = table(pose.t, _matrices(pose.value).reshape(-1, 12))
        else:
            place, q = _y_up(pose.value)
            files["ARCore_sensor_pose.txt"] = table(pose.t, q[:, [1, 2, 3, 0]], place)
    return files


def sensor_logger_database(r: Recording) -> bytes:
    """Of Android: a table a sensor, as the app's documentation reads it."""
    import sqlite3

    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "export.sqlite"
        database = sqlite3.connect(path)
        for sensor, value in (("Gyroscope", r.imu.gyro), ("Accelerometer", r.imu.accel)):
            _fill(database, f"{sensor}Uncalibrated", stamps(r), value)
        if r.streams:
            mag = r.streams["mag"]
            at = (START_NS + np.rint(mag.t * 1e9).astype(np.int64)).tolist()
            _fill(database, "MagnetometerUncalibrated", at, mag.value * 1e6)
        database.execute("CREATE TABLE Metadata (version TEXT, platform TEXT)")
        database.execute("INSERT INTO Metadata VALUES ('3', 'android')")
        database.commit()
        database.close()
        return path.read_bytes()


def _fill(database: Any, sensor: str, ns: list[int], value: np.ndarray) -> None:
    """Every value as text, z first, as the app's tables have it."""
    database.execute(f"CREATE TABLE {sensor} (time TEXT, seconds_elapsed TEXT, z, y, x)")
    lines = [(str(n), "0", repr(z), repr(y), repr(x))
             for n, (x, y, z) in zip(ns, value.tolist(), strict=True)]  # fmt: skip
    database.executemany(f"INSERT INTO {sensor} VALUES (?, ?, ?, ?, ?)", lines)


def ximu3(r: Recording) -> Files:
    us = [round(x * 1e6) for x in r.imu.t.tolist()]
    header = "Timestamp (us),Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s)"
    header += ",Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)"
    gyro, accel = np.degrees(r.imu.gyro).T.tolist(), (r.imu.accel / G).T.tolist()
    files = {"Inertial.csv": rows(header, us, *gyro, *accel)}
    if r.streams:
        mag, temperature = r.streams["mag"], r.streams["temperature"]
        at = [round(x * 1e6) for x in mag.t.tolist()]
        header = "Timestamp (us),Magnetometer X (uT),Magnetometer Y (uT),Magnetometer Z (uT)"
        files["Magnetometer.csv"] = rows(header, at, *(mag.value * 1e6).T.tolist())
        header = "Timestamp (us),Temperature (\u00b0C)"
        files["Temperature.csv"] = rows(header, at, temperature.value[:, 0].tolist())
    return files


def mt_manager(r: Recording) -> bytes:
    ticks = [(4294967296 - 5000 + round(x * 1e4)) % 4294967296 for x in r.imu.t.tolist()]
    head = "// General information:\n//  MT Manager version: 2021.2\n// Update Rate: 100.0Hz\n"
    header = "PacketCounter SampleTimeFine Acc_X Acc_Y Acc_Z Gyr_X Gyr_Y Gyr_Z Mag_X Mag_Y Mag_Z"
    count = [(65500 + k) % 65536 for k in range(len(ticks))]
    value = [*r.imu.accel.T.tolist(), *r.imu.gyro.T.tolist(), *r.imu.gyro.T.tolist()]
    text = rows("\t".join(header.split()), count, ticks, *value, separator="\t")
    return head.encode() + text


def dot(r: Recording) -> bytes:
    us = [round(x * 1e6) + 7_000_000 for x in r.imu.t.tolist()]
    head = "DeviceTag:,DOT 1\nFirmwareVersion:,2.0.0\nOutputRate:,100Hz\n\n"
    header = "PacketCounter,SampleTimeFine,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z"
    value = [*r.imu.accel.T.tolist(), *np.degrees(r.imu.gyro).T.tolist()]
    return head.encode() + rows(header, range(len(us)), us, *value)


def messages(
    r: Recording, types: Any, odometry: str = "", apart: tuple[str, ...] = ()
) -> list[tuple[str, str, int, object]]:
    """Topic, type, stamp in ns and message of rosbags' own types, in time. odometry: the type
    that holds the pose instead of a PoseStamped. apart: places each of which has a topic for the
    gyro and one for the accelerometer, the other half zero, as RealSense's driver makes them."""
    cls = types.types
    covariance, none = np.zeros(9), cls["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)

    def header(ns: int) -> object:
        sequence = {"seq": 7} if "seq" in cls["std_msgs/msg/Header"].__dataclass_fields__ else {}
        stamp = cls["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)
        return cls["std_msgs/msg/Header"](stamp=stamp, frame_id="body", **sequence)

    def vector(v: np.ndarray, kind: str = "Vector3") -> object:
        return cls[f"geometry_msgs/msg/{kind}"](*v.tolist())

    out: list[tuple[str, str, int, object]] = []
    name = "sensor_msgs/msg/Imu"
    for ns, g, f in zip(stamps(r), r.imu.gyro, r.imu.accel, strict=True):
        zero = np.zeros(3)
        halves = [(f"{place}/{sensor}/sample", *both) for place in apart
                  for sensor, both in (("gyro", (g, zero)), ("accel", (zero, f)))]  # fmt: skip
        for topic, rate, force in halves or [("/phone/imu", g, f)]:
            values = (none, covariance, vector(rate), covariance, vector(force), covariance)
            out.append((topic, name, ns, cls[name](header(ns), *values)))
    if not r.streams:
        return out
    name = "sensor_msgs/msg/MagneticField"
    for t, b in zip(r.streams["mag"].t.tolist(), r.streams["mag"].value, strict=True):
        ns = START_NS + round(t * 1e9)
        out.append(("/mag", name, ns, cls[name](header(ns), vector(b), covariance)))
    name = odometry or "geometry_msgs/msg/PoseStamped"
    for ns, p in zip(*_pose(r), strict=True):
        q = cls["geometry_msgs/msg/Quaternion"](*p[[4, 5, 6, 3]].tolist())
        pose = cls["geometry_msgs/msg/Pose"](vector(p[:3], "Point"), q)
        if name.endswith("Odometry"):
            twist = cls["geometry_msgs/msg/Twist"](vector(p[:3]), vector(p[:3]))
            rest = (
                "camera",
                cls["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
                cls["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
            )
        elif name.endswith("TransformStamped"):
            rest = ("a marker", cls["geometry_msgs/msg/Transform"](vector(p[:3]), q))
        else:
            rest = (pose,)
        out.append(("/vicon/somewhere", name, ns, cls[name](header(ns), *rest)))
    return sorted(out, key=lambda one: one[2])


def ros1_bag(
    r: Recording, compression: str = "", odometry: str = "", apart: tuple[str, ...] = ()
) -> bytes:
    """By the package rosbags."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS1_NOETIC)
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "a.bag"
        writer = Writer(path)
        if compression:
            writer.set_compression(Writer.CompressionFormat[compression])
        with writer:
            rows = messages(r, types, odometry, apart)
            _write(writer, rows, types, types.serialize_ros1)
        return path.read_bytes()


def ros2_bag(path: Path, r: Recording, storage: str = "SQLITE3", odometry: str = "",
             compression: str = "", apart: tuple[str, ...] = ()) -> Path:  # fmt: skip
    """A folder, by the package rosbags."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage])
    if compression:
        writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    with writer:
        _write(writer, messages(r, types, odometry, apart), types, types.serialize_cdr)
    return path


def _write(
    writer: Any, rows: list[tuple[str, str, int, object]], types: Any, serialize: Any
) -> None:
    connections: dict[str, object] = {}
    for topic, kind, ns, message in rows:
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, kind, typestore=types)
        writer.write(connections[topic], ns, bytes(serialize(message, kind)))


def database(r: Recording) -> bytes:
    """The .db3 of a ROS 2 bag alone."""
    with tempfile.TemporaryDirectory() as name:
        (file,) = ros2_bag(Path(name) / "bag", r).glob("*.db3")
        return file.read_bytes()


def ulog(
    r: Recording, raw: bool = True, parameters: Mapping[str, float] | None = None,
    later: Mapping[str, float] | None = None, second: Recording | None = None,
) -> bytes:  # fmt: skip
    """A log of PX4: a header, formats, the topics subscribed to, their data, x forward, y right
    and z down; raw also has a magnetometer (gauss) and a mocap's pose in a world with z down.
    parameters: as they stand at its beginning; later: as they are set behind the data. second: of
    raw topics the second instance, whose ids are 2."""
    stamps, turn = "uint64_t timestamp;uint64_t timestamp_sample;", np.array([1.0, -1.0, -1.0])
    if raw:
        fields = stamps + "uint32_t device_id;float x;float y;float z;float temperature;"
        formats = {"sensor_gyro": fields, "sensor_accel": fields}
        data = [[(us, us, 1, *v, 31.5) for us, v in zip(_us(r.imu.t), value.tolist(), strict=True)]
                for value in (r.imu.gyro * turn, r.imu.accel * turn)]  # fmt: skip
        layouts = ["<QQI4f", "<QQI4f"]
        if r.streams:
            mag, pose = r.streams["mag"], r.streams["pose"]
            formats["sensor_mag"] = stamps + "float x;float y;float z;"
            formats["vehicle_mocap_odometry"] = stamps + "float[3] position;float[4] q;"
            moved = np.hstack([pose.value[:, :3] * turn, _turned_alike(pose.value[:, 3:])])
            for t, value in ((mag.t, mag.value * turn * 1e4), (pose.t, moved)):
                table = zip(_us(t), value.tolist(), strict=True)
                data.append([(us, us, *v) for us, v in table])
            layouts += ["<QQ3f", "<QQ7f"]
    else:
        fields = "uint64_t timestamp;float[3] gyro_rad;int32_t accelerometer_timestamp_relative;"
        formats = {"sensor_combined": fields + "float[3] accelerometer_m_s2;"}
        turned = ((value * turn).tolist() for value in (r.imu.gyro, r.imu.accel))
        imu = zip(_us(r.imu.t), *turned, strict=True)
        data, layouts = [[(us, *g, 0, *f) for us, g, f in imu]], ["<Q3fi3f"]

    def message(kind: bytes, content: bytes) -> bytes:
        return struct.pack("<Hc", len(content), kind) + content

    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 5_000_000)

    def parameter(name: str, value: float) -> bytes:
        whole = isinstance(value, int)
        key = f"{'int32_t' if whole else 'float'} {name}".encode()
        number = struct.pack("<i" if whole else "<f", value)
        return message(b"P", bytes([len(key)]) + key + number)

    out += message(b"B", bytes(40))
    out += b"".join(parameter(*one) for one in (parameters or {}).items())
    for name, fields in formats.items():
        out += message(b"F", f"{name}:{fields}".encode())
    subscribed = [(name, 0) for name in formats]
    for name, value in (
        ()
        if second is None
        else (("sensor_gyro", second.imu.gyro), ("sensor_accel", second.imu.accel))
    ):
        subscribed.append((name, 1))
        layouts.append("<QQI4f")
        data.append(
            [
                (us, us, 2, *v, 31.5)
                for us, v in zip(_us(second.imu.t), (value * turn).tolist(), strict=True)
            ]
        )
    for id, (name, instance) in enumerate(subscribed):
        out += message(b"A", struct.pack("<BH", instance, id) + name.encode())
    for id, (table, layout) in enumerate(zip(data, layouts, strict=True)):
        for row in table:
            out += message(b"D", struct.pack("<H", id) + struct.pack(layout, *row))
    return out + b"".join(parameter(*one) for one in (later or {}).items())


def dataflash(
    r: Recording, raw: bool = False, parameters: Mapping[str, float] | None = None,
    later: Mapping[str, float] | None = None,
) -> bytes:  # fmt: skip
    """A log of ArduPilot: a format of each message, parameters, the messages of two IMUs, the
    second of which reads nothing, x forward, y right, z down; raw: GYR and ACC at full rate, and
    of IMU every fourth."""
    layouts = {
        "FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns"),
        "PARM": (64, "QNff", "TimeUS,Name,Value,Default"),
        "MSG": (65, "QZ", "TimeUS,Message"),
        "ATT": (66, "QccCE", "TimeUS,Roll,Pitch,Yaw,Far"),
        "GYR": (67, "QBQfff", "TimeUS,I,SampleUS,GyrX,GyrY,GyrZ"),
        "ACC": (68, "QBQfff", "TimeUS,I,SampleUS,AccX,AccY,AccZ"),
        "MAG": (69, "QBfff", "TimeUS,I,MagX,MagY,MagZ"),
        "IMU": (70, "QBffffffIIfBBHH",
                "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz"),
    }  # fmt: skip
    codes = {"n": "4s", "N": "16s", "Z": "64s", "c": "h", "C": "H", "E": "I"}

    def message(name: str, *values: Any) -> bytes:
        kind, types, _ = layouts[name]
        texts = [v.encode() if isinstance(v, str) else v for v in values]
        form = "<" + "".join(codes.get(t, t) for t in types)
        return b"\xa3\x95" + bytes([kind]) + struct.pack(form, *texts)

    def size(types: str) -> int:
        return 3 + struct.calcsize("<" + "".join(codes.get(t, t) for t in types))

    out = [message("FMT", kind, size(types), name, types, labels)
           for name, (kind, types, labels) in layouts.items()]  # fmt: skip
    out += [message("PARM", 1, *one, 0.0) for one in (parameters or {}).items()]
    out.append(message("MSG", 2, "ArduCopter V4.5.7"))
    turn = np.array([1.0, -1.0, -1.0])
    gyro, accel = ((value * turn).tolist() for value in (r.imu.gyro, r.imu.accel))
    for k, (us, g, f) in enumerate(zip(_us(r.imu.t), gyro, accel, strict=True)):
        if raw:
            out += [message("GYR", us + 90, 0, us, *g), message("ACC", us + 90, 0, us, *f)]
        if not raw or k % 4 == 0:
            rest = (0, 0, 31.5, 1, 1, 1000, 1000)
            out += [message("IMU", us, 0, *g, *f, *rest),
                    message("IMU", us + 1, 1, *([0.0] * 6), *rest)]  # fmt: skip
        if k % 20 == 0:
            out.append(message("ATT", us, 1, -2, 3, 4))
    if r.streams:
        mag = r.streams["mag"]
        table = zip(_us(mag.t), (mag.value * turn * 1e7).tolist(), strict=True)
        out += [message("MAG", us, 0, *v) for us, v in table]
    return b"".join([*out, *(message("PARM", 9, *one, 0.0) for one in (later or {}).items())])


def _turned_alike(q: np.ndarray) -> np.ndarray:
    """Attitudes w x y z where the axes of both body and world are turned by 180 deg about x."""
    turn = np.diag([1.0, -1.0, -1.0])
    matrices = turn @ Rotation.from_quat(q, scalar_first=True).as_matrix() @ turn
    return Rotation.from_matrix(matrices).as_quat(scalar_first=True)


def mat(r: Recording, compress: bool = True, **more: Any) -> bytes:
    """By scipy, lying and standing arrays."""
    from scipy.io import savemat

    out, imu = io.BytesIO(), r.imu
    arrays = {"t": imu.t, "gyro": imu.gyro, "accel": imu.accel.T, "note": "by hand", **more}
    savemat(out, arrays, do_compression=compress)
    return out.getvalue()


def parquet(r: Recording, **more: Any) -> bytes:
    """By pyarrow: time stamps of its own, the gyro in deg/s."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    out = pa.BufferOutputStream()
    columns: dict[str, Any] = {"time": pa.array(stamps(r), pa.timestamp("ns"))}
    for axis, g, f in zip("xyz", np.degrees(r.imu.gyro).T, r.imu.accel.T, strict=True):
        columns |= {f"g{axis} (deg/s)": pa.array(g), f"a{axis}": pa.array(f)}
    pq.write_table(pa.table({**columns, "remark": ["x"] * len(r.imu.t), **more}), out)
    return bytes(out.getvalue())


def npy(r: Recording) -> bytes:
    """By numpy: records with names."""
    out, imu = io.BytesIO(), r.imu
    names = ["t", *(f"{s}{axis}" for s in ("gyro_", "accel_") for axis in "xyz")]
    table = np.column_stack([imu.t, imu.gyro, imu.accel])
    np.save(out, np.rec.fromarrays(table.T, names=",".join(names)))
    return out.getvalue()


def _us(times: np.ndarray) -> list[int]:
    return [5_000_000 + round(t * 1e6) for t in times.tolist()]


# Of each format by its file: ending, and a recording written in it; folders come as zips.
WRITERS: dict[str, list[tuple[str, Callable[[Recording], bytes]]]] = {
    "ios_logger": [(".zip", lambda r: zipped(ios_logger(r)))],
    "phyphox": [
        (".zip", lambda r: zipped(phyphox(r))),
        (".xls", phyphox_xls),
        (".csv", phyphox_table),
    ],
    "euroc": [(".zip", lambda r: zipped(euroc(r)))],
    "stray_scanner": [(".zip", lambda r: zipped(stray_scanner(r)))],
    "mars_logger": [
        (".zip", lambda r: zipped(mars_logger(r))),
        (".zip", lambda r: zipped(mars_logger_arkit(r))),
        (".csv", mars_csv),
        (".csv", lambda r: mars_csv(r, apple=True)),
    ],
    "data_logger": [
        (".zip", lambda r: zipped(data_logger(r))),
        (".zip", lambda r: zipped(data_logger(r, apple=True))),
    ],
    "sensor_logger": [(".sqlite", sensor_logger_database)],
    "ximu3": [(".zip", lambda r: zipped(ximu3(r)))],
    "ros1_bag": [(".bag", ros1_bag)],
    "ros2_bag": [(".db3", database)],
    "px4_ulog": [(".ulg", ulog), (".ulg", lambda r: ulog(r, raw=False))],
    "ardupilot_bin": [(".bin", dataflash), (".bin", lambda r: dataflash(r, raw=True))],
    "matlab": [(".mat", mat), (".mat", lambda r: mat(r, compress=False))],
    "parquet": [(".parquet", parquet)],
    "numpy_array": [(".npy", npy)],
    "xsens": [(".txt", mt_manager), (".csv", dot)],
}


def small() -> Recording:
    """Of which a mutation hits something."""
    return sample(n=210, streams=False)
