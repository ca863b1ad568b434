"""A driver in Python, by the documented interface alone, against the firmware and the checking command."""

import json
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from stack import VIGIL

TOP = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(TOP / "tools" / "publishers" / "python"))
sys.path.insert(0, str(TOP / "tools" / "publishers" / "ros2"))
import depth_bridge  # noqa: E402
import vigil_depth  # noqa: E402

INSTANCE = 93


@pytest.fixture
def key_file(tmp_path):
    path = tmp_path / "depth.key"
    path.write_bytes(bytes(range(1, 33)))
    path.chmod(0o600)
    return path


class Driver:
    """Publishes a wall 2.5 m ahead, noisy as a sensor is, at 20 Hz, until it is left."""

    def __init__(self, key_file=None):
        self.publisher = vigil_depth.DepthPublisher(INSTANCE, sensor_id=1, key_file=key_file)
        self.end = threading.Event()
        self.thread = threading.Thread(target=self.run)

    def run(self):
        noise = np.random.default_rng(7)
        while not self.end.wait(0.05):
            ranges_m = 2.5 + noise.normal(0.0, 0.02, (vigil_depth.ROWS, vigil_depth.COLS))
            self.publisher.publish(ranges_m, (0.0, 0.0, -1.5), (1.0, 0.0, 0.0, 0.0))

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.end.set()
        self.thread.join()


