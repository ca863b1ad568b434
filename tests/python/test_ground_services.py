"""Unmodified MAVSDK 3 and 4 scripts use the vehicle's files, logs, events, metadata, shell and telemetry rates."""

import contextlib
import json

import pytest

from stack import HERE, Firmware, Process, free_simulator, venv_python

CLIENTS = ["mavsdk3", "mavsdk4"]
LIMIT_S = 150.0


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    """Runs both clients side by side, each with a simulator and a guidance computer of its own; what each printed last."""
    folder = tmp_path_factory.mktemp("ground_services")
    with contextlib.ExitStack() as stack:
        running = {}
        for name in CLIENTS:
            simulator = stack.enter_context(free_simulator("open_field.toml", folder))
            stack.enter_context(Firmware(simulator.instance, folder))
            command = [venv_python(name), "-u", HERE / "ground_services.py", "--instance", simulator.instance]
            running[name] = stack.enter_context(Process(f"ground_services_{name}", command, folder))
        codes = {name: client.wait(LIMIT_S) for name, client in running.items()}
        for name, client in running.items():
            assert codes[name] == 0, client.said()
        yield {name: json.loads(client.lines[-1]) for name, client in running.items()}


@pytest.mark.parametrize("name", CLIENTS)
def test_files_go_to_the_vehicle_and_back_unchanged(reports, name):
    files = reports[name]["files"]
    assert files["identical"] and files["same"] == [True, True]
    assert "FILE_DOES_NOT_EXIST" in files["missing"] and "FILE_PROTECTED" in files["protected"]
    assert "parameters.json" in reports[name]["entries"]


@pytest.mark.parametrize("name", CLIENTS)
def test_a_flight_is_told_as_events_and_its_log_downloads_whole(reports, name):
    report = reports[name]
    told = [event for event in report["events"] if not event.startswith("Mode")]
    assert told == ["Armed", "Took off", "Landed", "Disarmed"]
    assert "Mode: takeoff" in report["events"] and "Mode: land" in report["events"]
    assert report["can_arm"] is True
    logs = report["logs"]
    assert logs["magic"] == b"ULog\x01\x12\x35".hex() and logs["bytes"] == logs["told"] > 5_000
    assert "NO_LOGFILES" in logs["erased"]
    assert report["flight"] == 1


@pytest.mark.parametrize("name", CLIENTS)
def test_metadata_and_shell_answer(reports, name):
    vehicle, companion = ({p["name"]: p for p in json.loads(m)["parameters"]} for m in reports[name]["metadata"])
    assert vehicle["MIS_TAKEOFF_ALT"]["units"] == "m" and vehicle["COM_OBL_RC_ACT"]["type"] == "Int32"
    assert companion["GD_GOAL_RAD"]["max"] == 100 and len(companion["DT_ALARM"]["values"]) == 3
    assert reports[name]["shell"].startswith("Vigil ")


@pytest.mark.parametrize("name", CLIENTS)
def test_every_telemetry_rate_can_be_set_and_what_the_vehicle_has_is_told(reports, name):
    rates = reports[name]["rates"]
    assert rates["count"] >= 25 and rates["denied"] == []
    assert reports[name]["silent"] == []
