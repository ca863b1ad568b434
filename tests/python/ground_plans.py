"""What every client does with ground plans: missions, a geofence with its breach, rally points, an orbit.

A `vehicle` is one of the `Planner` classes of ground_plans_*.py. Places are (metres north, metres east) of home.
"""

import argparse
import asyncio
import json
import math

import plan
from plan import expect, until

HOME = (47.397742, 8.545594, 488.0)
METRES_PER_DEGREE = math.radians(6_371_000.0)
NAN = math.nan
# Kinds of plan: MAV_MISSION_TYPE.
MISSION, FENCE, RALLY = 0, 1, 2


def globe(north, east):
    """Latitude and longitude in degrees."""
    east_degree = METRES_PER_DEGREE * math.cos(math.radians(HOME[0]))
    return HOME[0] + north / METRES_PER_DEGREE, HOME[1] + east / east_degree


def item(kind, command, place=None, height=0.0, frame=3, params=(0.0, 0.0, 0.0, NAN)):
    """The fields of a MISSION_ITEM_INT as ground stations fill them."""
    lat, lon = globe(*place) if place else (0.0, 0.0)
    names = dict(zip(("param1", "param2", "param3", "param4"), params))
    where = {"x": round(lat * 1e7), "y": round(lon * 1e7), "z": height}
    return {"frame": frame, "command": command, "autocontinue": 1, "mission_type": kind, **names, **where}


def numbered(items):
    return [{"seq": seq, "current": int(seq == 0), **fields} for seq, fields in enumerate(items)]


def same(sent, back):
    """Whether a downloaded item is the one that was sent; NaN equals NaN."""

    def equal(a, b):
        return a == b or (isinstance(a, float) and math.isnan(a) and math.isnan(b)) or abs(a - b) < 1e-5

    return all(equal(sent[key], back[key]) for key in sent if key != "current")


def near(vehicle, place, height, within):
    north, east, down = vehicle.position
    return math.dist((north, east, -down), (*place, height)) < within


async def refused(vehicle, text, call):
    """What a client tells of a call that the vehicle refuses with a status text."""
    try:
        await call
        told = None
    except Exception as error:  # Each client has exceptions of its own.
        told = str(error)
    expect(told is not None, f"accepted, not refused with '{text}'")
    await until(f"the reason '{text}'", lambda: any(text in line for line in vehicle.texts), 3.0)
    return told


def simple_items():
    """Items of MAVSDK's mission plugin: its fields, NaN where nothing is meant."""

    def fields(place, height, **more):
        lat, lon = globe(*place)
        unset = "speed_m_s gimbal_pitch_deg gimbal_yaw_deg loiter_time_s camera_photo_interval_s camera_photo_distance_m yaw_deg"
        nothing = dict.fromkeys(unset.split(), NAN) | {"is_fly_through": False, "acceptance_radius_m": 0.5}
        return {**nothing, "latitude_deg": lat, "longitude_deg": lon, "relative_altitude_m": height, **more}

    return [
        fields((10.0, 0.0), 4.0, speed_m_s=4.0, is_fly_through=True, gimbal_pitch_deg=-30.0, gimbal_yaw_deg=0.0),
        fields((10.0, 30.0), 5.0, yaw_deg=90.0, loiter_time_s=2.0),
        fields((0.0, 30.0), 5.0),
    ]


