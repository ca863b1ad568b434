"""Flies missions, a geofence, rally points and an orbit with pymavlink, by the messages of the protocol."""

import asyncio
import queue

from pymavlink import mavutil

import client_pymavlink
import ground_plans
import plan
from ground_plans import FENCE, HOME, globe

mavlink = mavutil.mavlink
client_pymavlink.MODES[(4, 4)] = "mission"
ANSWERS = {"MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_ACK"}
FIELDS = "seq frame command current autocontinue param1 param2 param3 param4 x y z mission_type".split()


class Planner(client_pymavlink.Vehicle):
    has_simple_missions = False

    def __init__(self, instance):
        super().__init__(instance)
        self.answers = queue.SimpleQueue()

    def _take(self, m):
        if m.get_type() in ANSWERS:
            self.answers.put(m)
        super()._take(m)

    async def answer(self):
        try:
            return await asyncio.to_thread(self.answers.get, timeout=3.0)
        except queue.Empty:
            raise plan.Failed("the vehicle does not answer") from None

    async def set_return_height(self, height_m):
        self.connection.mav.param_set_send(
            self.system, 1, b"RTL_RETURN_ALT", height_m, mavlink.MAV_PARAM_TYPE_REAL32
        )

    async def upload(self, kind, items):
        mav = self.connection.mav
        mav.mission_count_send(self.system, 1, len(items), kind)
        while True:
            asked = await self.answer()
            if asked.get_type() == "MISSION_ACK":
                if asked.type != mavlink.MAV_MISSION_ACCEPTED:
                    raise ValueError(mavlink.enums["MAV_MISSION_RESULT"][asked.type].name)
                return
            fields = items[asked.seq]
            where = (fields["x"], fields["y"], fields["z"])
            params = [fields[f"param{n}"] for n in (1, 2, 3, 4)]
            head = (asked.seq, fields["frame"], fields["command"], fields["current"], fields["autocontinue"])
            mav.mission_item_int_send(self.system, 1, *head, *params, *where, kind)

    async def download(self, kind):
        mav = self.connection.mav
        mav.mission_request_list_send(self.system, 1, kind)
        count = (await self.answer()).count
        items = []
        for seq in range(count):
            mav.mission_request_int_send(self.system, 1, seq, kind)
            m = await self.answer()
            items.append({name: getattr(m, name) for name in FIELDS})
        mav.mission_ack_send(self.system, 1, mavlink.MAV_MISSION_ACCEPTED, kind)
        return items

    async def start(self):
        await self.set_mode(4, 4)

    async def upload_fence(self, inside, pillar):
        place, radius_m = pillar
        corner = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
        around = mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION
        size = (float(len(inside)), 0.0, 0.0, 0.0)
        items = [ground_plans.item(FENCE, corner, vertex, params=size) for vertex in inside]
        items.append(ground_plans.item(FENCE, around, place, params=(radius_m, 0.0, 0.0, 0.0)))
        await self.upload(FENCE, ground_plans.numbered(items))

    async def clear_fence(self):
        self.connection.mav.mission_clear_all_send(self.system, 1, FENCE)
        await self.answer()

    async def command_int(self, number, params, place, height_m):
        lat, lon = globe(*place)
        where = (round(lat * 1e7), round(lon * 1e7), HOME[2] + height_m)

        def send():
            frame = mavlink.MAV_FRAME_GLOBAL
            self.connection.mav.command_int_send(self.system, 1, frame, number, 0, 0, *params, *where)

        await self.command(send, number)

    async def goto(self, place, height_m):
        nan = float("nan")
        await self.command_int(mavlink.MAV_CMD_DO_REPOSITION, (-1.0, 1.0, 0.0, nan), place, height_m)

    async def orbit(self, centre, height_m, radius_m, speed_m_s):
        await self.command_int(mavlink.MAV_CMD_DO_ORBIT, (radius_m, speed_m_s, 0.0, 0.0), centre, height_m)

    async def stop_setpoints(self):
        self.setpoint = None


if __name__ == "__main__":
    ground_plans.main(Planner, __doc__)
