"""Flies missions, a geofence, rally points and an orbit with MAVSDK-Python 3."""

from mavsdk.action import OrbitYawBehavior
from mavsdk.geofence import Circle, FenceType, GeofenceData, Point, Polygon
from mavsdk.mission import MissionItem, MissionPlan
from mavsdk.mission_raw import MissionItem as RawItem
from mavsdk.telemetry import FlightMode

import client_mavsdk3
import ground_plans
from ground_plans import FENCE, HOME, MISSION, RALLY, globe

client_mavsdk3.MODES[FlightMode.MISSION] = "mission"
FIELDS = "seq frame command current autocontinue param1 param2 param3 param4 x y z mission_type".split()
NOTHING = {"camera_action": MissionItem.CameraAction.NONE, "vehicle_action": MissionItem.VehicleAction.NONE}


class Planner(client_mavsdk3.Vehicle):
    has_simple_missions = True

    async def connect(self):
        await super().connect()
        self.progress = []
        self.keep(self.drone.mission.mission_progress(), lambda p: self.progress.append((p.current, p.total)))

    async def set_return_height(self, height_m):
        await self.drone.action.set_return_to_launch_altitude(height_m)

    async def set_return_after_mission(self, enable):
        await self.drone.mission.set_return_to_launch_after_mission(enable)

    async def upload_simple(self, items):
        await self.drone.mission.upload_mission(MissionPlan([MissionItem(**NOTHING, **fields) for fields in items]))

    async def download_simple(self):
        return [vars(item) for item in (await self.drone.mission.download_mission()).mission_items]

    async def start_simple(self):
        await self.drone.mission.start_mission()

    async def pause_simple(self):
        await self.drone.mission.pause_mission()

    async def is_finished_simple(self):
        return await self.drone.mission.is_mission_finished()

    async def choose_simple(self, index):
        await self.drone.mission.set_current_mission_item(index)

    async def clear_simple(self):
        await self.drone.mission.clear_mission()

    async def upload(self, kind, items):
        raw = self.drone.mission_raw
        calls = {MISSION: raw.upload_mission, FENCE: raw.upload_geofence, RALLY: raw.upload_rally_points}
        await calls[kind]([RawItem(**fields) for fields in items])

    async def download(self, kind):
        raw = self.drone.mission_raw
        calls = {MISSION: raw.download_mission, FENCE: raw.download_geofence, RALLY: raw.download_rallypoints}
        return [{name: getattr(item, name) for name in FIELDS} for item in await calls[kind]()]

    async def start(self):
        await self.drone.mission_raw.start_mission()

    async def upload_fence(self, inside, pillar):
        place, radius_m = pillar
        polygon = Polygon([Point(*globe(*corner)) for corner in inside], FenceType.INCLUSION)
        circle = Circle(Point(*globe(*place)), radius_m, FenceType.EXCLUSION)
        await self.drone.geofence.upload_geofence(GeofenceData([polygon], [circle]))

    async def clear_fence(self):
        await self.drone.geofence.clear_geofence()

    async def goto(self, place, height_m):
        await self.drone.action.goto_location(*globe(*place), HOME[2] + height_m, float("nan"))

    async def orbit(self, centre, height_m, radius_m, speed_m_s):
        facing = OrbitYawBehavior.HOLD_FRONT_TO_CIRCLE_CENTER
        await self.drone.action.do_orbit(radius_m, speed_m_s, facing, *globe(*centre), HOME[2] + height_m)

    async def stop_setpoints(self):
        """MAVSDK ends its stream by itself when the vehicle leaves OFFBOARD."""


if __name__ == "__main__":
    ground_plans.main(Planner, __doc__)
