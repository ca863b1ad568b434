"""Tries every call of every MAVSDK plugin for vehicles and says what became of it: `test_mavsdk_calls.py` makes a table of it.

One script for both versions: their plugins, calls and types have the same names, only the ways to reach them differ.
"""

import argparse
import asyncio
import base64
import concurrent.futures
import inspect
import json
import math
import os
import re
import sys
import tempfile
import time
import traceback
from pathlib import Path

import plan
from ground_plans import HOME, globe
from mavsdk_system import VERSION, MavsdkSystem, types
from plan import expect

NAN = math.nan
PLUGINS = (
    "action calibration camera component_metadata core events failure follow_me ftp geofence gimbal gripper info log_files "
    "log_streaming manual_control mavlink_direct mission mission_raw mocap offboard param rtk server_utility shell telemetry "
    "transponder tune winch"
).split()
# Devices that the vehicle does not have: all their calls are tried with plain arguments.
DEVICES = ("camera", "gimbal", "gripper", "winch")
ANSWER_LIMIT_S = 5.0
NO_ANSWER = "no answer"
# The whole session takes 70 s; a busy machine is given time.
LIMIT_S = 240.0
PATIENCE = 3.0


async def until(what, condition, limit_s):
    await plan.until(what, condition, PATIENCE * limit_s)


class Api(MavsdkSystem):
    """The plugins of one system of either version, and what became of each call."""

    def __init__(self, instance):
        super().__init__(instance)
        self.began = time.monotonic()
        self.outcomes = {}
        self.latest = {}
        # Version 3 alone has a plugin for the connection.
        self.tried = [name for name in PLUGINS if name != "core" or VERSION == 3]

    async def connect(self):
        # A thread for each call that waits: those for devices that are not there all do.
        asyncio.get_running_loop().set_default_executor(concurrent.futures.ThreadPoolExecutor(64))
        await super().connect()
        if VERSION == 3:
            self.outcomes["core.connection_state"] = "works"

    def all_names(self):
        return [f"{plugin}.{name}" for plugin in self.tried for name in self.calls(plugin)]

    def has(self, name):
        plugin, call = name.split(".")
        return plugin in self.tried and call in self.calls(plugin)

    async def call(self, name, *args, **more):
        """Calls, notes the outcome, returns what came. A plugin that is still busy with what it did before is given time."""
        for _ in range(4):
            value = await self._call(name, *args, **more)
            if self.outcomes[name] != "refused: BUSY":
                break
            await asyncio.sleep(0.5)
        return value

    async def _call(self, name, *args, limit_s=ANSWER_LIMIT_S, wanted=None):
        """Of a stream the first value (that is wanted), of a transfer all."""
        print(f"{time.monotonic() - self.began:.1f} {name}", file=sys.stderr)
        try:
            value = await asyncio.wait_for(self._value(name, args, wanted), limit_s)
            self.outcomes[name] = "works"
            return value
        except (asyncio.TimeoutError, StopAsyncIteration):
            self.outcomes[name] = NO_ANSWER
        except Exception as error:  # Each plugin has an error class of its own.
            codes = re.findall(r"\b[A-Z]+(?:_[A-Z]+)*\b", str(error).replace("Error", ""))
            code = next((c for c in codes if len(c) > 3), type(error).__name__)
            self.outcomes[name] = "no answer" if code == "TIMEOUT" else f"refused: {code}"
        return None

    async def _value(self, name, args, wanted):
        made = self.function(name)(*args)
        if not hasattr(made, "__aiter__"):
            return await made if inspect.isawaitable(made) else made
        endless = not name.endswith("_with_progress") and name not in FINITE
        values = []
        async for value in made:
            if endless and (wanted is None or wanted(value)):
                return value
            values.append(value)
        return values

    def keep_newest(self, name):
        """Keeps the newest value of a stream in `latest`."""
        self.keep(name, lambda value: self.latest.update({name: value}))

    @property
    def position(self):
        p = self.latest["telemetry.position_velocity_ned"].position
        return (p.north_m, p.east_m, p.down_m)

    @property
    def velocity(self):
        v = self.latest["telemetry.position_velocity_ned"].velocity
        return (v.north_m_s, v.east_m_s, v.down_m_s)

    @property
    def mode(self):
        return self.latest["telemetry.flight_mode"].name

    @property
    def armed(self):
        return self.latest["telemetry.armed"]


