"""What ground stations ask for when they connect, and what people's scripts do without asking, by pymavlink alone.

Each item of `PARTS` is tried against the vehicle; the report says of each "works", or what happened instead.
"""

import argparse
import json
import math
import os
import struct
import tempfile
import time
from pathlib import Path

os.environ["MAVLINK20"] = "1"
from pymavlink import mavftp, mavutil
from pymavlink.dialects.v20 import all as dialect

mavutil.set_dialect("all")
NAN = math.nan
ACCEPTED, REJECTED, DENIED = 0, 1, 2
LOCAL_NED, BODY_NED, GLOBAL_INT, RELATIVE_INT = 1, 8, 5, 6
HOLD, MISSION, RETURN, LAND, FOLLOW = (4, 3), (4, 4), (4, 5), (4, 6), (4, 8)
OFFBOARD, POSITION, ALTITUDE, MANUAL, STABILIZED, ACRO = (6, 0), (3, 0), (2, 0), (1, 0), (7, 0), (5, 0)
# What the set-up pages of a ground station read.
SET_UP = """SYS_AUTOSTART SYS_AUTOCONFIG CAL_MAG0_ID CAL_GYRO0_ID CAL_ACC0_ID SENS_BOARD_ROT SENS_BOARD_X_OFF SENS_DPRES_OFF
RC_MAP_ROLL RC_MAP_PITCH RC_MAP_YAW RC_MAP_THROTTLE RC_MAP_FLTMODE RC_CHAN_CNT COM_RC_IN_MODE COM_FLTMODE1 COM_FLTMODE6
BAT1_N_CELLS BAT1_V_EMPTY BAT1_V_CHARGED BAT_LOW_THR COM_LOW_BAT_ACT NAV_RCL_ACT NAV_DLL_ACT COM_RC_LOSS_T CP_DIST
CA_ROTOR_COUNT PWM_MAIN_FUNC4 RTL_LAND_DELAY RTL_DESCEND_ALT TRIG_MODE MNT_MODE_IN""".split()
SET_UNASKED = {
    "COM_RCL_EXCEPT": 4, "RTL_TYPE": 1, "NAV_MC_ALT_RAD": 0.5, "MPC_Z_V_AUTO_DN": 1.2, "EKF2_HGT_REF": 0,
    "SYS_FAILURE_EN": 1, "MPC_XY_VEL_MAX": 12.0, "COM_RC_IN_MODE": 4, "COM_OF_LOSS_T": 1.0, "CBRK_SUPPLY_CHK": 0,
    "COM_OBL_RC_ACT": 0, "NAV_RCL_ACT": 0, "EKF2_EV_CTRL": 3, "EKF2_GPS_CTRL": 0, "MIS_TKO_LAND_REQ": 2, "MPC_XY_CRUISE": 12.0,
    "MPC_Z_VEL_MAX_UP": 5.0, "MPC_Z_VEL_MAX_DN": 3.0, "MPC_TKO_SPEED": 3.0, "GF_PREDICT": 1,
}  # fmt: skip


class Failed(Exception):
    """What was expected and what happened instead."""


def expect(condition, message):
    if not condition:
        raise Failed(message)


