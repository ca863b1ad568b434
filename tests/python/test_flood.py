"""A link that the vehicle itself floods with 50 Mbit/s costs the loop little, and strangers who do cost it less.

What it costs is told in processor time: the time a step takes on the clock also holds the moments in which the
machine runs somebody else, the flooding station among them.
"""

import os
import random
import re
import signal
import socket
import struct
import subprocess
import time

from stack import TOP

FIRMWARE = TOP / "target" / "release" / "firmware"
SECONDS = 6.0
RATE_BIT_S = 50e6
DATAGRAM_BYTES = 1200
STEP_US = 50_000.0


def start(instance):
    """A firmware that nobody flies."""
    command = [FIRMWARE, "--instance", str(instance), "--priority", "0"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def processor_us(firmware):
    """Processor time of all its threads so far."""
    fields = open(f"/proc/{firmware.pid}/stat").read().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) * 1e6 / os.sysconf("SC_CLK_TCK")


def refused_packets(firmware):
    """Packets it refused, as its summary says."""
    firmware.send_signal(signal.SIGINT)
    said = firmware.communicate(timeout=10)[0]
    refused = re.search(r"packets, (\d+) refused", said)
    return int(refused.group(1)) if refused else 0


def heartbeat(system):
    """An autopilot's, which makes its sender the vehicle."""
    packet = struct.pack("<6BB2x", 9, 0, 0, 0, system, 1, 0) + struct.pack("<IBBBBB", 0, 2, 12, 81, 4, 3)
    checksum = 0xFFFF
    for byte in packet + bytes([50]):
        byte ^= checksum & 0xFF
        byte ^= (byte << 4) & 0xFF
        checksum = (checksum >> 8) ^ (byte << 8) ^ (byte << 3) ^ (byte >> 4)
    return b"\xfd" + packet + struct.pack("<H", checksum & 0xFFFF)


def flood(port, first):
    """Sends random bytes behind a first datagram; how many datagrams."""
    noise = random.Random(1)
    datagrams = [noise.randbytes(DATAGRAM_BYTES) for _ in range(64)]
    sent = 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.connect(("127.0.0.1", port))
        station.send(first)
        time.sleep(0.2)
        began = time.monotonic()
        while (elapsed := time.monotonic() - began) < SECONDS:
            while sent < elapsed * RATE_BIT_S / (8 * DATAGRAM_BYTES):
                station.send(datagrams[sent % len(datagrams)])
                sent += 1
            time.sleep(0.001)
    return sent


def test_a_flooded_link_costs_a_small_part_of_a_step():
    quiet, flooded = start(62), start(63)
    try:
        time.sleep(1.0)
        of_strangers = processor_us(flooded)
        flood(14030 + 63, b"no vehicle's")
        before = processor_us(quiet), processor_us(flooded)
        of_strangers = before[1] - of_strangers
        sent = flood(14030 + 63, heartbeat(63 + 1))
        after = processor_us(quiet), processor_us(flooded)
        refused = refused_packets(flooded)
    finally:
        quiet.kill()
        flooded.kill()
    steps = SECONDS * 1e6 / STEP_US
    quiet_us, flooded_us = ((late - early) / steps for early, late in zip(before, after))
    print(f"a step takes {of_strangers / steps:.0f} us when strangers flood the link")
    print(f"a step takes {quiet_us:.0f} us of processor time on a quiet link and {flooded_us:.0f} us on a flooded one, {sent} datagrams")
    assert sent * DATAGRAM_BYTES * 8 / SECONDS > 0.9 * RATE_BIT_S
    # It was read, not left aside, and read within bounds.
    assert refused > sent / 4
    assert flooded_us - quiet_us < 0.1 * STEP_US
    # The kernel refuses strangers.
    assert of_strangers / steps - quiet_us < 0.02 * STEP_US
