"""Flies missions, a geofence, rally points and an orbit with MAVSDK-Python, version 3 or 4."""

import client_mavsdk
import ground_plans
from ground_plans import FENCE, HOME, MISSION, RALLY, globe
from mavsdk_system import types

MissionItem, RawItem = types("mission").MissionItem, types("mission_raw").MissionItem
FIELDS = "seq frame command current autocontinue param1 param2 param3 param4 x y z mission_type".split()
NOTHING = {"camera_action": MissionItem.CameraAction.NONE, "vehicle_action": MissionItem.VehicleAction.NONE}


class Planner(client_mavsdk.Vehicle):
    has_simple_missions = True

    async def connect(self):
        await super().connect()
        self.simple, self.raw = self.system.mission, self.system.mission_raw
        self.progress = []
        self.system.keep("mission.mission_progress", lambda p: self.progress.append((p.current, p.total)))

    async def set_return_height(self, height_m):
        await self.system.action.set_return_to_launch_altitude(height_m)

    async def set_return_after_mission(self, enable):
        await self.simple.set_return_to_launch_after_mission(enable)

    async def upload_simple(self, items):
        items = [MissionItem(**NOTHING, **fields) for fields in items]
        await self.simple.upload_mission(types("mission").MissionPlan(items))

    async def download_simple(self):
        return [vars(item) for item in (await self.simple.download_mission()).mission_items]

    async def start_simple(self):
        await self.simple.start_mission()

    async def pause_simple(self):
        await self.simple.pause_mission()

    async def is_finished_simple(self):
        return await self.simple.is_mission_finished()

    async def choose_simple(self, index):
        await self.simple.set_current_mission_item(index)

    async def clear_simple(self):
        await self.simple.clear_mission()

    async def upload(self, kind, items):
        raw = self.raw
        calls = {MISSION: raw.upload_mission, FENCE: raw.upload_geofence, RALLY: raw.upload_rally_points}
        await calls[kind]([RawItem(**fields) for fields in items])

    async def download(self, kind):
        raw = self.raw
        calls = {MISSION: raw.download_mission, FENCE: raw.download_geofence, RALLY: raw.download_rallypoints}
        return [{name: getattr(item, name) for name in FIELDS} for item in await calls[kind]()]

    async def start(self):
        await self.raw.start_mission()

    async def upload_fence(self, inside, pillar):
        fence = types("geofence")
        place, radius_m = pillar
        polygon = fence.Polygon([fence.Point(*globe(*corner)) for corner in inside], fence.FenceType.INCLUSION)
        circle = fence.Circle(fence.Point(*globe(*place)), radius_m, fence.FenceType.EXCLUSION)
        await self.system.geofence.upload_geofence(fence.GeofenceData([polygon], [circle]))

    async def clear_fence(self):
        await self.system.geofence.clear_geofence()

    async def goto(self, place, height_m):
        await self.system.action.goto_location(*globe(*place), HOME[2] + height_m, float("nan"))

    async def orbit(self, centre, height_m, radius_m, speed_m_s):
        facing = types("action").OrbitYawBehavior.HOLD_FRONT_TO_CIRCLE_CENTER
        await self.system.action.do_orbit(radius_m, speed_m_s, facing, *globe(*centre), HOME[2] + height_m)

    async def stop_setpoints(self):
        """MAVSDK ends its stream by itself when the vehicle leaves OFFBOARD."""


if __name__ == "__main__":
    ground_plans.main(Planner, __doc__)