class Vehicle:
    """One connection, read by whoever waits."""

    def __init__(self, instance):
        # Sending first, so that several scripts can talk to one vehicle.
        self.link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{14580 + instance}", source_system=250)
        self.last, self.counts, self.texts, self.values = {}, {}, [], {}
        self.system = instance + 1
        self.next_heartbeat = 0.0
        self.wait("HEARTBEAT", 15.0)
        self.wait("HOME_POSITION", 15.0)
        home = self.last["HOME_POSITION"]
        self.home = home.latitude, home.longitude, home.altitude / 1e3

    def pump(self, seconds, send=None, rate_hz=20.0, until=None, watch=None):
        """Reads for a time, or until something is so; sends something at a rate meanwhile. Whether it became so."""
        end, next_send = time.monotonic() + seconds, 0.0
        while (now := time.monotonic()) < end:
            if now >= self.next_heartbeat:
                self.next_heartbeat = now + 1.0
                self.link.mav.heartbeat_send(dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, 0, 0, 0)
            if send and now >= next_send:
                next_send = now + 1.0 / rate_hz
                send()
            message = self.link.recv_match(blocking=True, timeout=0.01)
            # What the dialect does not know has no source.
            if message is not None and (message.get_srcComponent() == 1 or message.get_type().startswith("UNKNOWN")):
                self._take(message)
                if watch:
                    watch(message)
            if until and until():
                return True
        return False

    def _take(self, m):
        kind = m.get_type()
        self.last[kind] = m
        self.counts[kind] = self.counts.get(kind, 0) + 1
        if kind == "STATUSTEXT":
            self.texts.append(m.text)
        elif kind == "PARAM_VALUE":
            self.values[m.param_id] = m

    def wait(self, kind, limit_s=5.0, accept=lambda _: True):
        """The next message of a kind."""
        found = []
        self.pump(limit_s, watch=lambda m: found.append(m) if m.get_type() == kind and accept(m) else None, until=lambda: found)
        expect(found, f"no {kind} in {limit_s} s")
        return found[0]

    @property
    def mode(self):
        number = self.last["HEARTBEAT"].custom_mode
        return number >> 16 & 0xFF, number >> 24

    @property
    def armed(self):
        return bool(self.last["HEARTBEAT"].base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)

    @property
    def place(self):
        m = self.last["LOCAL_POSITION_NED"]
        return m.x, m.y, -m.z

    @property
    def speed(self):
        m = self.last["LOCAL_POSITION_NED"]
        return math.hypot(m.vx, m.vy)

    def place_of(self, north_m, east_m):
        """Latitude and longitude, 1e-7 degrees."""
        latitude, longitude, _ = self.home
        metre = 1e7 * 180.0 / (math.pi * 6371000.0)
        return round(latitude + north_m * metre), round(longitude + east_m * metre / math.cos(math.radians(latitude / 1e7)))

    def _result(self, number, send):
        for _ in range(4):
            found = []
            send()
            self.pump(1.0, watch=lambda m: found.append(m.result) if m.get_type() == "COMMAND_ACK" and m.command == number else None,
                      until=lambda: found)  # fmt: skip
            if found:
                return found[0]
        raise Failed(f"command {number} was not acknowledged")

    def long(self, number, *params):
        params = [*params, *[NAN] * (7 - len(params))]
        return self._result(number, lambda: self.link.mav.command_long_send(self.system, 1, number, 0, *params))

    def int(self, number, frame, params, x, y, z):
        return self._result(number, lambda: self.link.mav.command_int_send(self.system, 1, frame, number, 0, 0, *params, x, y, z))

    def do(self, number, *params):
        result = self.long(number, *params)
        expect(result == ACCEPTED, f"command {number} got result {result}: {self.texts[-2:]}")

    def enter(self, mode):
        self.do(dialect.MAV_CMD_DO_SET_MODE, 1, *mode)
        self.until(f"mode {mode}", lambda: self.mode == mode, 2.0)

    def until(self, what, condition, limit_s, send=None, rate_hz=20.0):
        expect(self.pump(limit_s, send, rate_hz, until=condition), f"not within {limit_s} s: {what}; {self.texts[-3:]}")

    def get(self, name):
        """A parameter, integers bytewise."""
        self.values.pop(name, None)
        self.until(name, lambda: name in self.values, 2.0,
                   lambda: self.link.mav.param_request_read_send(self.system, 1, name.encode(), -1), 2.0)  # fmt: skip
        return self._number(self.values[name])

    @staticmethod
    def _number(m):
        is_float = m.param_type == dialect.MAV_PARAM_TYPE_REAL32
        return m.param_value if is_float else int.from_bytes(bytearray(_bits(m.param_value)), "little", signed=True)

    def set(self, name, value):
        """Sets a parameter and reads what the vehicle then has."""
        kind = dialect.MAV_PARAM_TYPE_REAL32 if isinstance(value, float) else dialect.MAV_PARAM_TYPE_INT32
        sent = value if isinstance(value, float) else _as_float(value)
        self.link.mav.param_set_send(self.system, 1, name.encode(), sent, kind)
        self.pump(0.2)
        return self.get(name)

    def take_off(self, height_m=5.0):
        """In hold at a height, wherever it was before."""
        if not self.armed:
            self.set("MIS_TAKEOFF_ALT", float(height_m))
            self.do(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1, 0)
            self.do(dialect.MAV_CMD_NAV_TAKEOFF)
            self.until("take-off", lambda: self.mode == HOLD and self.place[2] > height_m - 0.5, 15.0)
        elif self.mode != HOLD:
            self.enter(HOLD)
        if abs(self.place[2] - height_m) > 0.5 or math.hypot(*self.place[:2]) > 10.0:
            self.go_to(0.0, 0.0, height_m)

    def go_to(self, north_m, east_m, height_m, speed_m_s=-1.0, limit_s=30.0):
        x, y = self.place_of(north_m, east_m)
        # Above sea level, whatever the frame.
        z = self.home[2] + height_m
        result = self.int(dialect.MAV_CMD_DO_REPOSITION, RELATIVE_INT, (speed_m_s, 1, 0, NAN), x, y, z)
        expect(result == ACCEPTED, f"reposition got {result}: {self.texts[-1:]}")
        goal = north_m, east_m, height_m
        self.until(f"at {goal}", lambda: math.dist(self.place, goal) < 0.6 and self.speed < 0.4, limit_s)

    def land(self):
        if self.armed:
            self.do(dialect.MAV_CMD_NAV_LAND)
            self.until("disarmed", lambda: not self.armed, 40.0)

    def local(self, mask, frame=LOCAL_NED, position=(0, 0, 0), velocity=(0, 0, 0), acceleration=(0, 0, 0), yaw=0.0, yaw_rate=0.0):
        return lambda: self.link.mav.set_position_target_local_ned_send(
            0, self.system, 1, frame, mask, *position, *velocity, *acceleration, yaw, yaw_rate
        )

    def attitude(self, thrust, pitch_deg=0.0, yaw_rate=0.0, mask=0x07):
        half = math.radians(pitch_deg) / 2
        return lambda: self.link.mav.set_attitude_target_send(
            0, self.system, 1, mask, [math.cos(half), 0, math.sin(half), 0], 0, 0, yaw_rate, thrust
        )

    def offboard(self, send, seconds, rate_hz=20.0, until=None):
        """Streams a setpoint, entering OFFBOARD by it."""
        if self.mode != OFFBOARD:
            self.pump(0.4, send, rate_hz=20.0)
            self.do(dialect.MAV_CMD_DO_SET_MODE, 1, *OFFBOARD)
        return self.pump(seconds, send, rate_hz, until)

    def upload(self, items, kind=0):
        """The result of an upload of MISSION_ITEM_INT fields (frame, command, params, x, y, z)."""
        self.link.mav.mission_count_send(self.system, 1, len(items), kind)
        result = []

        def answer(m):
            if m.get_type() in ("MISSION_REQUEST_INT", "MISSION_REQUEST") and m.mission_type == kind:
                frame, command, params, x, y, z = items[m.seq]
                self.link.mav.mission_item_int_send(self.system, 1, m.seq, frame, command, 0, 1, *params, x, y, z, kind)
            elif m.get_type() == "MISSION_ACK":
                result.append(m.type)

        self.pump(5.0, watch=answer, until=lambda: result)
        expect(result, "no MISSION_ACK")
        return result[0]


