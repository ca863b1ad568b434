"""What every client does with the vehicle: the same flight and the same mission through each client's own calls.

A `vehicle` is one of the `Vehicle` classes of client_*.py. Positions are metres north, east and down of home; headings
are degrees clockwise from north.
"""

import argparse
import asyncio
import json
import math
import time
from dataclasses import dataclass

TAKEOFF_HEIGHT_M = 3.0
GOAL_NORTH_M, GOAL_EAST_M = 20.0, -3.0


@dataclass
class Leg:
    """A constant setpoint: velocity forward/right/down or north/east/down, yaw rate, how long."""

    name: str
    velocity: tuple
    frame: str = "body"
    yaw_rate_deg_s: float = 0.0
    seconds: float = 4.0


LEGS = [
    Leg("forward", (1.5, 0.0, 0.0)),
    Leg("right", (0.0, 1.0, 0.0)),
    Leg("up", (0.0, 0.0, -0.5)),
    Leg("turn", (0.0, 0.0, 0.0), yaw_rate_deg_s=30.0, seconds=3.0),
    Leg("forward again", (1.5, 0.0, 0.0)),
    Leg("south", (-1.0, 0.0, 0.0), frame="ned"),
    Leg("down", (0.0, 0.0, 0.5), seconds=3.0),
]


class Failed(Exception):
    """What was expected and what happened instead."""


def expect(condition, message):
    if not condition:
        raise Failed(message)


async def until(what, condition, limit_s):
    """Waits for `condition()`; names what did not happen in time."""
    deadline = time.monotonic() + limit_s
    while not condition():
        expect(time.monotonic() < deadline, f"not within {limit_s} s: {what}")
        await asyncio.sleep(0.05)


def turned(before_deg, after_deg):
    """Degrees from one heading to the other, clockwise, within ±180."""
    return (after_deg - before_deg + 180.0) % 360.0 - 180.0


async def climb(vehicle):
    await vehicle.connect()
    await until("telemetry", lambda: vehicle.position and vehicle.heading_deg is not None, 15.0)
    await vehicle.wait_ready()
    await vehicle.set_takeoff_height(TAKEOFF_HEIGHT_M)
    await vehicle.arm()
    await until("armed", lambda: vehicle.armed, 3.0)
    await vehicle.take_off()
    await until("in the air at 3 m", lambda: vehicle.in_air and -vehicle.position[2] > TAKEOFF_HEIGHT_M - 0.3, 20.0)
    await until("hold", lambda: vehicle.mode == "hold", 5.0)


async def descend(vehicle):
    await vehicle.land()
    await until("landed", lambda: not vehicle.in_air, 40.0)
    await until("disarmed after landing", lambda: not vehicle.armed, 10.0)


async def hover(vehicle, seconds):
    """Stays within a quarter of a metre."""
    await asyncio.sleep(2.0)
    centre = vehicle.position
    farthest = 0.0
    for _ in range(int(seconds * 10)):
        await asyncio.sleep(0.1)
        farthest = max(farthest, math.dist(centre, vehicle.position))
    expect(farthest < 0.25, f"hover wandered {farthest:.2f} m")
    return farthest