async def fly_simple_mission(vehicle):
    """Upload, download, start, pause, go on, finish, choose an item, clear: with the mission plugin of MAVSDK."""
    items = simple_items()
    await vehicle.set_return_after_mission(False)
    await vehicle.upload_simple(items)
    back = await vehicle.download_simple()
    expect(len(back) == len(items), f"{len(back)} items came back")
    for sent, told in zip(items, back):
        for key in ("latitude_deg", "longitude_deg", "relative_altitude_m", "speed_m_s", "loiter_time_s", "yaw_deg"):
            a, b = sent[key], told[key]
            expect((math.isnan(a) and math.isnan(b)) or abs(a - b) < 1e-6, f"{key}: {a} came back as {b}")
    await vehicle.arm()
    await vehicle.start_simple()
    await until("mission mode", lambda: vehicle.mode == "mission", 3.0)
    await until("first item done", lambda: vehicle.progress[-1:] and vehicle.progress[-1][0] >= 1, 40.0)
    expect(near(vehicle, (10.0, 0.0), 4.0, 3.0), f"passed the first item at {vehicle.position}")
    await asyncio.sleep(1.5)
    await vehicle.pause_simple()
    await until("hold", lambda: vehicle.mode == "hold", 3.0)
    await asyncio.sleep(3.0)
    stopped = vehicle.position
    await asyncio.sleep(2.0)
    expect(math.dist(stopped, vehicle.position) < 0.3, "does not hold in a pause")
    expect(not await vehicle.is_finished_simple(), "finished in a pause")
    await vehicle.start_simple()
    await until("turned east at the second item", lambda: near(vehicle, (10.0, 30.0), 5.0, 0.6), 40.0)
    expect(abs(plan.turned(90.0, vehicle.heading_deg)) < 10.0, f"heading {vehicle.heading_deg}")

    async def finished():
        while not await vehicle.is_finished_simple():
            await asyncio.sleep(0.2)

    await asyncio.wait_for(finished(), 40.0)
    expect(near(vehicle, (0.0, 30.0), 5.0, 1.0), f"finished at {vehicle.position}")
    expect(vehicle.progress[-1] == (3, 3), f"progress {vehicle.progress}")
    await until("hold after the mission", lambda: vehicle.mode == "hold", 5.0)
    await vehicle.choose_simple(1)
    await until("second item is current", lambda: vehicle.progress[-1] == (1, 3), 3.0)
    await vehicle.clear_simple()
    expect(await vehicle.download_simple() == [], "the mission is not cleared")
    seen = []
    for step in vehicle.progress:
        if step not in seen:
            seen.append(step)
    return {"progress": seen}


async def fly_raw_mission(vehicle):
    """A mission item by item, as QGroundControl writes it; it ends with a return to a rally point, landed and disarmed."""
    rally = [item(RALLY, 5100, (6.0, 14.0)), item(RALLY, 5100, (-40.0, 0.0))]
    items = [
        item(MISSION, 22, (0.0, 0.0), 4.0),
        item(MISSION, 178, frame=2, params=(1.0, 3.0, -1.0, 0.0)),
        item(MISSION, 16, (0.0, 14.0), 4.0, frame=6, params=(1.0, 1.0, 0.0, NAN)),
        item(MISSION, 93, frame=2, params=(1.0, -1.0, -1.0, -1.0)),
        item(MISSION, 16, (12.0, 14.0), HOME[2] + 5.0, frame=0, params=(0.0, 1.0, 0.0, NAN)),
        item(MISSION, 20, frame=2, params=(0.0, 0.0, 0.0, 0.0)),
    ]
    for kind, sent in ((RALLY, rally), (MISSION, items)):
        await vehicle.upload(kind, numbered(sent))
        back = await vehicle.download(kind)
        expect(len(back) == len(sent), f"{len(back)} items of {len(sent)} came back")
        for a, b in zip(numbered(sent), back):
            # In the frames of the form with integers, as from PX4.
            a = a | {"frame": {0: 5, 3: 6}.get(a["frame"], a["frame"])}
            expect(same(a, b), f"{a} came back as {b}")
    unknown = vehicle.upload(MISSION, numbered([item(MISSION, 9999)]))
    told = await refused(vehicle, "mission refused: item 0", unknown)
    expect(len(await vehicle.download(MISSION)) == len(items), "a refused upload changed the mission")
    if not vehicle.armed:
        await vehicle.arm()
    await vehicle.start()
    await until("mission mode", lambda: vehicle.mode == "mission", 3.0)
    await until("first waypoint", lambda: near(vehicle, (0.0, 14.0), 4.0, 1.3), 60.0)
    await until("return", lambda: vehicle.mode == "return", 40.0)
    expect(near(vehicle, (12.0, 14.0), 5.0, 1.8), f"the return begins at {vehicle.position}")
    await until("landed", lambda: not vehicle.in_air, 60.0)
    await until("disarmed", lambda: not vehicle.armed, 10.0)
    expect(near(vehicle, (6.0, 14.0), 0.0, 1.2), f"landed at {vehicle.position} and not at the rally point")
    return {"refused_with": told, "landed_m": vehicle.position}