def _bits(value):
    return struct.pack("<f", value)


def _as_float(value):
    return struct.unpack("<f", struct.pack("<i", value))[0]


# A ground station connects.


def available_modes(v):
    seen = {}

    def watch(m):
        if m.get_type() == "AVAILABLE_MODES":
            seen[m.mode_index] = m

    v.link.mav.command_long_send(v.system, 1, 512, 0, dialect.MAVLINK_MSG_ID_AVAILABLE_MODES, 0, 0, 0, 0, 0, 0)
    v.pump(5.0, watch=watch, until=lambda: seen and len(seen) == next(iter(seen.values())).number_modes)
    names = {m.mode_name for m in seen.values()}
    expect(len(seen) > 5 and {"Hold", "Mission", "Return", "Position"} <= names, f"{sorted(names)}")


def current_mode(v):
    told = v.wait("CURRENT_MODE", 4.0)
    expect(told.custom_mode == v.last["HEARTBEAT"].custom_mode == told.intended_custom_mode, f"{told}")


def modes_monitor(v):
    v.wait("AVAILABLE_MODES_MONITOR", 6.0)


def hash_check(v):
    v.get("_HASH_CHECK")
    first = v.values["_HASH_CHECK"].param_value
    before = v.get("NAV_ACC_RAD")
    v.set("NAV_ACC_RAD", before + 1.0)
    v.get("_HASH_CHECK")
    expect(_bits(v.values["_HASH_CHECK"].param_value) != _bits(first), "it does not change")
    v.set("NAV_ACC_RAD", before)
    v.get("_HASH_CHECK")
    expect(_bits(v.values["_HASH_CHECK"].param_value) == _bits(first), "it does not come back")


