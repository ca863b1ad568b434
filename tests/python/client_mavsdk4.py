"""Flies Vigil's vehicle with MAVSDK-Python 4."""

import asyncio
import json

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync, MavlinkMessage
from mavsdk.asyncio.plugins.offboard import OffboardAsync, VelocityBodyYawspeed, VelocityNedYaw
from mavsdk.asyncio.plugins.telemetry import FlightMode, LandedState, TelemetryAsync

import plan

MODES = {
    FlightMode.TAKEOFF: "takeoff",
    FlightMode.HOLD: "hold",
    FlightMode.RETURN_TO_LAUNCH: "return",
    FlightMode.LAND: "land",
    FlightMode.OFFBOARD: "offboard",
}
COMPANION = 191


class Vehicle:
    """The plugins of one system, with the newest telemetry kept by tasks."""

    def __init__(self, instance):
        self.url = f"udpin://127.0.0.1:{14540 + instance}"
        self.mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        self.position = self.velocity = self.heading_deg = None
        self.armed = self.in_air = self.ready = False
        self.mode = None
        self.named_values, self.texts, self.tasks = {}, [], []

    async def connect(self):
        await self.mavsdk.add_any_connection(self.url)
        system = await self.mavsdk.first_autopilot(timeout_s=10.0)
        plan.expect(system, "no autopilot found")
        self.system_id = await system.get_system_id()
        self.action, self.offboard = ActionAsync(system), OffboardAsync(system)
        self.telemetry, self.direct = TelemetryAsync(system), MavlinkDirectAsync(system)
        t = self.telemetry
        self.keep(t.subscribe_position_velocity_ned(), self._position)
        self.keep(t.subscribe_attitude_euler(), lambda a: setattr(self, "heading_deg", a.yaw_deg % 360.0))
        self.keep(t.subscribe_armed(), lambda armed: setattr(self, "armed", armed))
        self.keep(t.subscribe_landed_state(), lambda s: setattr(self, "in_air", s != LandedState.ON_GROUND))
        self.keep(t.subscribe_flight_mode(), lambda mode: setattr(self, "mode", MODES.get(mode)))
        self.keep(t.subscribe_health_all_ok(), lambda ok: setattr(self, "ready", ok))
        self.keep(t.subscribe_status_text(), lambda s: self.texts.append(s.text))
        self.keep(self.direct.subscribe_message("NAMED_VALUE_FLOAT"), self._named_value)

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

    async def wait_ready(self):
        await plan.until("health_all_ok", lambda: self.ready, 15.0)

    async def set_takeoff_height(self, height_m):
        await self.action.set_takeoff_altitude(height_m)

    async def arm(self):
        await self.action.arm()

    async def take_off(self):
        await self.action.takeoff()

    async def land(self):
        await self.action.land()

    async def start_offboard(self):
        await self.velocity_body(0.0, 0.0, 0.0, 0.0)
        await self.offboard.start()

    async def stop_offboard(self):
        await self.offboard.stop()

    async def velocity_body(self, forward, right, down, yaw_rate_deg_s):
        await self.offboard.set_velocity_body(VelocityBodyYawspeed(forward, right, down, yaw_rate_deg_s))

    async def velocity_ned(self, north, east, down, heading_deg):
        await self.offboard.set_velocity_ned(VelocityNedYaw(north, east, down, heading_deg))

    async def command_companion(self, name, fields):
        fields = {"target_system": self.system_id, "target_component": COMPANION, **fields}
        message = MavlinkMessage(name, 0, 0, self.system_id, COMPANION, json.dumps(fields))
        ack = await self.direct.send_command(message)
        result = json.loads(ack.fields_json)["result"]
        plan.expect(result == 0, f"{name} {fields['command']} got result {result}")

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
        self.mavsdk.destroy()


if __name__ == "__main__":
    plan.main(Vehicle, __doc__)