FINITE = {"ftp.upload", "ftp.download", "log_files.download_log_file"} | {
    f"calibration.calibrate_{what}" for what in ("gyro", "accelerometer", "magnetometer", "level_horizon", "gimbal_accelerometer")
}


async def near(api, place, within_m, limit_s, what):
    await until(f"{what}: at {place}", lambda: math.dist(api.position, place) < within_m, limit_s)


def plain_arguments(plugin, function):
    """An argument of each parameter's kind, for devices that are not there."""
    kinds = types(plugin)
    plain = {
        "mode": lambda: kinds.Mode.PHOTO,
        "photos_range": lambda: kinds.PhotosRange.ALL,
        "gimbal_mode": lambda: kinds.GimbalMode.YAW_FOLLOW,
        "send_mode": lambda: kinds.SendMode.ONCE,
        "control_mode": lambda: kinds.ControlMode.PRIMARY,
        "setting": lambda: kinds.Setting("WB", "", kinds.Option("1", "on"), False),
        "component_id": lambda: 100,
    }
    plain |= dict.fromkeys(("instance", "gimbal_id", "stream_id", "storage_id"), lambda: 1)
    return [plain.get(name, lambda: 0.5)() for name in inspect.signature(function).parameters]


async def devices(api):
    """Cameras, gimbals, grippers, winches: nobody answers, or the vehicle says that it cannot."""

    async def try_all(plugin):
        async def one(name):
            function = api.function(f"{plugin}.{name}")
            await api.call(f"{plugin}.{name}", *plain_arguments(plugin, function), limit_s=4.0)

        await asyncio.gather(*(one(name) for name in api.calls(plugin)))

    await asyncio.gather(*(try_all(plugin) for plugin in DEVICES))


async def telemetry(api):
    """Every stream and every rate."""

    async def one(name):
        if name.startswith("set_rate_"):
            await api.call(f"telemetry.{name}", 5.0)
        elif name == "status_text":
            # Something to tell comes with the arming; see `fly`.
            await api.call("telemetry.status_text", limit_s=40.0)
        else:
            await api.call(f"telemetry.{name}", limit_s=7.0)

    await asyncio.gather(*(one(name) for name in api.calls("telemetry")))


async def information(api):
    for name in api.calls("info"):
        if name != "flight_information":
            await api.call(f"info.{name}")
    await api.call("component_metadata.request_autopilot_component")
    await api.call("component_metadata.request_component", 1)
    await api.call("component_metadata.metadata_available")
    await api.call("component_metadata.get_metadata", 1, types("component_metadata").MetadataType.PARAMETER)
    await api.call("events.health_and_arming_checks")
    await api.call("events.get_health_and_arming_checks_report")
    shell = asyncio.create_task(api.call("shell.receive"))
    await asyncio.sleep(0.3)
    if VERSION == 4:
        await api.call("shell.send", "ver", types("shell").Device.SHELL)
    else:
        await api.call("shell.send", "ver")
    await shell
    await direct(api)