def set_up_pages(v):
    missing = []
    for name in SET_UP:
        try:
            v.get(name)
        except Failed:
            missing.append(name)
    expect(not missing, f"missing: {missing}")
    expect(v.get("SYS_AUTOSTART") == 4001, "SYS_AUTOSTART")


def packed_parameters(v):
    v.link.target_system, v.link.target_component = v.system, 1
    before = v.get("NAV_ACC_RAD")
    v.set("NAV_ACC_RAD", 7.5)
    with tempfile.TemporaryDirectory() as folder:
        values, defaults = Path(folder) / "values", Path(folder) / "defaults"
        ftp = mavftp.MAVFTP(v.link, v.system, 1)
        ftp.cmd_getparams([str(values), str(defaults)])
        result = ftp.process_ftp_reply("getparams", timeout=15)
        expect(result.error_code == 0, f"{result.error_code}")
        now, default = (dict(line.split(",") for line in file.read_text(encoding="utf-8").split()) for file in (values, defaults))
        expect(now.keys() == default.keys() and "SYS_AUTOSTART" in now, f"{now.keys() ^ default.keys()}")
        expect(len(now) == v.values["NAV_ACC_RAD"].param_count, f"{len(now)} parameters")
        expect((now["NAV_ACC_RAD"], default["NAV_ACC_RAD"]) == ("7.5", "2"), f"{now['NAV_ACC_RAD']}")
    v.set("NAV_ACC_RAD", before)


def ping(v):
    v.wait("PING", 12.0)
    v.link.mav.ping_send(1, 7, 0, 0)
    v.wait("PING", 2.0, lambda m: m.seq == 7 and m.target_system == 250)


def link_node_status(v):
    # pymavlink's dialects leave it out.
    v.counts.pop("UNKNOWN_8", None)
    expect(v.pump(3.0, until=lambda: v.counts.get("UNKNOWN_8")), "none in 3 s")


def preflight_storage(v):
    v.set("NAV_ACC_RAD", 3.0)
    v.do(dialect.MAV_CMD_PREFLIGHT_STORAGE, 1)
    v.do(dialect.MAV_CMD_PREFLIGHT_STORAGE, 2)
    expect(v.get("NAV_ACC_RAD") == 2.0, "not the default")


