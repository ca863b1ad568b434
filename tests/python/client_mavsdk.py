"""Flies Vigil's vehicle with MAVSDK-Python, version 3 or 4, as most scripts in the wild do."""

import json

import plan
from mavsdk_system import MavsdkSystem, types

FlightMode, LandedState = types("telemetry").FlightMode, types("telemetry").LandedState
VelocityBodyYawspeed, VelocityNedYaw = types("offboard").VelocityBodyYawspeed, types("offboard").VelocityNedYaw
MODES = {
    FlightMode.TAKEOFF: "takeoff",
    FlightMode.HOLD: "hold",
    FlightMode.MISSION: "mission",
    FlightMode.RETURN_TO_LAUNCH: "return",
    FlightMode.LAND: "land",
    FlightMode.OFFBOARD: "offboard",
}
COMPANION = 191


class Vehicle:
    """One system, with the newest telemetry kept."""

    def __init__(self, instance):
        self.system = MavsdkSystem(instance)
        self.position = self.velocity = self.heading_deg = None
        self.armed = self.in_air = self.ready = False
        self.mode = None
        self.named_values, self.texts = {}, []

    async def connect(self):
        await self.system.connect()
        newest = {
            "position_velocity_ned": self._position,
            "attitude_euler": lambda a: setattr(self, "heading_deg", a.yaw_deg % 360.0),
            "armed": lambda armed: setattr(self, "armed", armed),
            "landed_state": lambda s: setattr(self, "in_air", s != LandedState.ON_GROUND),
            "flight_mode": lambda mode: setattr(self, "mode", MODES.get(mode)),
            "health_all_ok": lambda ok: setattr(self, "ready", ok),
            "status_text": lambda s: self.texts.append(s.text),
        }
        for name, take in newest.items():
            self.system.keep(f"telemetry.{name}", take)
        self.system.keep("mavlink_direct.message", self._named_value, "NAMED_VALUE_FLOAT")

    def _position(self, p):
        self.position = (p.position.north_m, p.position.east_m, p.position.down_m)
        self.velocity = (p.velocity.north_m_s, p.velocity.east_m_s, p.velocity.down_m_s)

    def _named_value(self, message):
        fields = json.loads(message.fields_json)
        self.named_values[fields["name"]] = fields["value"]

    async def wait_ready(self):
        # Until the autopilot's own heartbeat, which a companion's may come before, MAVSDK 4.1 keeps a take-off height to itself.
        await plan.until("health_all_ok and a mode", lambda: self.ready and self.mode, 15.0)

    async def set_takeoff_height(self, height_m):
        await self.system.action.set_takeoff_altitude(height_m)

    async def arm(self):
        await self.system.action.arm()

    async def take_off(self):
        await self.system.action.takeoff()

    async def land(self):
        await self.system.action.land()

    async def start_offboard(self):
        await self.velocity_body(0.0, 0.0, 0.0, 0.0)
        await self.system.offboard.start()

    async def stop_offboard(self):
        await self.system.offboard.stop()

    async def velocity_body(self, forward, right, down, yaw_rate_deg_s):
        await self.system.offboard.set_velocity_body(VelocityBodyYawspeed(forward, right, down, yaw_rate_deg_s))

    async def velocity_ned(self, north, east, down, heading_deg):
        await self.system.offboard.set_velocity_ned(VelocityNedYaw(north, east, down, heading_deg))

    async def set_goal(self, north, east, height_m):
        fields = {"command": 192, "frame": 1, "param1": -1.0, "param2": 0.0, "param3": 0.0, "param4": 0.0}
        place = {"x": round(north * 1e4), "y": round(east * 1e4), "z": -height_m}
        await self.system.command(COMPANION, "COMMAND_INT", {**fields, **place, "current": 0, "autocontinue": 0})

    async def engage(self, on=1.0):
        params = {f"param{n}": 0.0 for n in range(2, 8)}
        await self.system.command(COMPANION, "COMMAND_LONG", {"command": 92, "param1": on, **params, "confirmation": 0})

    async def disengage(self):
        await self.engage(0.0)

    async def close(self):
        await self.system.close()


if __name__ == "__main__":
    plan.main(Vehicle, __doc__)
