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
