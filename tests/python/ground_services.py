"""Uses the vehicle's files, logs, events, metadata, shell and telemetry rates with MAVSDK-Python, version 3 or 4."""

import argparse
import asyncio
import json
import os
import tempfile
from pathlib import Path

from mavsdk_system import VERSION, MavsdkSystem, types

SIZE = 50_000
COMPANION = 191
# Telemetry for which PX4's simulation and this vehicle have nothing to tell, or must not (the truth).
SILENT = {"actuator_control_target", "distance_sensor", "ground_truth", "status_text", "wind", "transponder"}


async def collect(stream):
    """Everything that a finite stream gives."""
    return [item async for item in stream]


async def first(stream, limit_s=8.0):
    """The first thing that a stream gives."""

    async def wait():
        async for item in stream:
            return item

    return await asyncio.wait_for(wait(), limit_s)


async def refused(call):
    """The name of the error that a call must end with."""
    try:
        await call
    except Exception as error:  # each plugin has an error class of its own
        return str(error)
    raise AssertionError("not refused")


async def files(ftp):
    """Uploads, compares, fetches in both ways, renames and removes a file."""
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        local = folder / "data.bin"
        local.write_bytes(os.urandom(SIZE))
        await ftp.create_directory("/mine")
        await collect(ftp.upload(str(local), "/mine"))
        identical = await ftp.are_files_identical(str(local), "/mine/data.bin")
        same = []
        for burst in (False, True):
            into = folder / str(burst)
            into.mkdir()
            await collect(ftp.download("/mine/data.bin", str(into), burst))
            same.append((into / "data.bin").read_bytes() == local.read_bytes())
        await ftp.rename("/mine/data.bin", "/mine/other.bin")
        await ftp.remove_file("/mine/other.bin")
        await ftp.remove_directory("/mine")
        missing = await refused(ftp.remove_directory("/mine"))
        protected = await refused(ftp.remove_file("/etc/extras/parameters.json"))
    return {"identical": identical, "same": same, "missing": missing, "protected": protected}


async def logs(log_files):
    """Downloads the newest log and erases all."""
    entries = await log_files.get_entries()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.ulg"
        await collect(log_files.download_log_file(entries[-1], str(path)))
        log = path.read_bytes()
    await log_files.erase_all_log_files()
    gone = await refused(log_files.get_entries())
    return {"magic": log[:7].hex(), "bytes": len(log), "told": entries[-1].size_bytes, "erased": gone}


async def flight_with_events(action, stream):
    """Takes off and lands; the messages of the events that came."""
    seen = []

    async def follow():
        async for event in stream:
            seen.append(event.message)

    task = asyncio.create_task(follow())
    await asyncio.sleep(3.0)
    await action.arm()
    await asyncio.sleep(0.5)
    await action.takeoff()
    await asyncio.sleep(6.0)
    await action.land()
    for _ in range(200):
        await asyncio.sleep(0.1)
        if "Disarmed" in seen:
            break
    task.cancel()
    return seen


async def rates(telemetry):
    """Sets every rate there is; the names of those refused."""
    names = [name for name in dir(telemetry) if name.startswith("set_rate_")]
    denied = []
    for name in names:
        try:
            await getattr(telemetry, name)(5.0)
        except Exception as error:
            denied.append(f"{name}: {error}")
    return {"count": len(names), "denied": denied}


async def silent_telemetry(streams):
    """The names of the streams that gave nothing, except those that have nothing to give."""
    silent = []
    for name, stream in streams.items():
        if name not in SILENT:
            try:
                await first(stream())
            except asyncio.TimeoutError:
                silent.append(name)
    return silent


async def shell(system):
    """What the shell answers to `ver`."""
    answer = asyncio.create_task(first(system.function("shell.receive")()))
    await asyncio.sleep(0.5)
    if VERSION == 4:
        await system.shell.send("ver", types("shell").Device.SHELL)
        return (await answer).data
    await system.shell.send("ver")
    return await answer


async def listed(ftp, folder):
    """The names in a folder."""
    found = await ftp.list_directory(folder)
    return [entry.name for entry in found.entries] if VERSION == 4 else list(found.files)


async def flight_number(system):
    if VERSION == 4:
        return (await first(system.function("info.flight_information")())).flight_uid
    return (await system.info.get_flight_information()).flight_uid


async def run(instance):
    system = MavsdkSystem(instance)
    await system.connect()
    report = {"files": await files(system.ftp), "entries": await listed(system.ftp, "/etc/extras")}
    report["events"] = await flight_with_events(system.action, system.function("events.events")())
    checks = await system.events.get_health_and_arming_checks_report()
    report["can_arm"] = checks.current_mode_intention.can_arm_or_run
    report["logs"] = await logs(system.log_files)
    # The vehicle's and the guidance computer's.
    await system.component_metadata.request_autopilot_component()
    await system.component_metadata.request_component(COMPANION)
    await asyncio.sleep(3.0)
    kind = types("component_metadata").MetadataType.PARAMETER
    described = [await system.component_metadata.get_metadata(component, kind) for component in (1, COMPANION)]
    report["metadata"] = [data.json_metadata for data in described]
    report["shell"] = await shell(system)
    report["rates"] = await rates(system.telemetry)
    report["silent"] = await silent_telemetry({name: system.function(f"telemetry.{name}") for name in system.streams("telemetry")})
    report["flight"] = await flight_number(system)
    system.end()
    return report


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--instance", type=int, default=0, help="number of the simulator (default 0)")
    args = parser.parse_args()
    print(json.dumps(asyncio.run(run(args.instance))), flush=True)
    # MAVSDK's threads may outlive the loop.
    os._exit(0)