def actuator_test(v):
    # Parameter 5 the function: motor 1.
    v.do(dialect.MAV_CMD_ACTUATOR_TEST, 0.4, 1.0, 0, 0, 1, 0, 0)
    v.until("the output", lambda: v.last.get("SERVO_OUTPUT_RAW") and v.last["SERVO_OUTPUT_RAW"].servo1_raw == 1400, 2.0)
    expect(v.long(dialect.MAV_CMD_ACTUATOR_TEST, 0.4, 1.0, 0, 0, 33, 0, 0) == 3, "an output that is not there")


def system_time(v):
    told = v.wait("SYSTEM_TIME", 3.0)
    expect(abs(told.time_unix_usec / 1e6 - time.time()) < 5.0, f"{told.time_unix_usec}")


def parameters_unasked(v):
    kept = {name: v.get(name) for name in SET_UNASKED}
    refused = [name for name, value in SET_UNASKED.items() if abs(v.set(name, value) - value) > 1e-6]
    for name, value in kept.items():
        v.set(name, value)
    expect(not refused, f"refused: {refused}")


def ground_truth(v):
    v.do(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, dialect.MAVLINK_MSG_ID_HIL_STATE_QUATERNION, 50_000)
    told = v.wait("HIL_STATE_QUATERNION", 2.0)
    expect(abs(told.lat - v.home[0]) < 2000, f"{told.lat}")


def modes_on_the_ground(v):
    centred = lambda: v.link.mav.manual_control_send(v.system, 0, 0, 500, 0, 0)
    for mode in (ALTITUDE, MANUAL, STABILIZED, ACRO, POSITION):
        v.pump(0.2, centred)
        v.enter(mode)
        # With the throttle down, as a pilot arms.
        v.pump(0.3, lambda: v.link.mav.manual_control_send(v.system, 0, 0, 0, 0, 0))
        v.do(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1, 0)
        v.do(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0, 0)
    v.enter(HOLD)


def channels_override(v):
    def channels(throttle, pitch=1500):
        return lambda: v.link.mav.rc_channels_override_send(v.system, 1, 1500, pitch, throttle, 1500, *[65535] * 4)

    v.pump(0.3, channels(1000))
    v.enter(POSITION)
    v.pump(0.2, channels(1000))
    v.do(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1, 0)
    v.until("climbs", lambda: v.place[2] > 2.0, 15.0, channels(1800))
    v.pump(4.0, channels(1500, 1200))
    expect(v.speed > 1.0, f"{v.speed:.1f} m/s by the stick")
    v.pump(2.0, channels(1500))
    v.land()


def parameter_checks(v):
    expect(v.long(dialect.MAV_CMD_NAV_LAND, NAN, NAN, 5.0) == DENIED, "a forbidden parameter is not DENIED")
    x, y = v.place_of(10.0, 0.0)
    strange = (RELATIVE_INT, 16, (0, 0, 1.0, NAN), x, y, 5.0)
    result = v.upload([strange])
    expect(result == dialect.MAV_MISSION_INVALID_PARAM3, f"NAV_WAYPOINT got {result}")


def geofence_checks(v):
    corners = [(40, 40), (40, -40), (-40, -40), (-40, 40)]
    fence = [(GLOBAL_INT, 5001, (4, 0, 0, 0), *v.place_of(*corner), 0) for corner in corners]
    two = [(frame, command, (2, 0, 0, 0), x, y, z) for frame, command, _, x, y, z in fence[:2]]
    result = v.upload(two, 1)
    expect(result != 0, f"a polygon of two corners got {result}")
    expect(v.upload(fence, 1) == 0, "the fence is refused")
    x, y = v.place_of(60.0, 0.0)
    result = v.upload([(RELATIVE_INT, 16, (0, 0, 0, NAN), x, y, 5.0)])
    started = v.long(dialect.MAV_CMD_MISSION_START, 0, 0)
    expect(result != 0 or started != ACCEPTED, "a mission out of the fence begins")
    v.link.mav.mission_clear_all_send(v.system, 1, 255)
    v.wait("MISSION_ACK")


# Modes and commands in flight.