async def direct(api):
    xml = '<mavlink><messages><message id="420" name="MY_OWN"><field type="uint8_t" name="x"/></message></messages></mavlink>'
    await api.call("mavlink_direct.load_custom_xml", xml)
    await api.call("mavlink_direct.message", "HEARTBEAT")
    Message = types("mavlink_direct").MavlinkMessage
    fields = {"type": 6, "autopilot": 8, "base_mode": 0, "custom_mode": 0, "system_status": 4, "mavlink_version": 3}
    await api.call("mavlink_direct.send_message", Message("HEARTBEAT", 245, 190, 0, 0, json.dumps(fields)))
    if api.has("mavlink_direct.send_command"):
        system = api.system_id
        fields = {f"param{n}": 0.0 for n in range(2, 8)} | {"command": 512, "param1": 148.0, "confirmation": 0}
        fields |= {"target_system": system, "target_component": 1}
        await api.call("mavlink_direct.send_command", Message("COMMAND_LONG", 0, 0, system, 1, json.dumps(fields)))


async def parameters(api):
    await api.call("param.select_component", 1, types("param").ProtocolVersion.V1)
    await api.call("param.get_all_params")
    height = await api.call("param.get_param_float", "MIS_TAKEOFF_ALT")
    expect(height == 2.5, f"MIS_TAKEOFF_ALT is {height}")
    await api.call("param.set_param_float", "MIS_TAKEOFF_ALT", 3.0)
    # On a busy machine a client's stream has gaps, which are another test's business.
    await api.call("param.set_param_float", "COM_OF_LOSS_T", 5.0)
    await api.call("param.get_param_int", "COM_OBL_RC_ACT")
    await api.call("param.set_param_int", "COM_OBL_RC_ACT", 5)
    await api.call("action.set_takeoff_altitude", 3.0)
    expect(await api.call("action.get_takeoff_altitude") == 3.0, "take-off height")
    await api.call("action.set_return_to_launch_altitude", 4.0)
    expect(await api.call("action.get_return_to_launch_altitude") == 4.0, "return height")


async def text_parameters(api):
    """Only the extended protocol has these, which PX4 does not speak; alone, because MAVSDK 4 then mixes up its answers."""
    await api.call("param.get_param_custom", "MY_TEXT", limit_s=15.0)
    await api.call("param.set_param_custom", "MY_TEXT", "text", limit_s=15.0)


async def files(api):
    with tempfile.TemporaryDirectory() as folder:
        local = Path(folder) / "data.bin"
        local.write_bytes(os.urandom(3000))
        await api.call("ftp.set_target_compid", 1)
        await api.call("ftp.create_directory", "/calls")
        await api.call("ftp.upload", str(local), "/calls")
        same = await api.call("ftp.are_files_identical", str(local), "/calls/data.bin")
        expect(same, "the uploaded file differs")
        into = Path(folder) / "back"
        into.mkdir()
        await api.call("ftp.download", "/calls/data.bin", str(into), False)
        expect((into / "data.bin").read_bytes() == local.read_bytes(), "the file came back changed")
        await api.call("ftp.rename", "/calls/data.bin", "/calls/other.bin")
        await api.call("ftp.list_directory", "/calls")
        await api.call("ftp.remove_file", "/calls/other.bin")
        await api.call("ftp.remove_directory", "/calls")


