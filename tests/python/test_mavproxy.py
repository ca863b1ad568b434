"""A MAVProxy session by script: signing, parameters, waypoints, files, arming, a flight and its log, as a person types it.

The vehicle obeys signed packets only, so that whatever works here was signed by MAVProxy.
"""

import hashlib
import os
import re
import subprocess
import threading
import time

import pytest

from stack import free_simulator, venv_python

PASS = "correct-horse-battery"
LIMIT_S = 60.0
MISSION = """QGC WPL 110
0\t1\t0\t16\t0\t0\t0\t0\t47.397742\t8.545594\t488\t1
1\t0\t3\t22\t0\t0\t0\t0\t47.397742\t8.545594\t3\t1
2\t0\t3\t16\t0\t1\t0\t0\t47.397800\t8.545594\t3\t1
3\t0\t3\t21\t0\t0\t0\t0\t47.397800\t8.545594\t0\t1
"""


class Session:
    """Types commands and waits for what MAVProxy prints."""

    def __init__(self, instance, folder):
        binary = venv_python("mavproxy").parent / "mavproxy.py"
        command = [venv_python("mavproxy"), "-u", binary, f"--master=udpin:127.0.0.1:{14540 + instance}"]
        command += ["--source-system=255", f"--state-basedir={folder}", "--nowait"]
        command += ["--default-modules=arm,cmdlong,ftp,link,log,mode,param,signing,wp"]
        env = {**os.environ, "MAVLINK20": "1", "HOME": str(folder)}
        pipe = subprocess.PIPE
        self.child = subprocess.Popen(
            [str(part) for part in command], cwd=folder, env=env, stdin=pipe, stdout=pipe, stderr=subprocess.STDOUT, text=True
        )
        self.text = ""
        self.seen = 0
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        while character := self.child.stdout.read(1):
            self.text += character

    def type(self, line):
        self.child.stdin.write(line + "\n")
        self.child.stdin.flush()

    def expect(self, pattern, limit_s=LIMIT_S, again=None):
        """Waits for a pattern behind what was expected before; types `again`, a line or more, every few seconds: a request may be lost."""
        begin = time.monotonic()
        typed = begin
        while not (found := re.compile(pattern).search(self.text, self.seen)):
            now = time.monotonic()
            assert now < begin + limit_s and self.child.poll() is None, f"no {pattern!r} in:\n{self.text[self.seen - 300 :]}"
            if again and now > typed + 4.0:
                self.type(again)
                typed = now
            time.sleep(0.02)
        self.seen = found.end()
        return found

    def does(self, line, pattern, **more):
        self.type(line)
        return self.expect(pattern, **more)

    def end(self):
        self.child.kill()
        self.child.wait()


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """The session, told as what it found."""
    folder = tmp_path_factory.mktemp("mavproxy")
    key = folder / "vigil.key"
    key.touch(0o600)
    key.write_text(hashlib.sha256(PASS.encode()).hexdigest())
    mission, local = folder / "mission.txt", folder / "local.txt"
    mission.write_text(MISSION)
    local.write_text("a file for the vehicle\n" * 40)
    with free_simulator("open_field.toml", folder, "--signing-key", key, "--allow-unsigned", "never") as simulator:
        session = Session(simulator.instance, folder)
        report = {}
        try:
            session.expect("online system")
            session.type("arm throttle")
            time.sleep(1.5)
            report["armed unsigned"] = any(line["armed"] for line in simulator.truth)
            session.type(f"signing key {PASS}")
            session.does("param fetch", r"Received \d+ parameters", again="param fetch")
            # A list asked for once more above may arrive late, and MAVProxy then shows the value of before: set it again, not only show it.
            height = "param set MIS_TAKEOFF_ALT 3\nparam show MIS_TAKEOFF_ALT"
            report["height"] = session.does(height, r"MIS_TAKEOFF_ALT +(3[0-9.]*)", again=height).group(1)
            session.does(f"wp load {mission}", r"Loaded 4 waypoints")
            session.expect(r"Sent all 4 waypoints|MISSION_ACCEPTED")
            session.does("wp list", r"Saved 4 waypoints to", again="wp list")
            session.does(f"ftp put {local} /there.txt", r"100|[Dd]one|[Pp]ut|Sent")
            session.does("ftp list /", r"there\.txt\s+920", again="ftp list /")
            back = folder / "back.txt"
            session.type(f"ftp get /there.txt {back}")
            limit = time.monotonic() + LIMIT_S
            while not (back.exists() and back.stat().st_size == 920) and time.monotonic() < limit:
                time.sleep(0.1)
            report["file"] = back.read_text() == local.read_text()
            session.does("arm throttle", "ARMED", again="arm throttle")
            session.does("long DO_SET_MODE 1 4 4", "Mode MISSION", again="long DO_SET_MODE 1 4 4")
            session.expect("DISARMED", limit_s=120.0)
            session.does("log list", r"Log 0 +numLogs 1", again="log list")
            log = folder / "log.ulg"
            session.type(f"log download 0 {log}")
            session.expect("Finished downloading")
            report["log"] = log.read_bytes()
            # The simulator tells the truth five times a second: what MAVProxy has just heard may not have been told yet.
            limit = time.monotonic() + 5.0
            while simulator.truth[-1]["armed"] and time.monotonic() < limit:
                time.sleep(0.1)
            report["truth"] = simulator.truth
        finally:
            session.end()
    return report


def test_an_unsigned_station_is_not_obeyed(flown):
    assert flown["armed unsigned"] is False


def test_parameters_and_files_go_there_and_back(flown):
    assert float(flown["height"]) == 3.0 and flown["file"]


def test_a_mission_is_loaded_flown_and_logged(flown):
    truth = flown["truth"]
    assert max(line["position_ned_m"][0] for line in truth) > 5.0, "flew north"
    assert truth[-1]["armed"] is False and -truth[-1]["position_ned_m"][2] < 0.3
    assert flown["log"].startswith(b"ULog\x01\x12\x35") and b"vehicle_status" in flown["log"]
