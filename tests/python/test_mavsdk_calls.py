"""Every call of every MAVSDK plugin, tried against the vehicle with both versions: docs/mavsdk.md has the outcomes.

`UPDATE_DOCS=1 tests/python/run.sh test_mavsdk_calls.py` writes the table anew.
"""

import contextlib
import json
import os
import re
import textwrap

import pytest

from stack import HERE, TOP, Process, free_simulator, venv_python

PAGE = TOP / "docs" / "mavsdk.md"
VERSIONS = {3: "3.17", 4: "4.1"}
LIMIT_S = 260.0
# What PX4's simulation (a quadrotor without camera and gimbal) does not answer either, by its sources and documentation.
PX4_REFUSES = {
    "action.set_relay": "PX4 has no relays",
    "action.transition_to_fixedwing": "not a VTOL",
    "action.transition_to_multicopter": "not a VTOL",
    "calibration.calibrate_gimbal_accelerometer": "no gimbal",
    "param.get_param_custom": "the extended parameter protocol is for cameras",
    "param.set_param_custom": "the extended parameter protocol is for cameras",
    "telemetry.actuator_control_target": "no longer sent",
    "telemetry.distance_sensor": "no range finder",
    "telemetry.wind": "no wind estimate without an airspeed sensor",
    "transponder.transponder": "no transponder",
}
WITHOUT_DEVICE = {"camera": "no camera", "gimbal": "no gimbal", "winch": "no winch"}
# Errors inside MAVSDK, before anything is sent.
MAVSDK_ERRORS = {"tune.play_tune", "param.select_component"}
NOTES = {
    "action.set_gps_global_origin": "the simulated world has its own",
    "action.shutdown": "end the simulator instead",
    "calibration.calibrate_accelerometer": "nobody turns a simulated vehicle by hand",
    "calibration.calibrate_magnetometer": "nobody turns a simulated vehicle by hand",
    "param.select_component": "an error inside MAVSDK",
    "tune.play_tune": "4.1: an error inside MAVSDK; there is no buzzer",
}


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    """Runs both versions side by side, each with a simulator of its own; the scripts check where the vehicle flew."""
    folder = tmp_path_factory.mktemp("mavsdk_calls")
    with contextlib.ExitStack() as stack:
        running = {}
        for version in VERSIONS:
            simulator = stack.enter_context(free_simulator("open_field.toml", folder))
            python = venv_python(f"mavsdk{version}")
            command = [python, "-u", HERE / "mavsdk_calls.py", "--instance", simulator.instance]
            running[version] = stack.enter_context(Process(f"mavsdk_calls{version}", command, folder)), simulator
        codes = {version: client.wait(LIMIT_S) for version, (client, _) in running.items()}
        for version, (client, _) in running.items():
            assert codes[version] == 0, client.said()
        yield {version: (json.loads(client.lines[-1]), simulator.truth) for version, (client, simulator) in running.items()}


def answered(report):
    """The calls that PX4's simulation answers: those of a device, and those that it refuses too, are not asked for."""
    aside = PX4_REFUSES.keys() | MAVSDK_ERRORS
    return [name for name in report["outcomes"] if name not in aside and name.split(".")[0] not in WITHOUT_DEVICE]


def share(report):
    """How many of these calls work, and of how many."""
    names = answered(report)
    return sum(report["outcomes"][name] == "works" for name in names), len(names)


def table(reports):
    """The shares, what works in both versions by plugin, and the rest as a table, in Markdown."""
    outcomes = {version: report["outcomes"] for version, (report, _) in reports.items()}
    lines = []
    for version, number in sorted(VERSIONS.items(), reverse=True):
        works, count = share(reports[version][0])
        lines.append(f"MAVSDK {number}: {works} of the {count} calls that PX4's simulation answers work ({works / count:.1%}).")
    names = [name for name in sorted(outcomes[3].keys() | outcomes[4].keys()) if name.split(".")[0] not in WITHOUT_DEVICE]
    both = [name for name in names if all(outcomes[version].get(name) == "works" for version in VERSIONS)]
    lines += ["", "These work with both:", ""]
    for plugin in sorted({name.split(".")[0] for name in both}):
        calls = ", ".join("`" + name.split(".")[1] + "`" for name in both if name.split(".")[0] == plugin)
        lines += textwrap.wrap(f"- `{plugin}`: {calls}", 118, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)
    lines += ["", "| Other calls | 4.1 | 3.17 | Note |", "| --- | --- | --- | --- |"]
    for name in names:
        if name in both:
            continue
        cells = [outcomes[version].get(name, "not in it") for version in (4, 3)]
        note = "PX4 neither: " + PX4_REFUSES[name] if name in PX4_REFUSES else NOTES.get(name, "")
        lines.append(f"| `{name}` | {cells[0]} | {cells[1]} | {note} |")
    for plugin, why in WITHOUT_DEVICE.items():
        counts = [sum(name.startswith(f"{plugin}.") for name in outcomes[version]) for version in (4, 3)]
        lines.append(f"| `{plugin}.*` | {counts[0]} calls | {counts[1]} calls | PX4 neither: {why} |")
    return "\n".join(lines)


@pytest.mark.parametrize("version", VERSIONS)
def test_every_call_was_tried_and_at_least_95_percent_of_what_px4_answers_work(reports, version):
    report, truth = reports[version]
    assert report["not tried"] == [] and len(report["calls"]) > 250
    works, count = share(report)
    failing = {name: report["outcomes"][name] for name in answered(report) if report["outcomes"][name] != "works"}
    assert works / count >= 0.95, failing
    # Every refusal is one that the documentation explains.
    assert failing.keys() <= NOTES.keys(), failing
    assert {"takeoff", "hold", "orbit", "offboard", "position", "mission", "return", "land"} <= {line["mode"] for line in truth}


@pytest.mark.parametrize("version", VERSIONS)
def test_what_the_vehicle_has_no_device_for_is_refused_or_not_answered(reports, version):
    outcomes = reports[version][0]["outcomes"]
    for name, outcome in outcomes.items():
        if name.split(".")[0] in WITHOUT_DEVICE and outcome == "works":
            # What lists or selects works without one.
            assert re.search(r"list|set_mode|release|subscribe", name), name


def test_the_documentation_has_the_outcomes(reports):
    text = PAGE.read_text(encoding="utf-8")
    begin, end = "<!-- calls: generated -->\n", "\n<!-- end -->"
    before, rest = text.split(begin)
    written, after = rest.split(end, 1)
    if os.environ.get("UPDATE_DOCS"):
        PAGE.write_text(before + begin + table(reports) + end + after, encoding="utf-8")
        return
    assert written == table(reports), "UPDATE_DOCS=1 writes it anew"
