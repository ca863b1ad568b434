"""Flies Vigil's vehicle with pymavlink."""

import asyncio
import math
import threading
import time

from pymavlink import mavutil

import plan

mavlink = mavutil.mavlink
MODES = {(4, 2): "takeoff", (4, 3): "hold", (4, 5): "return", (4, 6): "land", (6, 0): "offboard"}
COMPANION = 191


class Vehicle:
    """One connection; a thread reads it and streams the setpoint, as such scripts usually do."""

    def __init__(self, instance):
        self.connection = mavutil.mavlink_connection(f"udpin:127.0.0.1:{14540 + instance}", source_system=255)
        self.position = self.velocity = self.heading_deg = None
        self.armed = self.in_air = self.ready = False
        self.mode = None
        self.named_values, self.texts, self.acks = {}, [], []
        self.setpoint = None
        self.running = True
        self.thread = None

    async def connect(self):
        heartbeat = await asyncio.to_thread(self.connection.wait_heartbeat, timeout=10)
        plan.expect(heartbeat is not None, "no heartbeat")
        # The connection's target_system is still unset when this is the guidance computer's heartbeat.
        self.system = heartbeat.get_srcSystem()
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self):
        next_heartbeat = next_setpoint = 0.0
        while self.running:
            now = time.monotonic()
            if now >= next_heartbeat:
                self.connection.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
                next_heartbeat = now + 1.0
            if self.setpoint and now >= next_setpoint:
                self._send_setpoint(*self.setpoint)
                next_setpoint = now + 0.05
            message = self.connection.recv_match(blocking=True, timeout=0.01)
            if message:
                self._take(message)

    def _take(self, m):
        kind, component = m.get_type(), m.get_srcComponent()
        if kind == "NAMED_VALUE_FLOAT":
            self.named_values[m.name] = m.value
        elif kind == "STATUSTEXT":
            self.texts.append(m.text)
        elif kind == "COMMAND_ACK":
            self.acks.append((component, m.command, m.result))
        elif component != mavlink.MAV_COMP_ID_AUTOPILOT1:
            pass
        elif kind == "HEARTBEAT":
            self.armed = bool(m.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            self.mode = MODES.get((m.custom_mode >> 16 & 0xFF, m.custom_mode >> 24))
        elif kind == "EXTENDED_SYS_STATE":
            self.in_air = m.landed_state != mavlink.MAV_LANDED_STATE_ON_GROUND
        elif kind == "SYS_STATUS":
            self.ready = bool(m.onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK)
        elif kind == "LOCAL_POSITION_NED":
            self.position, self.velocity = (m.x, m.y, m.z), (m.vx, m.vy, m.vz)
        elif kind == "ATTITUDE":
            self.heading_deg = math.degrees(m.yaw) % 360.0

    def _send_setpoint(self, frame, mask, velocity, yaw, yaw_rate):
        zeros = (0.0, 0.0, 0.0)
        self.connection.mav.set_position_target_local_ned_send(
            0, self.system, 1, frame, mask, *zeros, *velocity, *zeros, yaw, yaw_rate
        )

    async def command(self, send, number, component=1):
        """Sends until acknowledged; fails unless accepted."""
        for _ in range(4):
            self.acks.clear()
            send()
            deadline = time.monotonic() + 0.5
            while time.monotonic() < deadline:
                for source, command, result in list(self.acks):
                    if (source, command) == (component, number):
                        plan.expect(result == 0, f"command {number} got result {result}")
                        return
                await asyncio.sleep(0.01)
        raise plan.Failed(f"command {number} was not acknowledged")

    async def command_long(self, number, *params, component=1):
        params = [*params, *[math.nan] * (7 - len(params))]
        await self.command(
            lambda: self.connection.mav.command_long_send(self.system, component, number, 0, *params), number, component
        )

    async def set_mode(self, main, sub):
        await self.command_long(mavlink.MAV_CMD_DO_SET_MODE, 129, main, sub)

    async def wait_ready(self):
        await plan.until("ready to arm", lambda: self.ready, 10.0)

    async def set_takeoff_height(self, height_m):
        self.connection.mav.param_set_send(
            self.system, 1, b"MIS_TAKEOFF_ALT", height_m, mavlink.MAV_PARAM_TYPE_REAL32
        )

    async def arm(self):
        await self.command_long(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1, 0)

    async def take_off(self):
        await self.command_long(mavlink.MAV_CMD_NAV_TAKEOFF)

    async def land(self):
        await self.command_long(mavlink.MAV_CMD_NAV_LAND)

    async def start_offboard(self):
        await self.velocity_body(0.0, 0.0, 0.0, 0.0)
        await asyncio.sleep(0.5)
        await self.set_mode(6, 0)

    async def stop_offboard(self):
        await self.set_mode(4, 3)
        self.setpoint = None

    async def velocity_body(self, forward, right, down, yaw_rate_deg_s):
        rate = math.radians(yaw_rate_deg_s)
        self.setpoint = (mavlink.MAV_FRAME_BODY_NED, 0x5C7, (forward, right, down), 0.0, rate)

    async def velocity_ned(self, north, east, down, heading_deg):
        yaw = math.radians(heading_deg)
        self.setpoint = (mavlink.MAV_FRAME_LOCAL_NED, 0x9C7, (north, east, down), yaw, 0.0)

    async def set_goal(self, north, east, height_m):
        number = mavlink.MAV_CMD_DO_REPOSITION
        x, y = round(north * 1e4), round(east * 1e4)
        await self.command(
            lambda: self.connection.mav.command_int_send(
                self.system, COMPANION, mavlink.MAV_FRAME_LOCAL_NED, number, 0, 0, -1, 0, 0, math.nan, x, y, -height_m
            ),
            number,
            COMPANION,
        )

    async def engage(self):
        await self.command_long(mavlink.MAV_CMD_NAV_GUIDED_ENABLE, 1, component=COMPANION)

    async def disengage(self):
        await self.command_long(mavlink.MAV_CMD_NAV_GUIDED_ENABLE, 0, component=COMPANION)

    async def close(self):
        self.running = False
        if self.thread:
            self.thread.join(2.0)
        self.connection.close()


if __name__ == "__main__":
    plan.main(Vehicle, __doc__)
