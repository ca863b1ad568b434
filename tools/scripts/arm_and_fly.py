#!/usr/bin/env python3
"""Takes off, flies a square by velocity setpoints and lands (MAVSDK 4).

    vigil sim --course tests/python/open_field.toml &     # a simulated vehicle on open ground
    pip install mavsdk==4.1.0
    tools/scripts/arm_and_fly.py
"""

import argparse
import asyncio

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync, VelocityBodyYawspeed
from mavsdk.asyncio.plugins.telemetry import LandedState, TelemetryAsync


async def wait_for(stream, wanted, limit_s=60.0):
    """The first value of a telemetry stream that is as wanted."""

    async def wait():
        async for value in stream:
            if wanted(value):
                return value

    return await asyncio.wait_for(wait(), limit_s)


async def main(args):
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    await mavsdk.add_any_connection(args.connection)
    system = await mavsdk.first_autopilot(timeout_s=10.0)
    if system is None:
        raise SystemExit(f"no vehicle at {args.connection}: is `vigil sim` running?")
    action, offboard, telemetry = ActionAsync(system), OffboardAsync(system), TelemetryAsync(system)

    print("waiting until the vehicle is ready")
    await wait_for(telemetry.subscribe_health_all_ok(), bool)
    await action.set_takeoff_altitude(args.height)
    await action.arm()
    print(f"taking off to {args.height} m")
    await action.takeoff()
    await wait_for(telemetry.subscribe_position(), lambda p: p.relative_altitude_m > args.height - 0.3)

    # OFFBOARD is refused unless setpoints come already; MAVSDK repeats the last one 20 times per second.
    await offboard.set_velocity_body(VelocityBodyYawspeed(0.0, 0.0, 0.0, 0.0))
    await offboard.start()
    for side in range(1, 5):
        print(f"side {side}: {args.side} m forward, then a quarter turn")
        await offboard.set_velocity_body(VelocityBodyYawspeed(args.speed, 0.0, 0.0, 0.0))
        await asyncio.sleep(args.side / args.speed)
        await offboard.set_velocity_body(VelocityBodyYawspeed(0.0, 0.0, 0.0, 45.0))
        await asyncio.sleep(2.0)
    await offboard.stop()

    print("landing")
    await action.land()
    await wait_for(telemetry.subscribe_landed_state(), lambda state: state == LandedState.ON_GROUND)
    await wait_for(telemetry.subscribe_armed(), lambda armed: not armed)
    print("landed and disarmed")
    mavsdk.destroy()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--connection", default="udpin://127.0.0.1:14540", help="where the vehicle is (default %(default)s)")
    parser.add_argument("--height", type=float, default=3.0, help="metres above the ground (default %(default)s)")
    parser.add_argument("--side", type=float, default=5.0, help="metres of the square's side (default %(default)s)")
    parser.add_argument("--speed", type=float, default=1.5, help="metres per second (default %(default)s)")
    asyncio.run(main(parser.parse_args()))
