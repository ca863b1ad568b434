#!/usr/bin/env python3
"""Lists the vehicle's flight logs, or downloads the newest of them (MAVSDK 4).

    tools/scripts/log_download.py --list
    tools/scripts/log_download.py flight.ulg
"""

import argparse
import asyncio

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.log_files import LogFilesAsync


async def main(args):
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    await mavsdk.add_any_connection(args.connection)
    system = await mavsdk.first_autopilot(timeout_s=10.0)
    if system is None:
        raise SystemExit(f"no vehicle at {args.connection}: is `vigil sim` running?")
    log_files = LogFilesAsync(system)
    try:
        entries = await log_files.get_entries()
    except Exception as error:
        raise SystemExit(f"no log: {error}; the vehicle writes one from arming to disarming") from None
    if args.list:
        for entry in entries:
            print(f"{entry.id:5}  {entry.date}  {entry.size_bytes:9} bytes")
    else:
        async for _, data in log_files.download_log_file(entries[-1], args.file):
            print(f"\r{data.progress:4.0%}", end="", flush=True)
        print(f"\r{args.file}: {entries[-1].size_bytes} bytes")
    mavsdk.destroy()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", nargs="?", help="where to write the log; it must not exist")
    parser.add_argument("--list", action="store_true", help="list the logs")
    parser.add_argument("--connection", default="udpin://127.0.0.1:14540", help="where the vehicle is (default %(default)s)")
    arguments = parser.parse_args()
    if not arguments.list and not arguments.file:
        parser.error("give a file to write, or --list")
    asyncio.run(main(arguments))
