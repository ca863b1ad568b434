"""Unmodified clients command whole flights of the simulated vehicle, each against a simulator of its own.

The simulator's own status lines are the oracle beside the clients' checks: they tell the true state, which no client
sees. The flights of one kind run side by side, because they take real time.
"""

import contextlib
import math
import time

import pytest

import plan
from stack import Client, Firmware, free_simulator

CLIENTS = ["pymavlink", "mavsdk3", "mavsdk4"]
LIMIT_S = 180.0


def fly_all(what, course, folder, with_firmware):
    """Runs the plan by all clients at once; (exit code, client, truth) of each."""
    with contextlib.ExitStack() as stack:
        running = []
        for name in CLIENTS:
            simulator = stack.enter_context(free_simulator(course, folder))
            if with_firmware:
                stack.enter_context(Firmware(simulator.instance, folder))
            client = stack.enter_context(Client(name, what, simulator.instance, folder))
            running.append((name, simulator, client))
        codes = [client.wait(LIMIT_S) for _, _, client in running]
        # Status lines come five times a second: the one after the last client's end.
        time.sleep(0.5)
        return {name: (code, client, simulator.truth) for code, (name, simulator, client) in zip(codes, running)}


@pytest.fixture(scope="module")
def flights(tmp_path_factory):
    return fly_all("flight", "open_field.toml", tmp_path_factory.mktemp("flight"), with_firmware=False)


@pytest.fixture(scope="module")
def missions(tmp_path_factory):
    return fly_all("mission", "mission_course.toml", tmp_path_factory.mktemp("mission"), with_firmware=True)


@pytest.mark.parametrize("name", CLIENTS)
def test_a_script_takes_off_flies_offboard_and_lands(flights, name):
    code, client, truth = flights[name]
    assert code == 0, client.said()
    report = client.report()
    assert [leg["leg"] for leg in report["legs"]] == [leg.name for leg in plan.LEGS]

    assert truth[0]["armed"] is False and truth[-1]["armed"] is False
    heights = [-line["position_ned_m"][2] for line in truth]
    assert 3.0 < max(heights) < 6.5
    assert heights[-1] < 0.3, "stands on the ground"
    assert {"takeoff", "hold", "offboard", "land"} <= {line["mode"] for line in truth}
    # What the client believes at the end is where the vehicle truly is, but for the estimator's wandering.
    assert math.dist(report["end_m"], truth[-1]["position_ned_m"]) < 0.6
    # By offboard setpoints alone it flew farther than a wandering hover ever would.
    offboard = [line["position_ned_m"] for line in truth if line["mode"] == "offboard"]
    flown = sum(math.dist(a, b) for a, b in zip(offboard, offboard[1:]))
    assert 15.0 < flown < 35.0
    assert truth[-1]["outcome"] is None


@pytest.mark.parametrize("name", CLIENTS)
def test_a_script_hands_over_to_guidance_which_arrives_at_the_goal(missions, name):
    code, client, truth = missions[name]
    assert code == 0, client.said()
    report = client.report()
    assert report["nearest_m"] < 1.0
    assert report["guidance_states"][-1] == 4.0

    assert {"offboard", "land"} <= {line["mode"] for line in truth}
    assert truth[-1]["outcome"] == "success", truth[-1]
    assert truth[-1]["armed"] is False
    # The straight way leads through both columns: it flew round them.
    guided = [line["position_ned_m"] for line in truth if line["mode"] == "offboard"]
    columns = [(8.0, -1.0, 0.4), (13.0, -3.0, 0.3)]
    for north, east, radius in columns:
        assert min(math.hypot(n - north, e - east) for n, e, _ in guided) > radius + 0.2
