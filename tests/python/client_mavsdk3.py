"""Flies Vigil's vehicle with MAVSDK-Python 3, as most scripts in the wild do."""

import asyncio
import gc
import json
import socket

from mavsdk import System
from mavsdk.mavlink_direct import MavlinkMessage
from mavsdk.offboard import VelocityBodyYawspeed, VelocityNedYaw
from mavsdk.telemetry import FlightMode, LandedState

import plan

MODES = {
    FlightMode.TAKEOFF: "takeoff",
    FlightMode.HOLD: "hold",
    FlightMode.RETURN_TO_LAUNCH: "return",
    FlightMode.LAND: "land",
    FlightMode.OFFBOARD: "offboard",
}
COMPANION = 191


def free_port():
    """A port for the server that MAVSDK 3 starts: its default would clash with a second script."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Vehicle:
    """One `System`, with the newest telemetry kept by tasks."""

    def __init__(self, instance):
        self.url = f"udpin://127.0.0.1:{14540 + instance}"
        self.drone = System(port=free_port())
        self.position = self.velocity = self.heading_deg = None
        self.armed = self.in_air = self.ready = False
        self.mode = None
        self.named_values, self.texts, self.tasks, self.acks = {}, [], [], []

    async def connect(self):
        await self.drone.connect(system_address=self.url)

        async def connected():
            async for state in self.drone.core.connection_state():
                if state.is_connected:
                    return

        await asyncio.wait_for(connected(), 15.0)
        t, direct = self.drone.telemetry, self.drone.mavlink_direct
        self.keep(t.position_velocity_ned(), self._position)
        self.keep(t.attitude_euler(), lambda a: setattr(self, "heading_deg", a.yaw_deg % 360.0))
        self.keep(t.armed(), lambda armed: setattr(self, "armed", armed))
        self.keep(t.landed_state(), lambda s: setattr(self, "in_air", s != LandedState.ON_GROUND))
        self.keep(t.flight_mode(), lambda mode: setattr(self, "mode", MODES.get(mode)))
        self.keep(t.health_all_ok(), lambda ok: setattr(self, "ready", ok))
        self.keep(t.status_text(), lambda s: self.texts.append(s.text))
        self.keep(direct.message("NAMED_VALUE_FLOAT"), self._named_value)
        self.keep(direct.message("COMMAND_ACK"), self._ack)
        self.keep(direct.message("HEARTBEAT"), self._heartbeat)

    def keep(self, stream, take):
        async def follow():
            async for value in stream:
                take(value)

        self.tasks.append(asyncio.create_task(follow()))

    def _position(self, p):
        self.position = (p.position.north_m, p.position.east_m, p.position.down_m)
        self.velocity = (p.velocity.north_m_s, p.velocity.east_m_s, p.velocity.down_m_s)

    def _named_value(self, message):
        fields = json.loads(message.fields_json)
        self.named_values[fields["name"]] = fields["value"]

    def _ack(self, message):
        self.acks.append((message.component_id, json.loads(message.fields_json)))

    def _heartbeat(self, message):
        if message.component_id == 1:
            self.system_id = message.system_id

    async def wait_ready(self):
        await plan.until("health_all_ok", lambda: self.ready, 15.0)

    async def set_takeoff_height(self, height_m):
        await self.drone.action.set_takeoff_altitude(height_m)

    async def arm(self):
        await self.drone.action.arm()

    async def take_off(self):
        await self.drone.action.takeoff()

    async def land(self):
        await self.drone.action.land()

    async def start_offboard(self):
        await self.velocity_body(0.0, 0.0, 0.0, 0.0)
        await self.drone.offboard.start()

    async def stop_offboard(self):
        await self.drone.offboard.stop()

    async def velocity_body(self, forward, right, down, yaw_rate_deg_s):
        await self.drone.offboard.set_velocity_body(VelocityBodyYawspeed(forward, right, down, yaw_rate_deg_s))

    async def velocity_ned(self, north, east, down, heading_deg):
        await self.drone.offboard.set_velocity_ned(VelocityNedYaw(north, east, down, heading_deg))

    async def command_companion(self, name, fields):
        """MAVSDK 3 sends any message, but waits for no acknowledgement: repeat and look for it."""
        fields = {"target_system": self.system_id, "target_component": COMPANION, **fields}
        message = MavlinkMessage(name, 0, 0, self.system_id, COMPANION, json.dumps(fields))
        for _ in range(4):
            self.acks.clear()
            await self.drone.mavlink_direct.send_message(message)
            for _ in range(50):
                for component, ack in self.acks:
                    if (component, ack["command"]) == (COMPANION, fields["command"]):
                        plan.expect(ack["result"] == 0, f"{name} {ack['command']} got result {ack['result']}")
                        return
                await asyncio.sleep(0.01)
        raise plan.Failed(f"{name} {fields['command']} was not acknowledged")

    async def set_goal(self, north, east, height_m):
        fields = {"command": 192, "frame": 1, "param1": -1.0, "param2": 0.0, "param3": 0.0, "param4": 0.0}
        place = {"x": round(north * 1e4), "y": round(east * 1e4), "z": -height_m}
        await self.command_companion("COMMAND_INT", {**fields, **place, "current": 0, "autocontinue": 0})

    async def engage(self, on=1.0):
        params = {f"param{n}": 0.0 for n in range(2, 8)}
        await self.command_companion("COMMAND_LONG", {"command": 92, "param1": on, **params, "confirmation": 0})

    async def disengage(self):
        await self.engage(0.0)

    async def close(self):
        for task in self.tasks:
            task.cancel()
        await asyncio.gather(*self.tasks, return_exceptions=True)
        # The server that MAVSDK 3 started ends with the last reference to its System, and without that the script does
        # not end.
        self.tasks.clear()
        self.drone = None
        gc.collect()


if __name__ == "__main__":
    plan.main(Vehicle, __doc__)