def orbit(v):
    x, y = v.place_of(0.0, 0.0)
    # As MAVSDK: COMMAND_INT, the altitude above sea level, in a frame that says otherwise.
    for frame in (RELATIVE_INT, GLOBAL_INT):
        result = v.int(dialect.MAV_CMD_DO_ORBIT, frame, (10.0, 2.0, 0, NAN), x, y, v.home[2] + 10.0)
        expect(result == ACCEPTED, f"{result}")
    v.pump(15.0)
    radius = math.hypot(*v.place[:2])
    expect(abs(v.place[2] - 10.0) < 0.5 and abs(radius - 10.0) < 1.0, f"{v.place}")


def change_speed(v):
    v.do(dialect.MAV_CMD_DO_CHANGE_SPEED, 1, 1.5, -1)
    fastest = [0.0]
    x, y = v.place_of(20.0, 0.0)
    v.int(dialect.MAV_CMD_DO_REPOSITION, RELATIVE_INT, (-1, 1, 0, NAN), x, y, v.home[2] + 5.0)

    def watch(_):
        fastest[0] = max(fastest[0], v.speed)

    v.pump(8.0, watch=watch)
    expect(1.2 < fastest[0] < 1.8, f"{fastest[0]:.2f} m/s")
    v.do(dialect.MAV_CMD_DO_CHANGE_SPEED, 1, -2, -1)


def region_of_interest(v):
    x, y = v.place_of(v.place[0], v.place[1] + 30.0)
    expect(v.int(dialect.MAV_CMD_DO_SET_ROI_LOCATION, RELATIVE_INT, (0, 0, 0, 0), x, y, 0.0) == ACCEPTED, "refused")
    v.until("the nose points east", lambda: abs(math.degrees(v.last["ATTITUDE"].yaw) - 90.0) < 8.0, 12.0)
    v.do(dialect.MAV_CMD_DO_SET_ROI_NONE)


def follow_me(v):
    v.set("FLW_TGT_HT", 6.0)
    start = time.monotonic()

    def report():
        north = 12.0 + 1.5 * (time.monotonic() - start)
        x, y = v.place_of(north, 0.0)
        v.link.mav.follow_target_send(0, 3, x, y, v.home[2], (1.5, 0, 0), (0, 0, 0), (1, 0, 0, 0), (0, 0, 0), (0, 0, 0), 0)

    v.pump(1.0, report, 2.0)
    v.enter(FOLLOW)
    v.pump(20.0, report, 2.0)
    behind = 12.0 + 1.5 * (time.monotonic() - start) - v.place[0]
    expect(5.0 < behind < 11.0 and abs(v.place[2] - 6.0) < 1.0, f"{behind:.1f} m behind at {v.place}")


def straight_legs(v):
    v.go_to(-30.0, 0.0, 5.0)
    items = [(2, 178, (1, 4.0, -1, 0), 0, 0, 0)]
    items += [(RELATIVE_INT, 16, (0, 0, 0, NAN), *v.place_of(north, 0.0), 5.0) for north in (-15.0, 0.0, 15.0, 30.0)]
    expect(v.upload(items) == 0, "refused")
    v.do(dialect.MAV_CMD_MISSION_START, 0, 0)
    speeds = []

    def watch(m):
        if m.get_type() == "LOCAL_POSITION_NED" and -18.0 < m.x < 18.0:
            speeds.append(v.speed)

    v.pump(30.0, watch=watch, until=lambda: v.place[0] > 29.0)
    expect(speeds and min(speeds) > 3.6, f"{min(speeds, default=0.0):.1f} m/s")


# Offboard.


def slow_stream(v):
    send = v.local(0xDC7, velocity=(0.3, 0, 0))
    v.offboard(send, 6.0, 2.5)
    expect(v.mode == OFFBOARD, "left by a stream of 2.5 Hz")


def stalled_stream(v):
    send = v.local(0xDC7, velocity=(-0.3, 0, 0))
    for _ in range(3):
        v.offboard(send, 1.0)
        v.pump(0.6)
        expect(v.mode == OFFBOARD, "left by a stall of 0.6 s")
    v.until("hold after 1 s of silence", lambda: v.mode == HOLD, 2.0)