async def plans(api):
    """Geofence, rally points and missions, there and back."""
    fence = types("geofence")
    corners = [fence.Point(*globe(*corner)) for corner in ((-80, -80), (80, -80), (80, 80), (-80, 80))]
    data = fence.GeofenceData([fence.Polygon(corners, fence.FenceType.INCLUSION)], [])
    await api.call("geofence.upload_geofence", data)
    back = await api.call("geofence.download_geofence")
    expect(len(back.polygons[0].points) == 4, f"the fence came back as {back}")
    await api.call("geofence.clear_geofence")

    raw = types("mission_raw")
    x, y = (round(degrees * 1e7) for degrees in globe(0.0, 10.0))

    def item(command, kind, seq=0):
        return raw.MissionItem(seq, 3, command, int(seq == 0), 1, 0.0, 0.5, 0.0, NAN, x, y, 3.0, kind)

    await api.call("mission_raw.upload_geofence", [raw.MissionItem(0, 3, 5003, 1, 1, 90.0, 0.0, 0.0, 0.0, x, y, 0.0, 1)])
    await api.call("mission_raw.download_geofence")
    await api.call("geofence.clear_geofence")
    # A parameter that the command does not use must be left out.
    rally = raw.MissionItem(0, 3, 5100, 1, 1, NAN, NAN, NAN, NAN, x, y, 3.0, 2)
    await api.call("mission_raw.upload_rally_points", [rally])
    await api.call("mission_raw.download_rallypoints")
    changed = asyncio.create_task(api.call("mission_raw.mission_changed"))
    await asyncio.sleep(0.2)
    await api.call("mission_raw.upload_mission", [item(16, 0)])
    if api.has("mission_raw.upload_mission_with_progress"):
        await api.call("mission_raw.upload_mission_with_progress", raw.MissionPlan([item(16, 0)]))
    expect(len(await api.call("mission_raw.download_mission")) == 1, "the mission came back changed")
    await api.call("mission_raw.set_current_mission_item", 0)
    await api.call("mission_raw.is_mission_finished")
    await api.call("mission_raw.mission_progress")
    await api.call("mission_raw.clear_mission")
    await changed
    await cancel(api, "mission_raw", [item(16, 0, seq) for seq in range(150)])
    qgc = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "mission": {"version": 2, "firmwareType": 12, "vehicleType": 2, "items": [], "cruiseSpeed": 5, "hoverSpeed": 5},
        "geoFence": {"version": 2, "circles": [], "polygons": []},
        "rallyPoints": {"version": 2, "points": []},
    }
    qgc["mission"]["plannedHomePosition"] = list(HOME)
    planner = "QGC WPL 110\n0\t1\t0\t16\t0\t0\t0\t0\t47.397742\t8.545594\t488\t1\n1\t0\t3\t16\t0\t0\t0\t0\t47.3978\t8.5456\t5\t1\n"
    with tempfile.TemporaryDirectory() as folder:
        for name, text in (("qgroundcontrol", json.dumps(qgc)), ("mission_planner", planner)):
            path = Path(folder) / name
            path.write_text(text, encoding="utf-8")
            await api.call(f"mission_raw.import_{name}_mission", str(path))
            await api.call(f"mission_raw.import_{name}_mission_from_string", text)


async def cancelled_by(api, name, running, after_s):
    """Cancels by the call what runs, which then ends, by that or because it was done."""
    running = asyncio.create_task(asyncio.wait_for(running, 20.0))
    await asyncio.sleep(after_s)
    await api.call(name)
    try:
        await running
    except Exception as error:  # Each plugin has an error class of its own.
        expect("CANCEL" in str(error).upper(), f"{name}: what ran ended with {error!r}")


async def cancel(api, plugin, long):
    """Cancels an upload and a download in their midst."""
    for what, args in (("upload", [long]), ("download", [])):
        if what == "download":
            await api.function(f"{plugin}.upload_mission")(long)
        transfer = api.function(f"{plugin}.{what}_mission")(*args)
        await cancelled_by(api, f"{plugin}.cancel_mission_{what}", transfer, 0.05)
    await api.function(f"{plugin}.clear_mission")()


