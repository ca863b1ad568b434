"""Unmodified clients fly missions, geofences, rally points and orbits, each against a simulator of its own.

The simulator's status lines are the oracle beside the clients' checks: they tell the true state, which no client sees.
"""

import contextlib
import json
import math
import time

import pytest

from ground_plans import MISSION, item, numbered
from stack import Process, free_simulator, script, venv_python

CLIENTS = ["pymavlink", "mavsdk3", "mavsdk4"]
LIMIT_S = 300.0


@pytest.fixture(scope="module")
def flights(tmp_path_factory):
    """Runs all clients side by side, because flights take real time; (exit code, client, truth) of each."""
    folder = tmp_path_factory.mktemp("ground_plans")
    with contextlib.ExitStack() as stack:
        running = []
        for name in CLIENTS:
            simulator = stack.enter_context(free_simulator("open_field.toml", folder))
            command = [venv_python(name), "-u", script("ground_plans", name), "--instance", simulator.instance]
            running.append((name, simulator, stack.enter_context(Process(f"ground_plans_{name}", command, folder))))
        codes = [client.wait(LIMIT_S) for _, _, client in running]
        # Status lines come five times a second: the one after the last client's end.
        time.sleep(0.5)
        yield {name: (code, client, simulator.truth) for code, (name, simulator, client) in zip(codes, running)}


@pytest.mark.parametrize("name", CLIENTS)
def test_a_script_flies_missions_meets_a_geofence_returns_to_a_rally_point_and_orbits(flights, name):
    code, client, truth = flights[name]
    assert code == 0, client.said()
    report = json.loads(client.lines[-1])
    if name != "pymavlink":
        assert report["simple"]["progress"] == [[0, 3], [1, 3], [2, 3], [3, 3]]
    assert {"mission", "return", "offboard", "hold", "orbit", "land"} <= {line["mode"] for line in truth}

    # Truly on the ground near the rally point once, and truly round the circle's centre.
    landings = [line["position_ned_m"] for line in truth if line["mode"] == "return" and line["position_ned_m"][2] > -0.3]
    assert landings and math.dist(landings[-1][:2], (6.0, 14.0)) < 1.2
    orbit = [line["position_ned_m"] for line in truth if line["mode"] == "orbit"][-20:]
    assert all(abs(math.dist(p[:2], (4.0, 10.0)) - 6.0) < 1.0 for p in orbit)
    # It left the geofence at 20 m by its braking distance and no more: nothing else leads so far north.
    assert 20.3 < max(line["position_ned_m"][0] for line in truth) < 22.0
    assert truth[-1]["armed"] is False


def test_items_are_written_as_ground_stations_write_them():
    first, second = numbered([item(MISSION, 16, (0.0, 0.0), 5.0), item(MISSION, 20, frame=2)])
    assert (first["seq"], first["current"], first["x"], first["y"]) == (0, 1, 473977420, 85455940)
    assert (second["seq"], second["current"], second["x"], second["frame"]) == (1, 0, 0, 2)
