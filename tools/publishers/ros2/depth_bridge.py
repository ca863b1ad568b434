"""Publishes a ROS 2 point cloud as Vigil's depth frames: docs/sensor-interface.md, "ROS 2".

    cargo build --release -p vigil-sensors --example vigil_depth
    python3 depth_bridge.py --ros-args -p library:=target/release/examples/libvigil_depth.so \
        -r points:=/ouster/points -r odometry:=/mavros/local_position/odom

Subscribes to `points` (sensor_msgs/PointCloud2, x, y, z of either float; axes forward, left, up, or a camera's optical ones) and
`odometry` (nav_msgs/Odometry, ENU and forward-left-up, the vehicle's local frame). What does not need ROS is above the node and tested by
tests/python/test_depth_publisher.py; the node itself was not run against ROS.
"""

import ctypes
import math
import time
from collections import deque

import numpy as np

PIXELS = 128 * 256
FLOATS = ctypes.POINTER(ctypes.c_float)
#: Odometry that is kept, and how far from a cloud's stamp the nearest of it may be.
POSES = 200
MOST_APART_NS = 100_000_000


def _floats(array: np.ndarray):
    return array.ctypes.data_as(FLOATS)


def _reals(values, what: str, *shapes: tuple[int, ...]) -> np.ndarray:
    """Real numbers of one of some shapes (-1 is any size) as float32; what is masked becomes NaN."""
    given = np.ma.asanyarray(values)
    fits = [len(s) == given.ndim and all(want in (-1, got) for want, got in zip(s, given.shape)) for s in shapes]
    if given.dtype.kind not in "fiu" or not any(fits):
        raise ValueError(f"{what}: real numbers of shape {shapes[0]} are needed, got {given.dtype} of shape {given.shape}")
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(np.ma.filled(given.astype(np.float64), np.nan), dtype=np.float32)


class DepthLibrary:
    """libvigil_depth.so: projects clouds, publishes images. A RuntimeError says what went wrong."""

    def __init__(self, path: str):
        lib = ctypes.CDLL(path)
        lib.vigil_depth_open.restype = ctypes.c_void_p
        lib.vigil_depth_open.argtypes = [ctypes.c_uint32, ctypes.c_uint32, ctypes.c_char_p]
        lib.vigil_depth_publish.argtypes = [ctypes.c_void_p, FLOATS, FLOATS, FLOATS, ctypes.c_uint64]
        lib.vigil_depth_project_points.argtypes = [FLOATS, ctypes.c_size_t, FLOATS, ctypes.c_float, ctypes.c_float, FLOATS]
        lib.vigil_depth_error.restype = ctypes.c_char_p
        lib.vigil_depth_close.argtypes = [ctypes.c_void_p]
        self._lib, self._publisher = lib, None

    def _checked(self, result: int) -> int:
        if result < 0:
            raise RuntimeError(self._lib.vigil_depth_error().decode())
        return result

    def open(self, instance: int = 0, sensor_id: int = 1, key_file: str | None = None) -> None:
        self._publisher = self._lib.vigil_depth_open(instance, sensor_id, key_file.encode() if key_file else None)
        if not self._publisher:
            raise RuntimeError(self._lib.vigil_depth_error().decode())

    def project(self, points_frd_m: np.ndarray, mount, across_deg: float, down_deg: float) -> np.ndarray:
        """Ranges of the image, metres, infinity for no return; (n, 3) points forward, right, down."""
        points = _reals(points_frd_m, "points", (-1, 3))
        place, ranges_m = _reals(mount, "mount (x, y, z, roll, pitch, yaw)", (6,)), np.empty(PIXELS, dtype=np.float32)
        self._checked(
            self._lib.vigil_depth_project_points(
                _floats(points), len(points), _floats(place), across_deg, down_deg, _floats(ranges_m)
            )
        )
        return ranges_m

    def publish(self, ranges_m: np.ndarray, position_ned_m, attitude_wxyz, stamp_ns: int) -> int:
        """Returns the number of readers."""
        ranges_m = _reals(ranges_m, "ranges_m", (128, 256), (PIXELS,))
        position, attitude = _reals(position_ned_m, "position_ned_m", (3,)), _reals(attitude_wxyz, "attitude_wxyz", (4,))
        return self._checked(
            self._lib.vigil_depth_publish(
                self._publisher, _floats(ranges_m), _floats(position), _floats(attitude), stamp_ns
            )
        )

    def close(self) -> None:
        self._lib.vigil_depth_close(self._publisher)
        self._publisher = None


