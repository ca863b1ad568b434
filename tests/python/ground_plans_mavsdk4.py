"""Flies missions, a geofence, rally points and an orbit with MAVSDK-Python 4."""

from mavsdk.asyncio.plugins.action import ActionAsync, OrbitYawBehavior
from mavsdk.asyncio.plugins.geofence import Circle, FenceType, GeofenceAsync, GeofenceData, Point, Polygon
from mavsdk.asyncio.plugins.mission import MissionAsync, MissionItem, MissionPlan
from mavsdk.asyncio.plugins.mission_raw import MissionItem as RawItem
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.telemetry import FlightMode

import client_mavsdk4
import ground_plans
from ground_plans import FENCE, HOME, MISSION, RALLY, globe

client_mavsdk4.MODES[FlightMode.MISSION] = "mission"
FIELDS = "seq frame command current autocontinue param1 param2 param3 param4 x y z mission_type".split()


class Planner(client_mavsdk4.Vehicle):
    has_simple_missions = True

    async def connect(self):
        await super().connect()
        system = await self.mavsdk.first_autopilot(timeout_s=5.0)
        self.simple, self.raw, self.fence = MissionAsync(system), MissionRawAsync(system), GeofenceAsync(system)
        self.progress = []
        self.keep(self.simple.subscribe_mission_progress(), lambda p: self.progress.append((p.current, p.total)))

    async def set_return_height(self, height_m):
        await self.action.set_return_to_launch_altitude(height_m)

    async def set_return_after_mission(self, enable):
        await self.simple.set_return_to_launch_after_mission(enable)

    async def upload_simple(self, items):
        await self.simple.upload_mission(MissionPlan([MissionItem(**fields) for fields in items]))

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
        items = [RawItem(**fields) for fields in items]
        calls = {
            MISSION: self.raw.upload_mission,
            FENCE: self.raw.upload_geofence,
            RALLY: self.raw.upload_rally_points,
        }
        await calls[kind](items)

    async def download(self, kind):
        calls = {
            MISSION: self.raw.download_mission,
            FENCE: self.raw.download_geofence,
            RALLY: self.raw.download_rallypoints,
        }
        return [{name: getattr(item, name) for name in FIELDS} for item in await calls[kind]()]

    async def start(self):
        await self.raw.start_mission()

    async def upload_fence(self, inside, pillar):
        place, radius_m = pillar
        polygon = Polygon([Point(*globe(*corner)) for corner in inside], FenceType.INCLUSION)
        circle = Circle(Point(*globe(*place)), radius_m, FenceType.EXCLUSION)
        await self.fence.upload_geofence(GeofenceData([polygon], [circle]))

    async def clear_fence(self):
        await self.fence.clear_geofence()

    async def goto(self, place, height_m):
        await self.action.goto_location(*globe(*place), HOME[2] + height_m, float("nan"))

    async def orbit(self, centre, height_m, radius_m, speed_m_s):
        facing = OrbitYawBehavior.HOLD_FRONT_TO_CIRCLE_CENTER
        await self.action.do_orbit(radius_m, speed_m_s, facing, *globe(*centre), HOME[2] + height_m)

    async def stop_setpoints(self):
        """MAVSDK ends its stream by itself when the vehicle leaves OFFBOARD."""


if __name__ == "__main__":
    ground_plans.main(Planner, __doc__)
