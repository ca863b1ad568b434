"""pymavlink signs, and the firmware obeys who has the key: nobody else, also on loopback when that is asked for."""

import os
import signal
import socket
import subprocess
import sys
import time

os.environ["MAVLINK20"] = "1"
HERE = os.path.dirname(os.path.abspath(__file__))
FIRMWARE = os.path.join(HERE, "..", "..", "target", "release", "firmware")
INSTANCE = 61
KEY = bytes(range(100, 132))
COUNT = 1000
COMPANION = 191
# Commands that the firmware answers in one step.
AT_ONCE = 5
# An operator's command that is always answered: disengage.
GUIDED_ENABLE = 92


def test_of_a_thousand_commands_each_only_those_signed_with_the_key_are_answered(tmp_path):
    from stack import venv_python

    ran = subprocess.run(
        [venv_python("pymavlink"), __file__, tmp_path], capture_output=True, text=True, timeout=120, cwd=HERE
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr


class Station:
    """Sends one packet at a time and counts the answers."""

    def __init__(self, port):
        from pymavlink.dialects.v20 import common

        self.mavlink = common
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", port))
        self.socket.settimeout(0.001)
        self.sent = None
        self.sender = self._end()
        self.receiver = self._end()
        self.receiver.signing.secret_key = KEY
        self.acknowledged = 0
        self.signed = self.unsigned = 0

    def _end(self):
        return self.mavlink.MAVLink(self, srcSystem=1, srcComponent=1)

    def write(self, data):
        self.sent = bytes(data)

    def command(self, key, ahead_s=0.0):
        """A command's bytes: signed with `key` if there is one, now or ahead of time."""
        signing = self.sender.signing
        signing.sign_outgoing, signing.secret_key = key is not None, key
        now = int((time.time() - 1420070400 + ahead_s) * 1e5)
        signing.timestamp = now if ahead_s else max(now, getattr(self, "last", 0) + 1)
        if key and not ahead_s:
            self.last = signing.timestamp
        self.sender.command_long_send(1, COMPANION, GUIDED_ENABLE, 0, 0, 0, 0, 0, 0, 0, 0)
        return self.sent

    def say(self, data):
        self.socket.send(data)
        self.listen()

    def listen(self):
        try:
            while True:
                data = self.socket.recv(2048)
                for message in self.receiver.parse_buffer(data) or []:
                    if message.get_signed():
                        self.signed += 1
                    else:
                        self.unsigned += 1
                    if message.get_type() == "COMMAND_ACK" and message.command == GUIDED_ENABLE:
                        self.acknowledged += 1
        except (TimeoutError, ConnectionRefusedError):
            pass

    def answers(self, packets, at_once=50):
        """How many of the packets are answered."""
        # The last word of a firmware that was ended is no answer to these.
        self.settle(0.2)
        before = self.acknowledged
        for i, data in enumerate(packets):
            self.say(data)
            if i % at_once == at_once - 1:
                self.settle(0.06)
        self.settle(0.3)
        return self.acknowledged - before

    def settle(self, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.listen()


def main(folder):
    key = os.path.join(folder, "vigil.key")
    with open(os.open(key, os.O_WRONLY | os.O_CREAT, 0o600), "w") as f:
        f.write(KEY.hex())
    link = f"udpin://127.0.0.1:{14030 + INSTANCE}"
    command = [FIRMWARE, "--instance", str(INSTANCE), "--link", link, "--signing-key", key]
    command += ["--allow-unsigned", "never", "--priority", "0"]

    def start():
        firmware = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        time.sleep(1.0)
        assert firmware.poll() is None, firmware.stdout.read()
        return firmware

    def end(firmware, how):
        firmware.send_signal(how)
        return firmware.communicate(timeout=10)[0]

    station = Station(14030 + INSTANCE)
    firmware = start()
    try:
        right = []

        def rightly():
            for _ in range(COUNT):
                right.append(station.command(KEY))
                yield right[-1]

        answered = {
            # Who signs for the autopilot is the vehicle; what others send is not looked into.
            "introduction": station.answers([station.command(KEY)]),
            "unsigned": station.answers(station.command(None) for _ in range(COUNT)),
            "wrong key": station.answers(station.command(bytes(32)) for _ in range(COUNT)),
            "from the future": station.answers(station.command(KEY, ahead_s=120.0) for _ in range(COUNT)),
            "right": station.answers(rightly(), AT_ONCE),
            "replayed": station.answers(right),
        }
        said = end(firmware, signal.SIGINT)
        firmware = start()
        answered["replayed after a restart"] = station.answers(right)
        end(firmware, signal.SIGKILL)
        firmware = start()
        answered["replayed after a kill"] = station.answers(right[-100:])
        station.settle(1.0)
        answered["right after a kill"] = station.answers((station.command(KEY) for _ in range(100)), AT_ONCE)
    finally:
        said_last = end(firmware, signal.SIGINT)
    print(answered, said, said_last, sep="\n")
    expected = {name: 0 for name in answered} | {"introduction": 1, "right": COUNT, "right after a kill": 100}
    assert answered == expected
    for reason in ["unsigned", "wrong signature", "from the future", "replayed"]:
        assert f"{COUNT} {reason}" in said
    # pymavlink verifies what the firmware sends.
    assert station.signed > COUNT and station.unsigned == 0


if __name__ == "__main__":
    main(sys.argv[1])