#: sensor_msgs/PointField: the numbers by their `datatype`, and those that a coordinate in metres can be.
NUMBERS = {1: "INT8", 2: "UINT8", 3: "INT16", 4: "UINT16", 5: "INT32", 6: "UINT32", 7: "FLOAT32", 8: "FLOAT64"}
COORDINATES = {7: "f4", 8: "f8"}


def points_of_cloud(cloud) -> np.ndarray:
    """Points of a sensor_msgs/PointCloud2 as (n, 3) forward, right, down; a point that is not finite is no return.

    Reads the layout that the message declares. Raises a ValueError that names what cannot be read. Axes are forward, left, up, or of
    a frame whose name ends in `_optical` or `_optical_frame` right, down, forward (REP 103).
    """
    fields = {field.name: field for field in cloud.fields}
    if missing := [axis for axis in "xyz" if axis not in fields]:
        raise ValueError(f"the cloud has no field {', '.join(missing)}, only {', '.join(fields) or 'none at all'}")
    order = ">" if cloud.is_bigendian else "<"
    formats = []
    for axis in "xyz":
        field = fields[axis]
        if field.datatype not in COORDINATES or field.count not in (0, 1):
            number = NUMBERS.get(field.datatype, f"of the unknown type {field.datatype}")
            raise ValueError(f"the cloud's {axis} is {number} x {field.count}; one FLOAT32 or FLOAT64 of metres is needed")
        formats.append(order + COORDINATES[field.datatype])
        if not 0 <= field.offset <= cloud.point_step - int(formats[-1][-1]):
            raise ValueError(f"the cloud's {axis} at byte {field.offset} is not within its points of {cloud.point_step} bytes")
    spans = sorted((fields[axis].offset, fields[axis].offset + int(form[-1])) for axis, form in zip("xyz", formats))
    if any(end > begin for (_, end), (begin, _) in zip(spans, spans[1:])):
        raise ValueError(f"the cloud's x, y and z share bytes: they begin at {', '.join(str(begin) for begin, _ in spans)}")
    if cloud.row_step < cloud.width * cloud.point_step and cloud.height > 1:
        raise ValueError(f"the cloud's rows of {cloud.row_step} bytes are shorter than {cloud.width} x {cloud.point_step}")
    data = np.frombuffer(bytes(cloud.data), dtype=np.uint8)
    # The last row may end with its last point.
    row_step = cloud.row_step if cloud.height > 1 else cloud.width * cloud.point_step
    needed = (cloud.height - 1) * row_step + cloud.width * cloud.point_step if cloud.width * cloud.height else 0
    if len(data) < needed:
        raise ValueError(f"the cloud has {len(data)} bytes, {needed} are declared: {cloud.height} x {cloud.width} points")
    if needed == 0:
        raise ValueError("the cloud has not one point: that is no free space")
    layout = np.dtype(
        {"names": list("xyz"), "formats": formats, "offsets": [fields[k].offset for k in "xyz"], "itemsize": cloud.point_step}
    )
    read = np.ndarray((cloud.height, cloud.width), layout, data, strides=(row_step, cloud.point_step))
    with np.errstate(over="ignore"):
        x, y, z = (read[axis].ravel().astype(np.float32) for axis in "xyz")
    is_optical = cloud.header.frame_id.endswith(("_optical", "_optical_frame"))
    points = np.stack([z, x, y] if is_optical else [x, -y, -z], axis=1)
    points[~np.isfinite(points).all(axis=1)] = 0.0
    return points