def reach(v, send, place, limit_s=15.0):
    expect(v.offboard(send, limit_s, until=lambda: math.dist(v.place, place) < 0.5), f"{v.place} instead of {place}")
    expect(v.mode == OFFBOARD, f"mode {v.mode}")


def setpoint_all(v):
    reach(v, v.local(0, position=(4, 2, -6), velocity=(0, 0, 0)), (4, 2, 6))
    reach(v, v.local(0x800, position=(0, 0, -5)), (0, 0, 5))


def setpoint_acceleration(v):
    v.offboard(v.local(0xC3F, acceleration=(1.0, 0, 0)), 2.5)
    expect(v.mode == OFFBOARD and v.last["LOCAL_POSITION_NED"].vx > 1.0, f"{v.last['LOCAL_POSITION_NED'].vx:.1f} m/s")
    v.offboard(v.local(0xC3F, acceleration=(-1.0, 0, 0)), 2.0)


def setpoint_velocity_with_height(v):
    v.offboard(v.local(0xDE3, position=(0, 0, -7), velocity=(0, 1.0, 0)), 6.0)
    m = v.last["LOCAL_POSITION_NED"]
    expect(abs(v.place[2] - 7.0) < 0.5 and abs(m.vy - 1.0) < 0.3, f"{v.place}, {m.vy:.1f} m/s")


def setpoint_place_with_climb(v):
    north, east, height = v.place
    v.offboard(v.local(0xDDC, position=(north, east, 0), velocity=(0, 0, -0.5)), 6.0)
    expect(2.0 < v.place[2] - height < 3.5 and math.dist(v.place[:2], (north, east)) < 0.5, f"{v.place}")


def setpoint_attitude_with_yaw_rate(v):
    turned, before = [0.0], [None]

    def watch(m):
        if m.get_type() == "ATTITUDE":
            if before[0] is not None:
                turned[0] += (m.yaw - before[0] + math.pi) % (2 * math.pi) - math.pi
            before[0] = m.yaw

    send = v.attitude(0.5, yaw_rate=0.5, mask=0x03)
    v.offboard(send, 1.0)
    v.pump(4.0, send, watch=watch)
    # The attitude's heading, north, but for the rate over the gain: the rate is a feed-forward.
    expect(abs(turned[0]) < 0.4, f"{turned[0]:.1f} rad in 4 s at 0.5 rad/s")


def attitude_landing(v):
    v.take_off(3.0)
    down = v.attitude(0.45)
    v.offboard(down, 1.0)
    v.until("disarmed", lambda: not v.armed, 40.0, down)


# Failures.


def injection_needs_leave(v):
    expect(v.long(dialect.MAV_CMD_INJECT_FAILURE, 4, 1, 0) == DENIED, "obeyed without SYS_FAILURE_EN")
    expect(v.set("SYS_FAILURE_EN", 1) == 1, "SYS_FAILURE_EN")


def lost_barometer_and_magnetometer(v):
    for unit in (dialect.FAILURE_UNIT_SENSOR_BARO, dialect.FAILURE_UNIT_SENSOR_MAG):
        v.do(dialect.MAV_CMD_INJECT_FAILURE, unit, dialect.FAILURE_TYPE_OFF, 0)
        v.pump(4.0)
        expect(v.mode == HOLD and abs(v.place[2] - 5.0) < 0.7, f"unit {unit}: {v.mode} at {v.place}")
        v.do(dialect.MAV_CMD_INJECT_FAILURE, unit, dialect.FAILURE_TYPE_OK, 0)