async def sent_only(api):
    """Messages that nobody acknowledges, and what concerns parts that a simulation may lack."""
    mocap = types("mocap")
    still = mocap.Covariance([NAN])
    body, q = mocap.PositionBody(0.0, 0.0, 0.0), mocap.Quaternion(1.0, 0.0, 0.0, 0.0)
    await api.call("mocap.set_attitude_position_mocap", mocap.AttitudePositionMocap(0, q, body, still))
    angle = mocap.AngleBody(0.0, 0.0, 0.0)
    await api.call("mocap.set_vision_position_estimate", mocap.VisionPositionEstimate(0, body, angle, still, 0))
    await api.call("mocap.set_vision_speed_estimate", mocap.VisionSpeedEstimate(0, mocap.SpeedNed(0.0, 0.0, 0.0), still, 0))
    frame, kind = mocap.Odometry.MavFrame.MOCAP_NED, mocap.Odometry.MavEstimatorType.MOCAP
    moves = mocap.SpeedBody(0.0, 0.0, 0.0), mocap.AngularVelocityBody(0.0, 0.0, 0.0)
    odometry = mocap.Odometry(0, frame, body, q, *moves, still, still, 0, kind, 0)
    await api.call("mocap.set_odometry", odometry)
    await api.call("rtk.send_rtcm_data", types("rtk").RtcmData(base64.b64encode(b"rtcm").decode()))
    tune = types("tune")
    song = [tune.SongElement.DURATION_4, tune.SongElement.NOTE_A]
    await api.call("tune.play_tune", tune.TuneDescription(song, 100))
    utility = types("server_utility")
    await api.call("server_utility.send_status_text", utility.StatusTextType.INFO, "a script says hello")
    await api.call("transponder.set_rate_transponder", 1.0)
    await api.call("transponder.transponder", limit_s=3.0)
    failure = types("failure")
    await api.call("param.set_param_int", "SYS_FAILURE_EN", 1)
    await api.call("failure.inject", failure.FailureUnit.SENSOR_BARO, failure.FailureType.OFF, 0)
    await api.call("failure.inject", failure.FailureUnit.SENSOR_BARO, failure.FailureType.OK, 0)
    await api.call("action.set_actuator", 1, 0.5)
    await api.call("action.set_relay", 0, types("action").RelayCommand.ON)
    await api.call("action.transition_to_fixedwing")
    await api.call("action.transition_to_multicopter")


async def calibration(api):
    """One after the other, the first cancelled: a vehicle calibrates one sensor at a time."""
    await cancelled_by(api, "calibration.cancel", api._value("calibration.calibrate_gyro", (), None), 0.3)
    for name in ("gyro", "level_horizon", "accelerometer", "magnetometer", "gimbal_accelerometer"):
        await api.call(f"calibration.calibrate_{name}", limit_s=4.0)


async def fly(api):
    """Everything that moves the vehicle, with a look at where it went."""
    await api.call("core.set_mavlink_timeout", 3.0) if "core" in api.tried else None
    listener = asyncio.create_task(api.call("events.events", limit_s=10.0))
    await api.call("action.arm_force")
    await api.call("action.disarm")
    await api.call("action.arm")
    await until("armed", lambda: api.armed, 3.0)
    await listener
    await api.call("action.takeoff")
    await until("3 m high", lambda: -api.position[2] > 2.7, 15.0)
    await until("hold", lambda: api.mode == "HOLD", 5.0)
    await asyncio.gather(told_in_flight(api), go_places(api))
    await offboard(api)
    await by_hand(api)
    await follow(api)
    await missions(api)
    await home_again(api)


async def told_in_flight(api):
    """What is told of a flight while it lasts."""
    streaming = asyncio.create_task(api.call("log_streaming.log_streaming_raw"))
    await asyncio.sleep(0.1)
    await api.call("log_streaming.start_log_streaming")
    await streaming
    await api.call("log_streaming.stop_log_streaming")
    await api.call("info.get_speed_factor")
    await api.call("info.flight_information")


