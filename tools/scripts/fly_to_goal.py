#!/usr/bin/env python3
"""Has the guidance computer fly to a goal, past whatever is in the way, and shows what it does (pymavlink).

    vigil sim & vigil firmware --engage command &     # a simulated vehicle and the flight stack
    pip install pymavlink==2.4.50
    tools/scripts/fly_to_goal.py --north 20 --east 5

Ctrl-C ends the watching: the vehicle stops and hovers.
"""

import argparse
import math
import os
import time

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil  # noqa: E402  (reads MAVLINK20 when it is imported)

mavlink = mavutil.mavlink
GUIDANCE = 191  # component id of the guidance computer
STATES = {0: "standby", 1: "ready", 2: "engaging", 3: "guided", 4: "hold", 5: "land"}


class Guidance:
    """The vehicle as seen from here: its position, and the named values of its guidance computer."""

    def __init__(self, connection):
        self.link = mavutil.mavlink_connection(connection, source_system=255)
        self.values = {}
        self.position = None
        self.text = ""
        self.armed = False
        self.next_heartbeat = 0.0
        heartbeat = self.link.wait_heartbeat(timeout=10)
        if heartbeat is None:
            raise SystemExit(f"no vehicle at {connection}: is `vigil sim` running?")
        self.system = heartbeat.get_srcSystem()

    def listen(self):
        """Takes one message; keeps the link alive."""
        if time.monotonic() > self.next_heartbeat:
            self.next_heartbeat = time.monotonic() + 1.0
            self.link.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
        message = self.link.recv_match(blocking=True, timeout=0.1)
        if message is None or message.get_srcSystem() != self.system:
            return None
        kind, component = message.get_type(), message.get_srcComponent()
        if kind == "NAMED_VALUE_FLOAT" and component == GUIDANCE:
            self.values[message.name] = message.value
        elif kind == "STATUSTEXT":
            # A long text comes in chunks.
            self.text = message.text if message.chunk_seq == 0 else self.text + message.text
            print(f"\r\033[K  {self.text}")
        elif kind == "LOCAL_POSITION_NED":
            self.position = (message.x, message.y, message.z)
        elif kind == "HEARTBEAT" and component == 1:
            self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        return message

    def state(self):
        return STATES.get(self.values.get("gd_state"), "unknown")

    def wait(self, what, condition, limit_s):
        limit = time.monotonic() + limit_s
        while not condition():
            if time.monotonic() > limit:
                raise SystemExit(f"not within {limit_s:.0f} s: {what} (guidance is in state {self.state()})")
            self.listen()

    def command(self, send, number):
        """Sends a command until it is acknowledged."""
        for _ in range(4):
            send()
            limit = time.monotonic() + 0.5
            while time.monotonic() < limit:
                m = self.listen()
                if m and m.get_type() == "COMMAND_ACK" and (m.get_srcComponent(), m.command) == (GUIDANCE, number):
                    if m.result != mavlink.MAV_RESULT_ACCEPTED:
                        result = mavlink.enums["MAV_RESULT"][m.result].name
                        raise SystemExit(f"command {number} was refused: {result}")
                    return
        raise SystemExit(f"command {number} was not acknowledged: is `vigil firmware` running?")

    def set_goal(self, north_m, east_m, height_m):
        """DO_REPOSITION in the local frame: x and y in 0.1 mm, z in metres down."""
        number, frame = mavlink.MAV_CMD_DO_REPOSITION, mavlink.MAV_FRAME_LOCAL_NED
        place = (round(north_m * 1e4), round(east_m * 1e4), -height_m)
        params = (frame, number, 0, 0, -1, 0, 0, math.nan)
        self.command(lambda: self.link.mav.command_int_send(self.system, GUIDANCE, *params, *place), number)

    def engage(self, on=True):
        """The guidance computer arms, takes off and flies; or stops and hovers."""
        number = mavlink.MAV_CMD_NAV_GUIDED_ENABLE
        params = (1.0 if on else 0.0, 0, 0, 0, 0, 0, 0)
        self.command(lambda: self.link.mav.command_long_send(self.system, GUIDANCE, number, 0, *params), number)

    def land(self):
        number = mavlink.MAV_CMD_NAV_LAND
        self.command(lambda: self.link.mav.command_long_send(self.system, GUIDANCE, number, 0, *[0] * 7), number)

    def show(self):
        """One line: state, way to go, and the detector's score if the guidance computer has a detector."""
        score = self.values.get("dt_score")
        detector = "no detector" if score is None else f"score {score:8.4f} |{'#' * min(20, int(20 * score)):20}|"
        goal_m, step_us = self.values.get("goal_m", math.nan), self.values.get("step_us", math.nan)
        print(f"\r\033[K{self.state():9} goal {goal_m:5.1f} m  step {step_us:6.0f} us  {detector}", end="", flush=True)


def main(args):
    guidance = Guidance(args.connection)
    guidance.wait("the guidance computer", lambda: "gd_state" in guidance.values, 10)
    guidance.set_goal(args.north, args.east, args.height)
    guidance.text = ""  # of an earlier goal
    guidance.wait("ready to fly", lambda: guidance.state() in ("ready", "guided", "hold"), 10)
    guidance.engage()
    limit = time.monotonic() + args.limit
    try:
        while "goal reached" not in guidance.text:
            if time.monotonic() > limit:
                raise KeyboardInterrupt
            message = guidance.listen()
            if message and message.get_type() == "NAMED_VALUE_FLOAT":
                guidance.show()
    except KeyboardInterrupt:
        guidance.engage(on=False)
        raise SystemExit("\nnot there; the vehicle hovers") from None
    north, east, down = guidance.position
    print(f"\narrived: {north:.1f} m north, {east:.1f} m east, {-down:.1f} m high")
    if args.land:
        guidance.land()
        guidance.wait("landed", lambda: not guidance.armed, 60)
        print("landed and disarmed")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--connection", default="udpin:127.0.0.1:14540", help="where the vehicle is (default %(default)s)")
    parser.add_argument("--north", type=float, required=True, help="metres north of home")
    parser.add_argument("--east", type=float, required=True, help="metres east of home")
    parser.add_argument("--height", type=float, default=2.5, help="metres above home (default %(default)s)")
    parser.add_argument("--land", action="store_true", help="land at the goal")
    parser.add_argument("--limit", type=float, default=120.0, help="seconds to get there (default %(default)s)")
    main(parser.parse_args())
