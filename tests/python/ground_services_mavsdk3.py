"""Uses the vehicle's services with MAVSDK-Python 3."""

import asyncio

from mavsdk import System
from mavsdk.component_metadata import MetadataType

import ground_services as services
from client_mavsdk3 import free_port


async def shell(plugin):
    answer = asyncio.create_task(services.first(plugin.receive()))
    await asyncio.sleep(0.5)
    await plugin.send("ver")
    return await answer


async def run(instance):
    drone = System(port=free_port())
    await drone.connect(system_address=f"udpin://127.0.0.1:{14540 + instance}")
    async for state in drone.core.connection_state():
        if state.is_connected:
            break
    listed = {"files": await services.files(drone.ftp, drone.ftp.download)}
    report = {**listed, "entries": list((await drone.ftp.list_directory("/etc/extras")).files)}
    report["events"] = await services.flight_with_events(drone.action, drone.events.events())
    report["can_arm"] = (await drone.events.get_health_and_arming_checks_report()).current_mode_intention.can_arm_or_run
    report["logs"] = await services.logs(drone.log_files)
    await drone.component_metadata.request_autopilot_component()
    await asyncio.sleep(1.0)
    report["metadata"] = (await drone.component_metadata.get_metadata(1, MetadataType.PARAMETER)).json_metadata
    report["shell"] = await shell(drone.shell)
    report["rates"] = await services.rates(drone.telemetry)
    names = [n for n in dir(drone.telemetry) if not n.startswith(("_", "set_", "get_")) and n != "name"]
    report["silent"] = await services.silent_telemetry({n: getattr(drone.telemetry, n) for n in names})
    report["flight"] = (await drone.info.get_flight_information()).flight_uid
    return report


if __name__ == "__main__":
    services.main(run, __doc__)