async def go_places(api):
    high = HOME[2] + 3.0
    await api.call("action.set_current_speed", 4.0)
    await api.call("action.goto_location", *globe(6.0, 0.0), high, 90.0)
    await near(api, (6.0, 0.0, -3.0), 0.5, 15.0, "goto_location")
    if api.has("action.goto_location_fixedwing"):
        await api.call("action.goto_location_fixedwing", *globe(6.0, 4.0), high, 20.0)
    else:
        await api.call("action.goto_location", *globe(6.0, 4.0), high, 90.0)
    await near(api, (6.0, 4.0, -3.0), 1.0, 15.0, "goto")
    behaviour = types("action").OrbitYawBehavior.HOLD_FRONT_TO_CIRCLE_CENTER
    centre = (6.0, 9.0, -3.0)
    await api.call("action.do_orbit", 5.0, 2.5, behaviour, *globe(*centre[:2]), high)
    await until("do_orbit: on the circle", lambda: abs(math.dist(api.position, centre) - 5.0) < 0.7, 12.0)
    radii = []
    for _ in range(20):
        await asyncio.sleep(0.1)
        radii.append(math.dist(api.position, centre))
    expect(4.0 < min(radii) and max(radii) < 6.0, f"do_orbit: {min(radii):.1f} to {max(radii):.1f} m from the centre")
    await api.call("action.hold")
    await until("hold", lambda: api.mode == "HOLD", 3.0)


async def settles(api, wanted, what, limit_s=6.0, within=0.35):
    await until(f"{what}: velocity {wanted}", lambda: math.dist(api.velocity, wanted) < within, limit_s)