def pose_of_odometry(position_enu_m, attitude_xyzw) -> tuple[list[float], list[float]]:
    """ENU position and forward-left-up to ENU quaternion as NED position and body (FRD) to NED quaternion w, x, y, z."""
    east, north, up = position_enu_m
    x, y, z, w = attitude_xyzw
    # (0, s, s, 0) turns ENU into NED; (0, 1, 0, 0) turns forward-right-down into forward-left-up.
    s = math.sqrt(0.5)
    return [north, east, -up], [s * (w + z), s * (x + y), s * (x - y), s * (w - z)]


def monotonic_of(stamp_ns: int, now_wall_ns: int, now_monotonic_ns: int) -> int:
    """A stamp of the system's clock on CLOCK_MONOTONIC; refuses one that is not of this machine's clock."""
    age_ns = now_wall_ns - stamp_ns
    if not -50_000_000 <= age_ns <= 1_000_000_000:
        raise ValueError(f"a cloud's stamp is {age_ns * 1e-9:.3f} s old by this machine's clock: synchronise the clocks")
    return now_monotonic_ns - age_ns


def stamp_of(header) -> int:
    """The nanoseconds of a std_msgs/Header."""
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


def pose_at(poses, stamp_ns: int):
    """The pose reported nearest to a stamp, the later of two; `poses` are (stamp in nanoseconds, pose), the newest last."""
    if not poses:
        raise ValueError("no odometry yet")
    reported_ns, pose = min(reversed(poses), key=lambda reported: abs(reported[0] - stamp_ns))
    if (apart_ns := abs(reported_ns - stamp_ns)) > MOST_APART_NS:
        raise ValueError(f"the nearest odometry is {apart_ns * 1e-9:.3f} s from the cloud's stamp")
    return pose


def main() -> None:
    import rclpy
    from nav_msgs.msg import Odometry
    from rclpy.node import Node
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import PointCloud2

    class DepthBridge(Node):
        def __init__(self):
            super().__init__("vigil_depth_bridge")
            value = lambda name, usual: self.declare_parameter(name, usual).value  # noqa: E731
            self.library = DepthLibrary(value("library", "libvigil_depth.so"))
            self.library.open(value("instance", 0), value("sensor_id", 1), value("key_file", "") or None)
            self.mount = value("mount", [0.0] * 6)
            self.restamp = value("restamp", False)
            self.resolution = value("across_deg", 0.352), value("down_deg", 0.704)
            self.poses = deque(maxlen=POSES)
            self.create_subscription(Odometry, "odometry", self.on_odometry, qos_profile_sensor_data)
            self.create_subscription(PointCloud2, "points", self.on_points, qos_profile_sensor_data)

        def on_odometry(self, message):
            p, q = message.pose.pose.position, message.pose.pose.orientation
            self.poses.append((stamp_of(message.header), pose_of_odometry((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))))

        def on_points(self, message):
            stamp_ns = stamp_of(message.header)
            try:
                pose = pose_at(self.poses, stamp_ns)
                now_ns = time.monotonic_ns()
                stamp_ns = now_ns if self.restamp else monotonic_of(stamp_ns, time.time_ns(), now_ns)
                ranges_m = self.library.project(points_of_cloud(message), self.mount, *self.resolution)
                self.library.publish(ranges_m, *pose, stamp_ns)
            except (RuntimeError, ValueError) as error:
                self.get_logger().warning(f"no frame: {error}", throttle_duration_sec=10.0)

    rclpy.init()
    node = DepthBridge()
    try:
        rclpy.spin(node)
    finally:
        node.library.close()


if __name__ == "__main__":
    main()
