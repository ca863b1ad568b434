"""Starts Vigil's processes for a test and ends them, whatever happens in between."""

import contextlib
import json
import signal
import subprocess
import threading
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
TOP = HERE.parents[1]
VIGIL = TOP / "target" / "release" / "vigil"
END_LIMIT_S = 8.0
# Up to 9 the ports of scripts are an instance's own; 0 is left to people.
INSTANCES = range(1, 10)
# Longer than any file of tests keeps its vehicles.
FREE_LIMIT_S = 240.0


def venv_python(name):
    """The interpreter of the environment of requirements-NAME.txt."""
    return TOP / "target" / f"venv-{name}" / "bin" / "python"


def script(what, client):
    """The script of a client; MAVSDK 3 and 4 have one, each runs it with its own interpreter."""
    return HERE / f"{what}_{client.rstrip('34')}.py"


class Process:
    """A child with its output kept; leaving the context ends it."""

    def __init__(self, name, command, folder):
        self.name = name
        self.command = [str(part) for part in command]
        self.errors = Path(folder) / f"{name}.log"

    def __enter__(self):
        with open(self.errors, "w", encoding="utf-8") as errors:
            self.child = subprocess.Popen(self.command, cwd=TOP, stdout=subprocess.PIPE, stderr=errors, text=True)
        self.lines = []
        self.reader = threading.Thread(target=self._read, daemon=True)
        self.reader.start()
        return self

    def _read(self):
        for line in self.child.stdout:
            self.lines.append(line)

    def said(self):
        """Everything the child wrote, for messages."""
        return "".join(self.lines[-20:]) + self.errors.read_text(encoding="utf-8")[-4000:]

    def wait(self, limit_s):
        """Waits for the child to end by itself; the exit code, or None when it is still running."""
        try:
            code = self.child.wait(limit_s)
        except subprocess.TimeoutExpired:
            return None
        self.reader.join(5.0)
        return code

    def end(self):
        """Ends the child as Ctrl-C would, and by force if that does not help."""
        if self.child.poll() is None:
            self.child.send_signal(signal.SIGINT)
            try:
                self.child.wait(END_LIMIT_S)
            except subprocess.TimeoutExpired:
                self.child.kill()
                self.child.wait()
        self.reader.join(5.0)

    def __exit__(self, *_):
        self.end()


class NotRunning(Exception):
    """A process ended at its start; the message has what it said."""


class Simulator(Process):
    """`vigil sim` in real time; `truth` has its status lines, which no MAVLink client sees."""

    def __init__(self, instance, course, folder, options=()):
        self.instance = instance
        command = [VIGIL, "sim", "--status", "--instance", instance, "--course", HERE / course, "--seed", 1, *options]
        super().__init__(f"simulator{instance}", command, folder)

    def __enter__(self):
        if not VIGIL.exists():
            raise FileNotFoundError(f"{VIGIL} is not built: cargo build --release")
        super().__enter__()
        try:
            limit = time.monotonic() + 20.0
            while not self.lines:
                if self.child.poll() is not None or time.monotonic() > limit:
                    raise NotRunning(f"the simulator does not run: {self.said()}")
                time.sleep(0.05)
        except BaseException:
            self.end()
            raise
        return self

    @property
    def truth(self):
        return [json.loads(line) for line in list(self.lines)]


def start_free(course, folder, options):
    """A simulator on the first instance that nobody uses; none when all are used."""
    for instance in INSTANCES:
        try:
            return Simulator(instance, course, folder, options).__enter__()
        except NotRunning as error:
            if "instance" not in str(error):
                raise
    return None


@contextlib.contextmanager
def free_simulator(course, folder, *options):
    """A simulator of one's own: other tests or a person may be flying on this machine. When all instances are used, the next one that is left."""
    limit = time.monotonic() + FREE_LIMIT_S
    while (simulator := start_free(course, folder, options)) is None:
        if time.monotonic() > limit:
            raise NotRunning(f"instances {INSTANCES[0]} to {INSTANCES[-1]} are all in use, for {FREE_LIMIT_S:.0f} s")
        time.sleep(5.0)
    try:
        yield simulator
    finally:
        simulator.end()


class Firmware(Process):
    """`vigil firmware` in real time; it waits for an operator's command."""

    def __init__(self, instance, folder):
        command = [VIGIL, "firmware", "--instance", instance, "--engage", "command"]
        super().__init__(f"firmware{instance}", command, folder)


class Client(Process):
    """A client script in its own environment."""

    def __init__(self, client, what, instance, folder):
        command = [venv_python(client), "-u", script("client", client), what, "--instance", instance]
        super().__init__(f"{client}-{what}", command, folder)

    def report(self):
        """The JSON object that a script prints last."""
        return json.loads(self.lines[-1])