async def offboard(api):
    kinds = types("offboard")
    await asyncio.sleep(1.0)
    north, east, _ = start = api.position
    await api.call("offboard.set_position_ned", kinds.PositionNedYaw(north, east, -3.0, 0.0))
    await api.call("offboard.start")
    await until("offboard", lambda: api.mode == "OFFBOARD", 3.0)
    expect(await api.call("offboard.is_active"), "offboard is not active")
    await api.call("offboard.set_position_ned", kinds.PositionNedYaw(north + 2.0, east, -3.0, 0.0))
    await near(api, (north + 2.0, east, -3.0), 0.4, 8.0, "set_position_ned")
    await api.call("offboard.set_velocity_ned", kinds.VelocityNedYaw(0.0, -1.5, 0.0, 0.0))
    await settles(api, (0.0, -1.5, 0.0), "set_velocity_ned")
    # Heading north: forward is north.
    await api.call("offboard.set_velocity_body", kinds.VelocityBodyYawspeed(1.5, 0.0, 0.0, 0.0))
    await settles(api, (1.5, 0.0, 0.0), "set_velocity_body")
    north, east, _ = start
    place = kinds.PositionNedYaw(north, east, -4.0, 0.0)
    await api.call("offboard.set_position_velocity_ned", place, kinds.VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
    await near(api, (north, east, -4.0), 0.5, 10.0, "set_position_velocity_ned")
    over_home = kinds.PositionGlobalYaw.AltitudeType.REL_HOME
    await api.call("offboard.set_position_global", kinds.PositionGlobalYaw(*globe(north, east + 2.0), 3.0, 0.0, over_home))
    await near(api, (north, east + 2.0, -3.0), 0.5, 8.0, "set_position_global")
    await api.call("offboard.set_attitude", kinds.Attitude(0.0, -10.0, 0.0, 0.5))
    await until("set_attitude: accelerates north", lambda: api.velocity[0] > 0.8, 4.0)
    await api.call("offboard.set_attitude_rate", kinds.AttitudeRate(0.0, 0.0, 45.0, 0.5))
    turning = lambda: api.latest["telemetry.attitude_angular_velocity_body"].yaw_rad_s > 0.5  # noqa: E731
    await until("set_attitude_rate: turns", turning, 3.0)
    await api.call("offboard.set_velocity_ned", kinds.VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
    await settles(api, (0.0, 0.0, 0.0), "stop")
    acceleration = kinds.AccelerationNed(0.0, 1.0, 0.0)
    await api.call("offboard.set_acceleration_ned", acceleration)
    await asyncio.sleep(1.0)
    north, east, down = api.position
    zero = kinds.VelocityNedYaw(0.0, 0.0, 0.0, 0.0)
    still = kinds.AccelerationNed(0.0, 0.0, 0.0)
    place = kinds.PositionNedYaw(north, east, down, 0.0)
    await api.call("offboard.set_position_velocity_acceleration_ned", place, zero, still)
    await asyncio.sleep(1.0)
    await api.call("offboard.set_velocity_ned", zero)
    controls = kinds.ActuatorControl([kinds.ActuatorControlGroup([0.0] * 8)] * 2)
    await api.call("offboard.set_actuator_control", controls)
    await api.call("offboard.set_velocity_ned", zero)
    await api.call("offboard.stop")
    await until("hold", lambda: api.mode == "HOLD", 4.0)


async def by_hand(api):
    """Sticks instead of setpoints: these come in a stream, 0.5 s without them are a loss."""
    stick = 0.0

    async def stream():
        while True:
            await api.function("manual_control.set_manual_control_input")(stick, 0.0, 0.5, 0.0)
            await asyncio.sleep(0.05)

    await api.call("manual_control.set_manual_control_input", stick, 0.0, 0.5, 0.0)
    streaming = asyncio.create_task(stream())
    await asyncio.sleep(0.3)
    await api.call("manual_control.start_altitude_control")
    await api.call("manual_control.start_position_control")
    if api.outcomes["manual_control.start_position_control"] == "works":
        await until("position mode", lambda: api.mode == "POSCTL", 3.0)
        stick = 0.4
        fast = asyncio.create_task(until("flies by sticks", lambda: math.hypot(*api.velocity[:2]) > 1.0, 10.0))
        while not fast.done():
            await asyncio.wait([fast], timeout=1.0)
            if api.mode != "POSCTL":
                # The same gaps let go of the sticks.
                await api.call("manual_control.start_position_control")
        await fast
        stick = 0.0
    streaming.cancel()
    await api.call("action.hold")


async def follow(api):
    kinds = types("follow_me")
    config = await api.call("follow_me.get_config")
    await api.call("follow_me.set_config", config)
    await api.call("follow_me.is_active")
    await api.call("follow_me.start")
    await until("follow mode", lambda: api.mode == "FOLLOW_ME", 3.0)
    north, east, _ = api.position
    target = kinds.TargetLocation(*globe(north + 5.0, east), HOME[2], 0.0, 0.0, 0.0)
    await api.call("follow_me.set_target_location", target)
    await api.call("follow_me.get_last_location")
    await asyncio.sleep(1.0)
    await api.call("follow_me.stop")
    await api.call("action.hold")


async def missions(api):
    kinds = types("mission")
    stop = kinds.MissionItem.CameraAction.NONE

    def item(north, east):
        lat, lon = globe(north, east)
        extra = {"vehicle_action": kinds.MissionItem.VehicleAction.NONE} if hasattr(kinds.MissionItem, "VehicleAction") else {}
        fields = {"gimbal_pitch_deg": NAN, "gimbal_yaw_deg": NAN, "camera_action": stop, "loiter_time_s": NAN}
        fields |= {"camera_photo_interval_s": NAN, "acceptance_radius_m": 0.5, "yaw_deg": NAN, "camera_photo_distance_m": NAN}
        return kinds.MissionItem(
            latitude_deg=lat, longitude_deg=lon, relative_altitude_m=3.0, speed_m_s=4.0, is_fly_through=True, **fields, **extra
        )

    plan = kinds.MissionPlan([item(0.0, 6.0), item(0.0, 0.0)])
    await api.call("mission.set_return_to_launch_after_mission", False)
    await api.call("mission.get_return_to_launch_after_mission")
    await api.call("mission.upload_mission_with_progress", plan)
    await asyncio.sleep(0.3)
    await api.call("mission.upload_mission", plan)
    back = await api.call("mission.download_mission")
    expect(len(back.mission_items) == 2, "the mission came back changed")
    await api.call("mission.download_mission_with_progress")
    await asyncio.sleep(0.3)
    await api.call("mission.cancel_mission_upload")
    await api.call("mission.cancel_mission_download")
    await api.call("mission.set_current_mission_item", 0)
    await api.call("mission.mission_progress")
    await api.call("mission.start_mission")
    await until("mission mode", lambda: api.mode == "MISSION", 4.0)
    await api.call("mission.pause_mission")
    await until("hold", lambda: api.mode == "HOLD", 4.0)
    await api.call("mission.start_mission")
    await near(api, (0.0, 6.0, -3.0), 1.0, 25.0, "start_mission")
    await api.call("mission_raw.pause_mission")
    await api.call("mission_raw.start_mission")

    limit = time.monotonic() + 25.0
    while not await api.call("mission.is_mission_finished"):
        expect(time.monotonic() < limit, "the mission does not end")
        await asyncio.sleep(0.2)
    expect(math.dist(api.position, (0.0, 0.0, -3.0)) < 1.5, f"the mission ended at {api.position}")
    await api.call("mission.clear_mission")


async def home_again(api):
    await api.call("action.goto_location", *globe(4.0, 0.0), HOME[2] + 4.0, NAN)
    await near(api, (4.0, 0.0, -4.0), 0.7, 10.0, "goto_location")
    await api.call("action.return_to_launch")
    await until("return", lambda: api.mode == "RETURN_TO_LAUNCH", 3.0)
    await until("over home", lambda: math.hypot(*api.position[:2]) < 1.0, 15.0)
    await api.call("action.land")
    await until("landed and disarmed", lambda: not api.armed, 25.0)
    expect(math.hypot(*api.position[:2]) < 1.5, f"landed at {api.position}")
    await api.call("log_files.get_entries")
    entries = await api.function("log_files.get_entries")()
    with tempfile.TemporaryDirectory() as folder:
        await api.call("log_files.download_log_file", entries[0], str(Path(folder) / "log"), limit_s=15.0)
    if api.has("log_files.cancel_download_log_file"):
        await api.call("log_files.cancel_download_log_file")
    await api.call("log_files.erase_all_log_files")
    if api.has("action.set_home"):
        await api.call("action.set_home", False, *globe(1.0, 0.0), HOME[2])
    await api.call("action.set_gps_global_origin", HOME[0] + 0.01, *HOME[1:])
    await api.call("action.arm")
    await until("armed", lambda: api.armed, 3.0)
    await api.call("action.kill")
    await until("killed", lambda: not api.armed, 3.0)
    await api.call("action.arm")
    await until("armed", lambda: api.armed, 3.0)
    await api.call("action.terminate")
    await api.call("action.reboot")
    await asyncio.sleep(1.0)
    await api.call("action.shutdown")


async def main(api):
    await api.connect()
    for name in ("position_velocity_ned", "flight_mode", "armed", "health_all_ok", "attitude_angular_velocity_body"):
        api.keep_newest(f"telemetry.{name}")
    await until("ready", lambda: len(api.latest) == 5 and api.latest["telemetry.health_all_ok"], 20.0)
    aside = asyncio.gather(devices(api), telemetry(api), sent_only(api), calibration(api))
    # One after the other what shares a client inside MAVSDK: metadata comes by file transfer.
    await asyncio.gather(parameters(api), plans(api))
    await information(api)
    await files(api)
    await asyncio.gather(fly(api), text_parameters(api))
    await aside
    missing = [name for name in api.all_names() if name not in api.outcomes]
    return {"calls": sorted(api.all_names()), "outcomes": api.outcomes, "not tried": missing}


async def run(instance):
    """Prints the report, or what failed, and ends: MAVSDK's threads would outlive the loop."""
    api, code = Api(instance), 1
    try:
        print(json.dumps(await asyncio.wait_for(main(api), LIMIT_S)), flush=True)
        code = 0
    except BaseException:
        traceback.print_exc()
    sys.stderr.flush()
    api.end()
    os._exit(code)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--instance", type=int, default=0, help="number of the simulator (default 0)")
    args = parser.parse_args()
    asyncio.run(run(args.instance))
