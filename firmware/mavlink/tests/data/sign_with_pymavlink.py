"""Writes signed_by_pymavlink.txt: packets signed by pymavlink, as an oracle for Vigil's own signing.

Run with pymavlink 2.4.50: python sign_with_pymavlink.py > signed_by_pymavlink.txt
Each line: what it is, link id, timestamp, the packet unsigned, the packet signed (hexadecimal).
"""

import os

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import common as mavlink  # noqa: E402

KEY = bytes(range(32))
OTHER_KEY = bytes(range(1, 33))
START = 37_000_000_000_000


class Sink:
    def write(self, data):
        self.data = bytes(data)


def messages(mav, i):
    yield mav.heartbeat_encode(6, 8, 0, i, 4)
    yield mav.command_long_encode(1, 191, 92, 0, 1.0, i / 7, 0, 0, 0, 0, float("nan"))
    yield mav.statustext_encode(6, f"packet {i}".encode())
    yield mav.param_set_encode(1, 191, b"CRUISE_M_S", 0.5 + i / 100, 9)
    yield mav.command_int_encode(1, 191, 1, 192, 0, 0, -1, 0, 0, 0, 10_000 * i, -5, -2.5)
    # A payload that is all zero is cut to one byte.
    yield mav.manual_control_encode(0, 0, 0, 0, 0, 0)


def lines(what, key, link_id, system, component, timestamp, rounds):
    sink = Sink()
    mav = mavlink.MAVLink(sink, srcSystem=system, srcComponent=component)
    for i in range(rounds):
        for message in messages(mav, i):
            mav.signing.sign_outgoing = False
            sequence = mav.seq
            unsigned = bytes(message.pack(mav))
            mav.seq = sequence
            mav.signing.secret_key, mav.signing.sign_outgoing = key, True
            mav.signing.link_id, mav.signing.timestamp = link_id, timestamp
            mav.send(message)
            print(what, link_id, timestamp, unsigned.hex(), sink.data.hex())
            timestamp += 1 + 137 * i


lines("right", KEY, 0, 255, 190, START, 10)
lines("right", KEY, 3, 255, 190, START + 17, 5)
lines("right", KEY, 0, 1, 1, START - 5_000_000, 5)
lines("wrong-key", OTHER_KEY, 0, 254, 190, START, 5)
