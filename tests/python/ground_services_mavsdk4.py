"""Uses the vehicle's services with MAVSDK-Python 4."""

import asyncio

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.component_metadata import ComponentMetadataAsync, MetadataType
from mavsdk.asyncio.plugins.events import EventsAsync
from mavsdk.asyncio.plugins.ftp import FtpAsync
from mavsdk.asyncio.plugins.info import InfoAsync
from mavsdk.asyncio.plugins.log_files import LogFilesAsync
from mavsdk.asyncio.plugins.shell import ShellAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.shell import Device

import ground_services as services


async def shell(plugin):
    stream = plugin.subscribe_receive()
    answer = asyncio.create_task(services.first(stream))
    await asyncio.sleep(0.5)
    await plugin.send("ver", Device.SHELL)
    return (await answer).data


async def run(instance):
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    await mavsdk.add_any_connection(f"udpin://127.0.0.1:{14540 + instance}")
    system = await mavsdk.first_autopilot(timeout_s=10.0)
    events, metadata, telemetry = EventsAsync(system), ComponentMetadataAsync(system), TelemetryAsync(system)
    ftp, prefix = FtpAsync(system), "subscribe_"
    report = {"files": await services.files(ftp, ftp.download)}
    report["entries"] = [entry.name for entry in (await ftp.list_directory("/etc/extras")).entries]
    report["events"] = await services.flight_with_events(ActionAsync(system), events.subscribe_events())
    report["can_arm"] = (await events.get_health_and_arming_checks_report()).current_mode_intention.can_arm_or_run
    report["logs"] = await services.logs(LogFilesAsync(system))
    await metadata.request_autopilot_component()
    await asyncio.sleep(1.0)
    report["metadata"] = (await metadata.get_metadata(1, MetadataType.PARAMETER)).json_metadata
    report["shell"] = await shell(ShellAsync(system))
    report["rates"] = await services.rates(telemetry)
    streams = {name[len(prefix) :]: getattr(telemetry, name) for name in dir(telemetry) if name.startswith(prefix)}
    report["silent"] = await services.silent_telemetry(streams)
    report["flight"] = (await services.first(InfoAsync(system).subscribe_flight_information())).flight_uid
    return report


if __name__ == "__main__":
    services.main(run, __doc__)
