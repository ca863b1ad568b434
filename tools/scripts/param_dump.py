#!/usr/bin/env python3
"""Prints or saves all parameters of the vehicle and of its guidance computer (pymavlink).

    tools/scripts/param_dump.py                       # the vehicle's
    tools/scripts/param_dump.py --component 191       # the guidance computer's
    tools/scripts/param_dump.py > my.params           # a file that QGroundControl loads
"""

import argparse
import os
import struct
import time

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil  # noqa: E402  (reads MAVLINK20 when it is imported)

mavlink = mavutil.mavlink


def value_of(message):
    """A parameter's value: integers travel as the bytes of a float."""
    if message.param_type == mavlink.MAV_PARAM_TYPE_INT32:
        return struct.unpack("<i", struct.pack("<f", message.param_value))[0]
    return message.param_value


def all_parameters(link, system, component):
    """Every parameter by its index; what was lost on the way is asked for again."""
    link.mav.param_request_list_send(system, component)
    found, count, heard = {}, None, time.monotonic()
    while count is None or len(found) < count:
        message = link.recv_match(type="PARAM_VALUE", blocking=True, timeout=0.5)
        if message and (message.get_srcSystem(), message.get_srcComponent()) == (system, component):
            # A parameter that somebody sets meanwhile comes without its index.
            if message.param_index < message.param_count:
                found[message.param_index] = message
            count, heard = message.param_count, time.monotonic()
        elif time.monotonic() - heard > 10.0:
            raise SystemExit(f"component {component} does not answer; has {len(found)} of {count or 'its'} parameters")
        elif message is None and count is None:
            link.mav.param_request_list_send(system, component)
        elif message is None:
            for index in set(range(count)) - set(found):
                link.mav.param_request_read_send(system, component, b"", index)
    return [found[index] for index in sorted(found)]


def main(args):
    link = mavutil.mavlink_connection(args.connection, source_system=255)
    heartbeat = link.wait_heartbeat(timeout=10)
    if heartbeat is None:
        raise SystemExit(f"no vehicle at {args.connection}: is `vigil sim` running?")
    system = heartbeat.get_srcSystem()
    print("# Vehicle-Id Component-Id Name Value Type")
    for m in all_parameters(link, system, args.component):
        value = value_of(m)
        text = value if isinstance(value, int) else f"{value:.9g}"
        print(system, args.component, m.param_id, text, m.param_type, sep="\t")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--connection", default="udpin:127.0.0.1:14540", help="where the vehicle is (default %(default)s)")
    parser.add_argument("--component", type=int, default=1, help="1 the vehicle, 191 guidance (default %(default)s)")
    main(parser.parse_args())