def lost_gps(v):
    v.do(dialect.MAV_CMD_INJECT_FAILURE, dialect.FAILURE_UNIT_SENSOR_GPS, dialect.FAILURE_TYPE_OFF, 0)
    v.until("landing", lambda: v.mode == LAND, 10.0)
    v.until("disarmed", lambda: not v.armed, 40.0)
    expect(any("position lost" in text for text in v.texts), f"{v.texts[-3:]}")
    expect(v.long(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1, 0) == REJECTED, "armed without GPS")
    v.do(dialect.MAV_CMD_INJECT_FAILURE, dialect.FAILURE_UNIT_SENSOR_GPS, dialect.FAILURE_TYPE_OK, 0)


PARTS = {
    "connect": {
        "AVAILABLE_MODES lists the modes": available_modes,
        "CURRENT_MODE is streamed": current_mode,
        "AVAILABLE_MODES_MONITOR is streamed": modes_monitor,
        "`_HASH_CHECK` follows the parameters": hash_check,
        "SYS_AUTOSTART and what else set-up pages read": set_up_pages,
        "`@PARAM/param.pck` by pymavlink's FTP": packed_parameters,
        "PING is streamed and answered": ping,
        "LINK_NODE_STATUS is streamed": link_node_status,
        "PREFLIGHT_STORAGE": preflight_storage,
        "ACTUATOR_TEST": actuator_test,
        "SYSTEM_TIME is the host's": system_time,
        "parameters that scripts set without asking": parameters_unasked,
        "HIL_STATE_QUATERNION as ground truth": ground_truth,
        "a forbidden parameter: DENIED, INVALID_PARAM3": parameter_checks,
        "geofence checks": geofence_checks,
        "ALTCTL, MANUAL, STABILIZED, ACRO, POSCTL on the ground": modes_on_the_ground,
        "RC_CHANNELS_OVERRIDE flies": channels_override,
    },
    "flight": {
        "DO_ORBIT at an altitude above sea level": orbit,
        "DO_CHANGE_SPEED in hold holds for the next reposition": change_speed,
        "ROI turns the nose": region_of_interest,
    },
    "ways": {
        "FOLLOW_TARGET is followed": follow_me,
        "speed along a mission's straight legs": straight_legs,
    },
    "offboard": {
        "OFFBOARD by a stream of 2.5 Hz": slow_stream,
        "OFFBOARD over stalls of 0.6 s, hold after 1 s": stalled_stream,
        "setpoint: position, velocity, acceleration (0, 0x800)": setpoint_all,
        "setpoint: acceleration alone (0xC3F)": setpoint_acceleration,
        "setpoint: horizontal velocity with height (0xDE3)": setpoint_velocity_with_height,
        "setpoint: place with rate of climb (0xDDC)": setpoint_place_with_climb,
        "setpoint: attitude with yaw rate": setpoint_attitude_with_yaw_rate,
        "OFFBOARD by attitude lands and disarms": attitude_landing,
    },
    "failures": {
        "INJECT_FAILURE needs SYS_FAILURE_EN": injection_needs_leave,
        "barometer or magnetometer off: flies on": lost_barometer_and_magnetometer,
        "GPS off: lands, and does not arm": lost_gps,
    },
}


def run(instance, parts):
    """The outcome of each item of each part, in order; one that fails leaves the others their chance."""
    vehicle = Vehicle(instance)
    vehicle.until("ready", lambda: vehicle.last.get("SYS_STATUS")
                  and vehicle.last["SYS_STATUS"].onboard_control_sensors_health & dialect.MAV_SYS_STATUS_PREARM_CHECK, 20.0)  # fmt: skip
    outcomes = {}
    for part in parts:
        outcomes[part] = {}
        for name, item in PARTS[part].items():
            try:
                if part != "connect":
                    # In hold, wherever the one before left it.
                    vehicle.take_off()
                item(vehicle)
                outcomes[part][name] = "works"
            except Failed as failed:
                outcomes[part][name] = f"fails: {failed}"
        # Each part finds the vehicle on the ground.
        vehicle.land()
    return outcomes


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", nargs="+", choices=PARTS)
    parser.add_argument("--instance", type=int, default=0, help="number of the simulator (default 0)")
    args = parser.parse_args()
    print(json.dumps(run(args.instance, args.part)), flush=True)