async def break_fence(vehicle):
    """A geofence to stay in: nobody is sent outside, and leaving it by setpoints ends in hold."""
    start = (6.0, 14.0)
    inside = [(-15.0, -15.0), (-15.0, 25.0), (20.0, 25.0), (20.0, -15.0)]
    pillar = ((-10.0, -10.0), 3.0)
    await vehicle.upload_fence(inside, pillar)
    back = await vehicle.download(FENCE)
    expect([b["command"] for b in back] == [5001] * 4 + [5004], f"the geofence came back as {back}")
    await vehicle.arm()
    await vehicle.take_off()
    await until("in the air", lambda: vehicle.in_air and vehicle.mode == "hold", 20.0)
    await refused(vehicle, "outside the geofence", vehicle.goto((40.0, 0.0), 4.0))
    await vehicle.goto((16.0, start[1]), 4.0)
    await until("at the inner side of the border", lambda: near(vehicle, (16.0, start[1]), 4.0, 0.6), 20.0)
    await vehicle.start_offboard()
    await until("OFFBOARD", lambda: vehicle.mode == "offboard", 3.0)
    await vehicle.velocity_ned(1.5, 0.0, 0.0, 0.0)
    await until("hold by the breach", lambda: vehicle.mode == "hold", 15.0)
    expect(19.5 < vehicle.position[0] < 21.5, f"breach at {vehicle.position}")
    await until("the reason", lambda: any("geofence breached: hold" in text for text in vehicle.texts), 3.0)
    await vehicle.stop_setpoints()
    await asyncio.sleep(3.0)
    expect(vehicle.position[0] < 23.0, f"flew on to {vehicle.position}")
    farthest = vehicle.position[0]
    await vehicle.goto(start, 4.0)
    await until("back inside", lambda: near(vehicle, start, 4.0, 0.6), 20.0)
    await vehicle.clear_fence()
    expect(await vehicle.download(FENCE) == [], "the geofence is not cleared")
    return {"held_at_north_m": farthest}


async def circle(vehicle):
    """An orbit of 6 m, then a landing."""
    centre, radius = (4.0, 10.0), 6.0
    await vehicle.orbit(centre, 5.0, radius, 2.5)
    await asyncio.sleep(8.0)
    off, bearings = [], []
    for _ in range(60):
        await asyncio.sleep(0.1)
        north, east = vehicle.position[0] - centre[0], vehicle.position[1] - centre[1]
        off.append(abs(math.hypot(north, east) - radius))
        bearings.append(math.degrees(math.atan2(east, north)))
    expect(max(off) < 0.7, f"{max(off):.2f} m off the circle")
    turned = sum(plan.turned(a, b) for a, b in zip(bearings, bearings[1:]))
    expect(100.0 < turned < 200.0, f"turned {turned:.0f} degrees about the centre in 6 s")
    await plan.descend(vehicle)
    return {"off_circle_m": max(off), "turned_deg": turned}


async def run_all(vehicle):
    await vehicle.connect()
    await until("telemetry", lambda: vehicle.position and vehicle.heading_deg is not None, 15.0)
    await vehicle.wait_ready()
    await vehicle.set_takeoff_height(4.0)
    await vehicle.set_return_height(6.0)
    report = {}
    if vehicle.has_simple_missions:
        report["simple"] = await fly_simple_mission(vehicle)
        await plan.descend(vehicle)
    report["raw"] = await fly_raw_mission(vehicle)
    report["fence"] = await break_fence(vehicle)
    report["orbit"] = await circle(vehicle)
    return report


def main(make_vehicle, doc):
    """Flies everything; prints a report as JSON, or says what went wrong and exits 1."""
    parser = argparse.ArgumentParser(description=doc)
    parser.add_argument("--instance", type=int, default=0, help="number of the simulator (default 0)")
    args = parser.parse_args()

    async def run():
        vehicle = make_vehicle(args.instance)
        try:
            return await run_all(vehicle)
        except plan.Failed as failed:
            raise SystemExit(f"{failed}; the vehicle said: {vehicle.texts[-8:]}") from None
        finally:
            await vehicle.close()

    print(json.dumps(asyncio.run(run())))
