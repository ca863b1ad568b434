"""The scripts of tools/scripts do what docs/scripting.md says, each run as a person would run it."""

import re

import pytest
from pyulog import ULog

from stack import TOP, Firmware, Process, free_simulator, venv_python

SCRIPTS = TOP / "tools" / "scripts"
PARAMETERS = {1: {"MIS_TAKEOFF_ALT": 2.5, "COM_OBL_RC_ACT": 5}, 191: {"GD_SPEED_LIM": 1.5, "GD_AT_GOAL": 0}}


def script(name, environment, simulator, folder, *arguments):
    """A script against a simulator."""
    scheme = "udpin://" if environment.startswith("mavsdk") else "udpin:"
    connection = f"{scheme}127.0.0.1:{14540 + simulator.instance}"
    command = [venv_python(environment), "-u", SCRIPTS / f"{name}.py", "--connection", connection, *arguments]
    return Process(f"{name}-{len(list(folder.iterdir()))}", command, folder)


def run(*details):
    """Runs a script to its end; what it printed."""
    with script(*details) as process:
        code = process.wait(120.0)
        assert code == 0, process.said()
        return "".join(process.lines)


@pytest.fixture(scope="module")
def sides(tmp_path_factory):
    """Two vehicles side by side: one flies a square, one is guided to a goal. Both flights' outputs, then the rest."""
    folder = tmp_path_factory.mktemp("scripts")
    with free_simulator("open_field.toml", folder) as square, free_simulator("mission_course.toml", folder) as guided:
        with Firmware(guided.instance, folder):
            goal = ("--north", "20", "--east", "-3", "--height", "3")
            with script("fly_to_goal", "pymavlink", guided, folder, *goal) as going:
                flown = run("arm_and_fly", "mavsdk4", square, folder, "--side", "3")
                code = going.wait(120.0)
                assert code == 0, going.said()
            going.lines.append(run("fly_to_goal", "pymavlink", guided, folder, "--north", "17", "--east", "-3", "--land"))
            lists = {c: run("param_dump", "pymavlink", guided, folder, "--component", c) for c in PARAMETERS}
        log = folder / "flight.ulg"
        logs = run("log_download", "mavsdk4", square, folder, "--list")
        run("log_download", "mavsdk4", square, folder, log)
        yield {
            "square": (flown, square.truth),
            "guided": ("".join(going.lines), guided.truth),
            "parameters": lists,
            "logs": (logs, log.read_bytes()),
        }


def test_arm_and_fly_flies_a_square_and_lands(sides):
    said, truth = sides["square"]
    assert said.rstrip().endswith("landed and disarmed")
    assert truth[-1]["armed"] is False and 2.5 < max(-line["position_ned_m"][2] for line in truth) < 3.6
    places = [line["position_ned_m"][:2] for line in truth if line["mode"] == "offboard"]
    for axis in (0, 1):
        extent = max(p[axis] for p in places) - min(p[axis] for p in places)
        # A square of 3 m turned by 30 degrees is 4.1 m wide; rounded corners make it somewhat smaller or larger.
        assert 2.5 < extent < 5.5


def test_fly_to_goal_arrives_shows_the_way_goes_on_to_another_goal_and_lands(sides):
    said, truth = sides["guided"]
    assert truth[-1]["outcome"] == "success" and truth[-1]["armed"] is False
    assert "guidance: guided" in said and said.count("arrived") == 2 and said.rstrip().endswith("landed and disarmed")
    distances = [float(d) for d in re.findall(r"goal +([0-9.]+) m", said)]
    assert distances[0] > 15.0 and min(distances) < 1.5
    # The score of a detector that flies along, or that there is none.
    assert re.search(r"score +[0-9.]+ \|", said) or "no detector" in said


def test_param_dump_lists_the_parameters_of_the_vehicle_and_of_guidance(sides):
    for component, expected in PARAMETERS.items():
        rows = [line.split("\t") for line in sides["parameters"][component].splitlines() if not line.startswith("#")]
        found = {name: float(value) for _, _, name, value, _ in rows}
        assert {row[1] for row in rows} == {str(component)}
        assert {name: found.get(name) for name in expected} == expected


def test_log_download_writes_the_log_of_the_flight(sides, tmp_path):
    listed, log = sides["logs"]
    assert f"{len(log)} bytes" in listed
    file = tmp_path / "flight.ulg"
    file.write_bytes(log)
    ulog = ULog(str(file))
    # PX4's number of OFFBOARD, and the flight's height.
    assert 14 in ulog.get_dataset("vehicle_status").data["nav_state"]
    places = ulog.get_dataset("vehicle_local_position").data
    assert places["z"].min() < -1.0
    # Ten records a second of simulated time, from arming on.
    assert all(abs(int(late) - int(early) - 100_000) < 2_000 for early, late in zip(places["timestamp"], places["timestamp"][1:]))
    assert ulog.msg_info_dict["sys_name"] == "Vigil" and len(ulog.initial_parameters) > 100
    assert ulog.get_dataset("actuator_motors").data["control[0]"].max() > 0.2
    attitude = ulog.get_dataset("vehicle_attitude").data
    assert abs(sum(attitude[f"q[{i}]"][5] ** 2 for i in range(4)) - 1.0) < 0.01
    assert ulog.logged_messages
