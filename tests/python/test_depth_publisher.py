"""A driver in Python, by the documented interface alone, against the firmware and the checking command."""

import json
import subprocess
import sys
import threading
import time
from pathlib import Path

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


def test_nobody_publishing_is_said_with_where_to_look():
    code, findings = check()
    assert code == 3 and "none within 1 s" in findings["frames"]["text"]


def test_the_ros_bridges_cloud_is_projected_and_published_by_the_c_library():
    library = depth_bridge.DepthLibrary(str(Path(VIGIL).with_name("libvigil_depth.so")))
    # A wall 4 m ahead as a PointCloud2 lays it out: forward, left, up, and an intensity between.
    left, up = np.meshgrid(np.linspace(-8, 8, 400), np.linspace(-3, 3, 200))
    cloud = np.zeros(left.size + 1, dtype=[("x", "<f4"), ("i", "<f4"), ("y", "<f4"), ("z", "<f4")])
    cloud["x"], cloud["y"][:-1], cloud["z"][:-1] = 4.0, left.ravel(), up.ravel()
    cloud["x"][-1] = np.nan
    points = depth_bridge.points_of_cloud(cloud.tobytes(), len(cloud), 16, {"x": 0, "y": 8, "z": 12})
    assert not points[-1].any() and points[0].tolist() == [4.0, 8.0, 3.0]
    library.open(INSTANCE)
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