async def fly_leg(vehicle, leg):
    """Flies a setpoint and checks where it led."""
    before, heading = vehicle.position, vehicle.heading_deg
    start = time.monotonic()
    if leg.frame == "body":
        await vehicle.velocity_body(*leg.velocity, leg.yaw_rate_deg_s)
    else:
        await vehicle.velocity_ned(*leg.velocity, heading)
    await asyncio.sleep(leg.seconds)
    elapsed = time.monotonic() - start
    moved = [b - a for a, b in zip(before, vehicle.position)]
    speed = vehicle.velocity
    if leg.frame == "body":
        c, s = math.cos(math.radians(heading)), math.sin(math.radians(heading))
        forward, right, down = leg.velocity
        wanted = (c * forward - s * right, s * forward + c * right, down)
    else:
        wanted = leg.velocity
    if leg.yaw_rate_deg_s:
        angle = turned(heading, vehicle.heading_deg)
        asked = leg.yaw_rate_deg_s * elapsed
        expect(abs(angle - asked) < 15.0, f"{leg.name}: turned {angle:.0f} degrees, asked for {asked:.0f}")
    else:
        angle = turned(heading, vehicle.heading_deg)
        expect(abs(angle) < 8.0, f"{leg.name}: turned {angle:.0f} degrees unasked")
        norm = math.hypot(*wanted)
        along = sum(m * w for m, w in zip(moved, wanted)) / norm
        across = math.dist(moved, [along * w / norm for w in wanted])
        # The vehicle needs about a second to reach its speed: 0.3 to 1.6 s of way are missing.
        expect(norm * (elapsed - 1.6) < along < norm * (elapsed - 0.2), f"{leg.name}: flew {along:.2f} m in {elapsed:.1f} s")
        expect(across < 0.5, f"{leg.name}: flew {across:.2f} m aside")
        error = math.dist(speed, wanted)
        expect(error < 0.3, f"{leg.name}: ends at {speed}, asked for {wanted}")
    await vehicle.velocity_body(0.0, 0.0, 0.0, 0.0)
    await asyncio.sleep(2.0)
    expect(math.hypot(*vehicle.velocity) < 0.3, f"{leg.name}: does not stop: {vehicle.velocity}")
    return {"leg": leg.name, "moved_m": [round(m, 2) for m in moved], "turned_deg": round(angle, 1)}


async def flight(vehicle):
    """Connect, arm, take off, hover, fly offboard velocity setpoints, land, find it disarmed."""
    await climb(vehicle)
    report = {"hover_m": await hover(vehicle, 3.0), "legs": []}
    await vehicle.start_offboard()
    await until("OFFBOARD", lambda: vehicle.mode == "offboard", 3.0)
    for leg in LEGS:
        report["legs"].append(await fly_leg(vehicle, leg))
    await vehicle.stop_offboard()
    await until("hold", lambda: vehicle.mode == "hold", 3.0)
    await descend(vehicle)
    report["end_m"] = vehicle.position
    return report


async def mission(vehicle):
    """Connect, arm, take off, hand the vehicle to guidance with a goal, watch it arrive, land."""
    await climb(vehicle)
    await until("guidance computer", lambda: "gd_state" in vehicle.named_values, 10.0)
    await vehicle.set_goal(GOAL_NORTH_M, GOAL_EAST_M, TAKEOFF_HEIGHT_M)
    await until("guidance ready", lambda: vehicle.named_values["gd_state"] == 1.0, 5.0)
    await vehicle.engage()
    await until("guided", lambda: vehicle.named_values["gd_state"] == 3.0, 15.0)
    nearest, states = math.inf, []

    def arrived():
        nonlocal nearest
        state = vehicle.named_values["gd_state"]
        if not states or states[-1] != state:
            states.append(state)
        north, east, _ = vehicle.position
        distance = math.hypot(GOAL_NORTH_M - north, GOAL_EAST_M - east)
        nearest = min(nearest, distance)
        return distance < 1.0 and state == 4.0

    await until("guidance holds at the goal", arrived, 90.0)
    await vehicle.disengage()
    await descend(vehicle)
    return {"nearest_m": nearest, "guidance_states": states, "end_m": vehicle.position}


def main(make_vehicle, doc):
    """Runs one of the plans from the command line; prints a report as JSON, or says what went wrong and exits 1."""
    parser = argparse.ArgumentParser(description=doc)
    parser.add_argument("what", choices=["flight", "mission"])
    parser.add_argument("--instance", type=int, default=0, help="number of the simulator (default 0)")
    args = parser.parse_args()

    async def run():
        vehicle = make_vehicle(args.instance)
        try:
            return await (flight if args.what == "flight" else mission)(vehicle)
        except Failed as failed:
            raise SystemExit(f"{failed}; the vehicle said: {vehicle.texts[-8:]}") from None
        finally:
            await vehicle.close()

    print(json.dumps(asyncio.run(run())))