def check(*arguments):
    done = subprocess.run(
        [VIGIL, "sensor", "check", "--instance", str(INSTANCE), "--seconds", "1", "-o", "-", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=60,
    )
    return done.returncode, {finding["name"]: finding for finding in json.loads(done.stdout)}


def frames_told_by_the_firmware(*arguments):
    firmware = subprocess.Popen(
        [VIGIL, "firmware", "--instance", str(INSTANCE), *map(str, arguments)], stdout=subprocess.PIPE, text=True
    )
    time.sleep(1.5)
    firmware.terminate()
    out = firmware.communicate(timeout=20)[0]
    return next(line for line in out.splitlines() if line.startswith("frames"))


def test_a_python_driver_keeps_to_the_interface_and_the_firmware_takes_its_frames():
    with Driver():
        code, findings = check("--wall", 2.5)
        told = frames_told_by_the_firmware()
    assert code == 0 and "warning" not in {findings[n]["severity"] for n in ("frames", "clock", "order") if n in findings}
    assert "2.50 m" in findings["wall"]["text"] or findings["wall"]["severity"] == "good", findings["wall"]
    used, refused = told.split()[1], told.split()[3]
    assert int(used) >= 10 and refused == "0", told


def test_with_a_key_its_frames_are_authentic_and_without_they_are_refused_by_name(key_file):
    with Driver(key_file):
        code, findings = check("--frame-key", key_file)
        told = frames_told_by_the_firmware("--frame-key", key_file)
    assert code == 0, findings
    assert int(told.split()[1]) >= 10 and told.split()[3] == "0", told
    with Driver():
        code, findings = check("--frame-key", key_file)
        told = frames_told_by_the_firmware("--frame-key", key_file)
    assert code == 3 and "authentication tag" in findings["frames"]["text"], findings
    assert told.split()[1] == "0" and "authentication" in told, told


@pytest.mark.parametrize("content", [b"no key", bytes(range(200, 250)), bytes(32)])
def test_a_file_that_is_no_key_is_refused_with_what_a_key_is(key_file, content):
    key_file.write_bytes(content)
    with pytest.raises(ValueError, match="depth.key is not a key: it needs 32 bytes"):
        vigil_depth.frame_key(key_file, 1)


def test_nobody_publishing_is_said_with_where_to_look():
    code, findings = check()
    assert code == 3 and "none within 1 s" in findings["frames"]["text"]


POSE = (0.0, 0.0, -1.5), (1.0, 0.0, 0.0, 0.0)
WALL = np.full((vigil_depth.ROWS, vigil_depth.COLS), 2.5)
#: Images of nothing, and of another unit: each would read as free space.
IMAGES_OF_NOTHING = {
    "not finite": np.full_like(WALL, np.nan),
    "nothing returned": np.full_like(WALL, np.inf),
    "zeros": np.zeros_like(WALL),
    "negative": -WALL,
    "all beyond 100 m": np.full_like(WALL, 240.0),
    "nearer than a metre, in millimetres": np.full_like(WALL, 900.0),
    "zeros as pixels": np.full_like(WALL, 1e-38),
    "masked": np.ma.masked_array(WALL, mask=True),
}
MILLIMETRES = WALL * 1000.0
MILLIMETRES[0, :] = 50.0  # the vehicle's own leg


def test_an_image_of_nothing_is_published_by_neither_driver_for_it_would_read_as_free_space():
    publisher = vigil_depth.DepthPublisher(INSTANCE - 4)
    library = c_library()
    for name, image in IMAGES_OF_NOTHING.items():
        with pytest.raises(ValueError, match="without a single range") as python:
            publisher.publish(image, *POSE)
        with pytest.raises(RuntimeError, match="without a single range") as other:
            library.publish(image, *POSE, time.monotonic_ns())
        assert "free space" in str(python.value) and "32768 " in str(python.value), name
        assert "free space" in str(other.value) and "32768 " in str(other.value), name
    for error, publish in ((ValueError, publisher.publish), (RuntimeError, stamped(library))):
        with pytest.raises(error, match="of millimetres, divide by 1000"):
            publish(MILLIMETRES, *POSE)
    # Nothing was counted as published; one pixel with a range is an image.
    one = np.full_like(WALL, np.nan)
    one[64, 128] = 99.0
    assert publisher.publish(one, *POSE) == 0 and publisher._frame.sequence == 0
    assert publisher._pixels[64, 128] == np.float32(0.99) and np.count_nonzero(publisher._pixels == 1.0) == WALL.size - 1
    library.close()


def stamped(library):
    return lambda ranges_m, position, attitude: library.publish(ranges_m, position, attitude, time.monotonic_ns())


def c_library(instance=INSTANCE - 1):
    library = depth_bridge.DepthLibrary(str(Path(VIGIL).with_name("examples") / "libvigil_depth.so"))
    library.open(instance)
    return library


def test_what_is_no_image_no_pose_and_no_stamp_is_refused_by_its_name_and_the_next_frame_goes_out():
    publisher, library = vigil_depth.DepthPublisher(INSTANCE - 3), c_library(INSTANCE - 5)
    for image, words in (
        (WALL > 0, "type bool"),
        (WALL.astype(str), "type <U"),
        (WALL + 0j, "type complex"),
        (WALL.astype(object), "type object"),
        (WALL[:64], "the shape"),
        (WALL.T, "the shape"),
        (WALL[None], "the shape"),
        (None, "type object"),
    ):
        with pytest.raises(ValueError, match=words):
            publisher.publish(image, *POSE)
        with pytest.raises(ValueError, match="ranges_m: real numbers of shape .128, 256. are needed"):
            stamped(library)(image, *POSE)
    level = (1.0, 0.0, 0.0, 0.0)
    for position, attitude, words in (
        ((0.0, 0.0), level, "position_ned_m"),
        ((0.0, 0.0, np.nan), level, "must be finite"),
        ((0.0, 0.0, 1e39), level, "must be finite"),
        ((0.0, 1e8, 0.0), level, "within 100 km"),
        (("0", "0", "-1.5"), level, "position_ned_m: real numbers"),
        ((True, True, True), level, "position_ned_m: real numbers"),
        ((0.0, 0.0, -1.5), (0.0, 0.0, 0.0, 0.0), "unit length"),
        ((0.0, 0.0, -1.5), (0.0, 0.0, 0.0, 1.2), "unit length"),
        ((0.0, 0.0, -1.5), (np.inf, 0.0, 0.0, 0.0), "unit length"),
        ((0.0, 0.0, -1.5), (1.0, 0.0, 0.0), "attitude_wxyz"),
        ((0.0, 0.0, -1.5), (1j, 0.0, 0.0, 0.0), "attitude_wxyz: real numbers"),
    ):
        with pytest.raises(ValueError, match=words):
            publisher.publish(WALL, position, attitude)
        with pytest.raises((ValueError, RuntimeError), match="position_ned_m|attitude_wxyz"):
            stamped(library)(WALL, position, attitude)
    now_ns = time.monotonic_ns()
    # The wall clock, the sensor's own since it was switched on, and what is no whole number.
    of_other_clocks = (time.time_ns(), now_ns + 10_000_000_000, now_ns - 2_000_000_000, 40_000_000_000 % now_ns, 0)
    for stamp_ns in (*of_other_clocks, -1, 2**64 + now_ns, True, 1.5, float(now_ns), "now"):
        with pytest.raises(ValueError, match="CLOCK_MONOTONIC"):
            publisher.publish(WALL, *POSE, stamp_ns=stamp_ns)
    for stamp_ns in of_other_clocks:
        with pytest.raises(RuntimeError, match="CLOCK_MONOTONIC"):
            library.publish(WALL, *POSE, stamp_ns)
    library.close()
    assert publisher.publish(WALL, *POSE, stamp_ns=now_ns) == 0
    with pytest.raises(ValueError, match="newer"):
        publisher.publish(WALL, *POSE, stamp_ns=now_ns)
    # Whole numbers of metres, and what an array masks, are as good as any.
    half = np.ma.masked_array(np.full(WALL.shape, 7), mask=np.arange(WALL.size).reshape(WALL.shape) % 2 == 1)
    publisher.publish(half, [0, 0, -1], [1, 0, 0, 0])
    assert publisher._pixels[0, :2].tolist() == [np.float32(0.07), 1.0]
    for wrong in ({"instance": 100}, {"sensor_id": -1}, {"sensor_id": 2**32}):
        with pytest.raises(ValueError, match="must be from 0 to"):
            vigil_depth.DepthPublisher(**{"instance": INSTANCE - 2} | wrong)


@dataclass
class Field:
    """sensor_msgs/PointField."""

    name: str
    offset: int
    datatype: int = 7
    count: int = 1


def header_at(sec, frame_id="os_lidar"):
    """std_msgs/Header."""
    return SimpleNamespace(frame_id=frame_id, stamp=SimpleNamespace(sec=sec, nanosec=0))


def cloud_of(array, fields, frame_id="os_lidar", **declared):
    """sensor_msgs/PointCloud2 of a structured array of one row, or several."""
    rows = np.atleast_2d(array)
    layout = {
        "header": header_at(0, frame_id),
        "height": rows.shape[0],
        "width": rows.shape[1],
        "fields": fields,
        "is_bigendian": False,
        "point_step": rows.itemsize,
        "row_step": rows.shape[1] * rows.itemsize,
        "data": rows.tobytes(),
        "is_dense": False,
    }
    return SimpleNamespace(**(layout | declared))


def wall_of_points(number="<f4", scale=1.0):
    """A wall 4 m ahead as a scanner's driver lays it out: forward, left, up, an intensity between; the last point did not return."""
    left, up = np.meshgrid(np.linspace(-8, 8, 400), np.linspace(-3, 3, 200))
    points = np.zeros(left.size + 1, dtype=[("x", number), ("i", "<f4"), ("y", number), ("z", number)])
    points["x"], points["y"][:-1], points["z"][:-1] = 4.0 * scale, left.ravel() * scale, up.ravel() * scale
    if np.dtype(number).kind == "f":
        points["x"][-1] = np.nan
    return points


def fields_of(points, datatype=7):
    return [Field(name, points.dtype.fields[name][1], datatype if name in "xyz" else 7) for name in points.dtype.names]


def test_the_ros_bridges_cloud_is_projected_and_published_by_the_c_library():
    points = depth_bridge.points_of_cloud(cloud_of(wall_of_points(), fields_of(wall_of_points())))
    assert not points[-1].any() and points[0].tolist() == [4.0, 8.0, 3.0]
    library = c_library(INSTANCE)
    noise, end = np.random.default_rng(3), threading.Event()

    def drive():
        while not end.wait(0.05):
            shaken = points * (1 + noise.normal(0.0, 0.002, (len(points), 1)))
            ranges_m = library.project(shaken, [0.0] * 6, 0.6, 0.6)
            library.publish(ranges_m, (0.0, 0.0, -1.5), (1.0, 0.0, 0.0, 0.0), time.monotonic_ns())

    # Its own thread: a publisher belongs to the one that opened it, here this one, so the check runs beside.
    found = []
    beside = threading.Thread(target=lambda: (found.append(check("--wall", 4)), end.set()))
    beside.start()
    drive()
    beside.join()
    library.close()
    code, findings = found[0]
    assert code == 0 and findings["wall"]["severity"] == "good", findings
    with pytest.raises(RuntimeError, match="angle between beams"):
        library.project(points, [0.0] * 6, 0.0, 0.6)
    # A cloud of nothing, and one in millimetres, are no free space.
    for nothing in (np.zeros((0, 3)), np.zeros((500, 3)), np.full((500, 3), np.nan), np.full((9, 3), 300.0)):
        with pytest.raises(RuntimeError, match="no free space"):
            library.project(nothing, [0.0] * 6, 0.6, 0.6)
    with pytest.raises(RuntimeError, match="divide by 1000"):
        library.project(points * 1000, [0.0] * 6, 0.6, 0.6)
    # A sensor that measured, but nothing in view, gives an image without a range: others may fill it.
    assert np.isinf(library.project(np.full((9, 3), -5.0), [0.0] * 6, 0.6, 0.6)).all()


def test_the_ros_bridge_reads_the_layout_that_a_cloud_declares():
    usual = wall_of_points()
    expected = depth_bridge.points_of_cloud(cloud_of(usual, fields_of(usual)))

    def same(cloud):
        return np.allclose(depth_bridge.points_of_cloud(cloud), expected, atol=1e-6)

    double = wall_of_points("<f8")
    assert same(cloud_of(double, fields_of(double, 8)))
    assert same(cloud_of(double, fields_of(double, 8)[::-1])), "fields come in any order"
    big = wall_of_points(">f4")
    assert same(cloud_of(big, fields_of(big), is_bigendian=True))
    # Rows that are padded, as an organised cloud's may be; the last without its padding.
    rows = usual[:-1].reshape(200, 400)
    step = 400 * 16 + 48
    padded = np.zeros((200, step), np.uint8)
    padded[:, : 400 * 16] = rows.view(np.uint8).reshape(200, -1)
    for data in (padded.tobytes(), padded.tobytes()[:-48]):
        read = depth_bridge.points_of_cloud(cloud_of(rows, fields_of(rows), row_step=step, data=data))
        assert np.allclose(read, expected[:-1])
    # A depth camera's: right, down, forward.
    optical = usual.copy()
    optical["x"], optical["y"], optical["z"] = -usual["y"], -usual["z"], usual["x"]
    assert same(cloud_of(optical, fields_of(optical), frame_id="camera_depth_optical_frame"))


def test_a_cloud_that_the_ros_bridge_cannot_read_is_refused_by_what_it_is():
    usual = wall_of_points()
    whole = wall_of_points("<i2", 1000.0)
    no_z = [field for field in fields_of(usual) if field.name != "z"]
    three = [Field("x", 0, 7, 3), Field("y", 4), Field("z", 8)]
    twice = [Field("x", 0), Field("y", 0), Field("z", 2)]
    for cloud, words in (
        (cloud_of(whole, fields_of(whole, 3)), "x is INT16"),
        (cloud_of(usual, fields_of(usual, 11)), "unknown type 11"),
        (cloud_of(usual, three), "x is FLOAT32 x 3"),
        (cloud_of(usual, twice), "share bytes: they begin at 0, 0, 2"),
        (cloud_of(usual, no_z), "no field z, only x, i, y"),
        (cloud_of(usual, []), "none at all"),
        (cloud_of(usual, fields_of(usual), point_step=12), "z at byte 12 is not within its points of 12 bytes"),
        (cloud_of(usual, fields_of(usual), data=usual.tobytes()[:-1]), "1280015 bytes, 1280016 are declared"),
        (cloud_of(usual[:0], fields_of(usual)), "not one point"),
        (cloud_of(usual[:-1].reshape(2, -1), fields_of(usual), row_step=9), "rows of 9 bytes"),
    ):
        with pytest.raises(ValueError, match=words):
            depth_bridge.points_of_cloud(cloud)


def test_the_ros_node_publishes_what_it_can_read_and_says_why_where_it_publishes_nothing(monkeypatch):
    """The node's own code; what stands for ROS hands it the messages."""
    usual, double = wall_of_points(), wall_of_points("<f8")
    clouds = [
        (cloud_of(usual, fields_of(usual)), None),
        (cloud_of(double, fields_of(double, 8)), None),
        (cloud_of(double, fields_of(double, 5)), "x is INT32"),
        (cloud_of(usual[:0], fields_of(usual)), "not one point"),
        (cloud_of(usual[-1:], fields_of(usual)), "no free space"),
        (cloud_of(wall_of_points(scale=1000.0), fields_of(usual)), "divide by 1000"),
        (cloud_of(usual, fields_of(usual), header=header_at(2)), "odometry is 2.000 s from the cloud's stamp"),
    ]
    published, said = [], []
    parameters = {"library": str(Path(VIGIL).with_name("examples") / "libvigil_depth.so"), "instance": INSTANCE, "restamp": True}

    class Node:
        def __init__(self, name):
            self.heard = {}

        def declare_parameter(self, name, usual):
            return SimpleNamespace(value=parameters.get(name, usual))

        def create_subscription(self, kind, topic, callback, qos):
            self.heard[topic] = callback

        def get_logger(self):
            return SimpleNamespace(warning=lambda text, **_: said.append(text))

    def spin(node):
        publish = node.library.publish
        node.library.publish = lambda *given: published.append(publish(*given))
        node.heard["points"](clouds[0][0])
        assert "no odometry yet" in said.pop()
        place, turn = SimpleNamespace(x=0.0, y=0.0, z=1.5), SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
        for quaternion in (SimpleNamespace(x=0.0, y=0.0, z=0.0, w=0.0), turn):
            pose = SimpleNamespace(position=place, orientation=quaternion)
            node.heard["odometry"](SimpleNamespace(header=header_at(0), pose=SimpleNamespace(pose=pose)))
            if quaternion is not turn:
                node.heard["points"](clouds[0][0])
                assert "unit length" in said.pop() and not published
        for number, (cloud, words) in enumerate(clouds):
            node.heard["points"](cloud)
            assert words in said.pop() if words else not said, (number, said)

    modules = {
        "rclpy": {"init": lambda: None, "spin": spin},
        "rclpy.node": {"Node": Node},
        "rclpy.qos": {"qos_profile_sensor_data": None},
        "nav_msgs.msg": {"Odometry": object},
        "sensor_msgs.msg": {"PointCloud2": object},
        "nav_msgs": {},
        "sensor_msgs": {},
    }
    for name, names in modules.items():
        monkeypatch.setitem(sys.modules, name, SimpleNamespace(**names))
    depth_bridge.main()
    assert published == [0, 0]


def test_the_ros_bridge_turns_poses_and_stamps_into_ours_and_refuses_another_clock():
    # Facing east is yaw 0 in ENU, 90 degrees clockwise from north in NED.
    position, attitude = depth_bridge.pose_of_odometry((1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))
    assert position == [2.0, 1.0, -3.0] and np.allclose(attitude, [np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
    # Rolled right by 0.2 rad while facing north: yaw 90 degrees in ENU.
    yaw, roll = np.array([np.cos(np.pi / 4), 0, 0, np.sin(np.pi / 4)]), np.array([np.cos(0.1), np.sin(0.1), 0, 0])
    w, x, y, z = (
        yaw[0] * roll[0],
        yaw[0] * roll[1],
        yaw[3] * roll[1],
        yaw[3] * roll[0],
    )
    _, attitude = depth_bridge.pose_of_odometry((0, 0, 0), (x, y, z, w))
    assert np.allclose(attitude, [np.cos(0.1), np.sin(0.1), 0, 0])
    assert depth_bridge.monotonic_of(5_000_000_000, 5_010_000_000, 90_000_000_000) == 89_990_000_000
    with pytest.raises(ValueError, match="synchronise the clocks"):
        depth_bridge.monotonic_of(0, 5_000_000_000, 90_000_000_000)
    # A frame has the pose of its own moment, and none of one for which no pose was reported.
    poses = [(0, "then"), (40_000_000, "now")]
    assert depth_bridge.pose_at(poses, 10_000_000) == "then" and depth_bridge.pose_at(poses, 90_000_000) == "now"
    with pytest.raises(ValueError, match="the nearest odometry is 0.160 s from the cloud's stamp"):
        depth_bridge.pose_at(poses, 200_000_000)
