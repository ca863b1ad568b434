"""Runs the examples of MAVSDK-Python unmodified against the vehicle, each against a simulator of its own, and says what came of it.

    target/venv-mavsdk3/bin/python tests/python/mavsdk_examples.py FOLDER [NAME ...]

UPDATE_DOCS=1 writes the rows of those that ran into docs/mavsdk.md. FOLDER is `examples` of a checkout of https://github.com/mavlink/MAVSDK-Python for version 3 of MAVSDK. The examples use port 14540, so
that instance 0 must be free. Ends with 1 if an example did not do what is expected of it; docs/mavsdk.md has the outcomes.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from stack import TOP, Simulator

PAGE = TOP / "docs" / "mavsdk.md"
NOTES = {
    "calibration": "the gyroscope's works, the accelerometer's wants the vehicle turned by hand",
    "logfile_download": "after `takeoff_and_land`, else MAVSDK says NO_LOGFILES",
    "offboard_from_csv/offboard_from_csv": "with `anyio` installed beside MAVSDK",
}


@dataclass
class Example:
    """What is expected: the modes that are flown, in order; the height that is reached; how it ends."""

    modes: tuple = ()
    height_m: tuple = (0.0, 0.3)
    limit_s: float = 40.0
    # Interrupted after `limit_s`, because it never ends.
    endless: bool = False
    disarms: bool = False
    # Words of the error that it ends with.
    error: str = ""
    says: str = ""
    # An example that is run before it, until the vehicle has disarmed.
    before: str = ""


EXAMPLES = {
    "all_params": Example(says="SYS_AUTOSTART: 4001"),
    "calibration": Example(error="COMMAND_DENIED", says="Gyroscope calibration finished"),
    "do_orbit": Example(("takeoff", "orbit", "return"), (25.0, 31.0), 120.0, disarms=True),
    "failure_injection": Example(("takeoff", "hold", "land"), (15.0, 26.0), 90.0, disarms=True),
    "firmware_version": Example(says="flight_sw_major"),
    "follow_me_example": Example(("takeoff", "follow", "land"), (2.0, 3.0), 90.0, disarms=True),
    "geofence": Example(says="Geofence uploaded!"),
    "goto": Example(("takeoff", "hold"), (15.0, 21.0), 60.0, endless=True),
    "highres_imu": Example(endless=True, limit_s=10.0, says="HIGHRES_IMU (105)"),
    "logfile_download": Example(("takeoff", "land"), (2.0, 3.0), before="takeoff_and_land", says="Downloading: log 0"),
    "manual_control": Example(("takeoff", "position"), (2.0, 30.0), 40.0, endless=True),
    "mavlink_direct_receive": Example(endless=True, limit_s=10.0, says="ATTITUDE from 1/1"),
    "mavlink_direct_send": Example(says="Sending airspeed 19"),
    "mission": Example(("mission", "return"), (24.0, 31.0), 240.0, disarms=True),
    "mission_import": Example(says="Mission uploaded"),
    "mission_raw": Example(says="-- Done"),
    "offboard_attitude": Example(("offboard", "land"), (15.0, 60.0), 60.0, disarms=True),
    "offboard_from_csv/offboard_from_csv": Example(("offboard", "land"), (14.0, 17.0), 200.0),
    "offboard_position_ned": Example(("offboard",), (4.7, 6.0), 90.0),
    # Its landing is ended at once by the hold that `offboard.stop` asks for.
    "offboard_position_velocity_ned": Example(("offboard", "hold"), (9.5, 12.0), 90.0),
    "offboard_velocity_body": Example(("offboard", "hold"), (4.0, 6.0), 120.0),
    "offboard_velocity_ned": Example(("offboard", "hold"), (6.0, 9.0), 90.0),
    "rtcm": Example(),
    "send_status_message": Example(says="Connected to drone!"),
    "takeoff_and_land": Example(("takeoff", "land"), (2.0, 3.0), 60.0, disarms=True),
    "telemetry": Example(endless=True, limit_s=10.0, says="In air: False"),
    "telemetry_flight_mode": Example(endless=True, limit_s=10.0, says="FlightMode: HOLD"),
    "telemetry_is_armed_is_in_air": Example(endless=True, limit_s=10.0, says="Is_in_air: False"),
    "telemetry_status_text": Example(endless=True, limit_s=10.0, says="Connected to drone!"),
    "telemetry_takeoff_and_land": Example(("takeoff", "land"), (9.0, 10.5), 90.0, disarms=True),
    "tune": Example(says="Tune played"),
}


def flown(truth):
    """The modes, each once where it began."""
    modes = []
    for line in truth:
        if not modes or modes[-1] != line["mode"]:
            modes.append(line["mode"])
    return modes


def in_order(wanted, modes):
    rest = iter(modes)
    return all(mode in rest for mode in wanted)


def wait_until_disarmed(simulator, limit_s=200.0):
    limit = time.monotonic() + limit_s
    while time.monotonic() < limit and simulator.truth[-1]["armed"]:
        time.sleep(0.2)


def run(path, expected):
    """Runs one; the modes, the height, and what was not as expected."""
    with tempfile.TemporaryDirectory() as folder, Simulator(0, "wide_field.toml", folder) as simulator:
        if expected.before:
            subprocess.run([sys.executable, f"{expected.before}.py"], cwd=path.parent, check=True, timeout=60.0)
            wait_until_disarmed(simulator)
        with open(Path(folder) / "said", "w+", encoding="utf-8") as said:
            command = [sys.executable, "-u", path.name]
            child = subprocess.Popen(command, cwd=path.parent, stdin=subprocess.DEVNULL, stdout=said, stderr=subprocess.STDOUT,
                                     start_new_session=True)  # fmt: skip
            # MAVSDK 3 hangs in its end after an error: it is interrupted as if it were endless.
            started, is_over = time.monotonic(), False
            while time.monotonic() < started + expected.limit_s and not is_over:
                time.sleep(0.2)
                is_over = child.poll() is not None or bool(expected.error and expected.error in (Path(folder) / "said").read_text())
            ended_itself = child.poll() is not None
            if not ended_itself:
                child.send_signal(signal.SIGINT)
                try:
                    child.wait(5.0)
                except subprocess.TimeoutExpired:
                    child.kill()
                    child.wait()
            # The server that MAVSDK 3 starts outlives a script that is interrupted, and keeps the port.
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGKILL)
            said.seek(0)
            text = said.read()
        if expected.disarms:
            wait_until_disarmed(simulator)
        truth = simulator.truth
    modes, height = flown(truth), max(-line["position_ned_m"][2] for line in truth)
    wrong = []
    if expected.endless == ended_itself and not expected.error:
        wrong.append(f"ended by itself: {ended_itself}")
    if "Traceback" in text.split("KeyboardInterrupt")[0] and not expected.error and not expected.endless:
        wrong.append("an error")
    if expected.error and expected.error not in text:
        wrong.append(f"did not say {expected.error}")
    if expected.says not in text:
        wrong.append(f"did not say {expected.says}")
    if not in_order(expected.modes, modes):
        wrong.append(f"flew {modes}")
    if not expected.height_m[0] <= height <= expected.height_m[1]:
        wrong.append(f"highest {height:.1f} m")
    if expected.disarms and truth[-1]["armed"]:
        wrong.append("is armed at the end")
    return modes, height, wrong, text


def write_rows(outcomes):
    """Puts the outcomes {name: (outcome, modes, height)} into the page, beside the rows that are there."""
    text = PAGE.read_text(encoding="utf-8")
    begin, end = "<!-- examples: generated -->\n", "<!-- examples: end -->"
    before, rest = text.split(begin)
    written, after = rest.split(end, 1)
    rows = {line.split("`")[1]: line for line in written.splitlines() if line.startswith("- `")}
    for name, (outcome, modes, height) in outcomes.items():
        flight = [f"{', '.join(modes[1:])}, {height:.1f} m at most"] if len(modes) > 1 else []
        said = [outcome] * (outcome != "works") + flight + [NOTES[name]] * (name in NOTES)
        rows[name] = f"- `{name}`" + ": " * bool(said) + "; ".join(said)
    PAGE.write_text(before + begin + "\n".join(rows[name] for name in sorted(rows)) + "\n" + end + after, encoding="utf-8")


def main(folder, names):
    bad, outcomes = 0, {}
    for name in names or EXAMPLES:
        path = Path(folder) / f"{name}.py"
        if not path.exists():
            print(json.dumps({"example": name, "outcome": "not in the folder"}), flush=True)
            continue
        modes, height, wrong, text = run(path, EXAMPLES[name])
        bad += bool(wrong)
        outcome = "; ".join(wrong) or (f"ends with {EXAMPLES[name].error}" if EXAMPLES[name].error else "works")
        outcomes[name] = outcome, modes, height
        print(json.dumps({"example": name, "outcome": outcome, "modes": modes, "highest_m": round(height, 1)}), flush=True)
        if wrong:
            print(text[-1500:], file=sys.stderr)
    if os.environ.get("UPDATE_DOCS"):
        write_rows(outcomes)
    return 1 if bad else 0


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    sys.exit(main(sys.argv[1], sys.argv[2:]))
