"""A campaign of `vigil` in shards, each a Ray task; `vigil merge` makes the whole of them."""

import hashlib
import json
import os
import platform
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import ray
from ray.exceptions import RayError, RayTaskError

# Arguments of `vigil` that name files which a flight reads; they are sent along.
FILES = {"--actor", "--detector", "--detector-file", "--config", "--attack-actor", "--evade"}
# Values of theirs that are no file: `vigil evaluate --detector off`.
NO_FILES = {"on", "off"}
# Arguments that make no sense for one share of a campaign, and why.
REFUSED = {
    "--shard": "the driver divides the campaign itself",
    "--threads": "each task flies on one core",
    "--logs": "logs would stay where they were flown; fly these seeds again on one machine",
    "--resume": "parts that are there are gone on with in any case",
    "--draw-failures": "pictures would stay where they were flown; fly these seeds again on one machine",
}
# Tasks known to Ray at once: enough for any cluster to be busy and for an autoscaler to see the demand.
MOST_SUBMITTED = 2000


class CampaignError(Exception):
    """A campaign that cannot be flown; the message is for people."""


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _kept(content: bytes, digest: str, executable: bool) -> Path:
    """A file of this content on this node, written once."""
    folder = Path(tempfile.gettempdir()) / f"vigil-cluster-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.stat().st_uid != os.getuid():
        raise CampaignError(f"{folder} on {platform.node()} belongs to somebody else")
    path = folder / digest
    if not path.exists():
        handle, beside = tempfile.mkstemp(dir=folder)
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.chmod(beside, 0o700 if executable else 0o600)
        os.replace(beside, path)
    return path


def _fly(program, files: dict, command: list, arguments: list, shard: str) -> bytes:
    """One shard on a worker: the part file's content.

    `program` is the program's content and digest, or its path on every node. `files` has a content for each digest, and
    `arguments` may name them as `@digest`.
    """
    node = platform.node()
    if isinstance(program, str):
        vigil = Path(program)
        if not os.access(vigil, os.X_OK):
            raise CampaignError(f"{node} has no program {vigil}; leave --installed out to have it sent along")
    else:
        vigil = _kept(ray.get(program[0]), program[1], executable=True)
    paths = {f"@{digest}": str(_kept(ray.get(content), digest, False)) for digest, content in files.items()}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "part.json" if command == ["evaluate"] else Path(folder)
        # A worker that is killed takes its flight along.
        line = [str(vigil), "--ends-with", str(os.getpid()), *command]
        line += [paths.get(argument, argument) for argument in arguments]
        line += ["--threads", "1", "--shard", shard, "-o", str(out)]
        try:
            done = subprocess.run(line, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
        except OSError as error:
            raise CampaignError(f"{node} cannot run the program: {error}") from error
        if done.returncode < 0:
            name = signal.Signals(-done.returncode).name
            raise ConnectionAbortedError(f"shard {shard} on {node} was ended by {name}")
        if done.returncode != 0:
            raise CampaignError(f"shard {shard} on {node}: {done.stderr.strip()[-2000:]}")
        (part,) = Path(folder).glob("*.part.json")
        return part.read_bytes()


@dataclass
class Campaign:
    """What to fly, and where its whole goes.

    `command` is `["evaluate"]`, `["attack", …]` with `completion`, `search` or `defended`, or `["detector", "collect"]`;
    `arguments` are that command's.
    `address` is Ray's: none starts Ray in this process, `auto` joins the cluster of this machine. Raises CampaignError.
    """

    command: list
    arguments: list
    output: Path
    vigil: Path
    address: str | None = None
    shards: int | None = None
    flights_per_shard: int = 20
    retries: int = 5
    installed: bool = False
    quiet: bool = False
    _files: dict = field(default_factory=dict)

    def __post_init__(self):
        self.output, self.vigil = Path(self.output), Path(self.vigil)
        if not os.access(self.vigil, os.X_OK):
            raise CampaignError(f"{self.vigil} is no program; build it, or name it with --vigil")
        for argument in self.arguments:
            if why := REFUSED.get(argument.split("=")[0]):
                raise CampaignError(f"{argument.split('=')[0]} is not for a cluster: {why}")
        if self.shards is None:
            self.shards = max(1, -(-self._count() // self.flights_per_shard))

    def _count(self) -> int:
        """Flights of the campaign, as far as the arguments say so."""
        for name, value in zip(self.arguments, [*self.arguments[1:], ""]):
            name, _, given = name.partition("=")
            if name == "--flights" and (given or value).isdigit():
                return int(given or value)
        return {"evaluate": 100, "detector": 600}.get(self.command[0], 40)

    @property
    def parts(self) -> Path:
        """The folder of the parts."""
        return self.output.with_name(f"{self.output.stem}.parts")

    def _part(self, number: int) -> Path:
        return self.parts / f"{self.output.stem}.{number}-of-{self.shards}.part.json"

    def _whole(self, number: int) -> bool:
        """Whether a part is there, of this campaign, and whole: `vigil` itself looks, and flies nothing then."""
        path = self._part(number)
        if not path.exists():
            return False
        try:
            part = json.loads(path.read_bytes())["part"]
            share = [part["units"] * edge // self.shards for edge in (number - 1, number)]
            if len(part["done"]) < share[1] - share[0]:
                return False
        except (ValueError, KeyError, TypeError):
            return False
        out = self.parts / self.output.name if self.command == ["evaluate"] else None
        if out is None:
            return True  # `vigil merge` refuses what does not belong together.
        line = [self.vigil, *self.command, *self.arguments, "--shard", f"{number}/{self.shards}", "-o", out]
        done = subprocess.run(line, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise CampaignError(done.stderr.strip())
        return True

    def _sent_along(self) -> list:
        """The arguments, each file that they name replaced by `@digest`."""
        sent, name = [], ""
        for argument in self.arguments:
            flag, equals, value = argument.partition("=")
            path = value if flag in FILES and equals else argument if name in FILES else None
            name = argument
            if path is None or path in NO_FILES:
                sent.append(argument)
                continue
            try:
                content = Path(path).read_bytes()
            except OSError as error:
                raise CampaignError(f"cannot read {path}: {error.strerror}") from error
            digest = _digest(content)
            self._files.setdefault(digest, ray.put(content))
            sent += [flag, f"@{digest}"] if equals else [f"@{digest}"]
        return sent

    def fly(self) -> None:
        """Flies what is missing, and writes the whole."""
        self.parts.mkdir(parents=True, exist_ok=True)
        missing = [number for number in range(1, self.shards + 1) if not self._whole(number)]
        self._tell(f"{self.shards - len(missing)} of {self.shards} parts are there already")
        if missing:
            self._fly(missing)
        merged = subprocess.run([self.vigil, "merge", self.parts, "-o", self.output], check=False)
        if merged.returncode != 0:
            raise CampaignError("the parts were not put together")

    def _fly(self, missing: list) -> None:
        joined = not ray.is_initialized()
        if joined:
            ray.init(address=self.address, log_to_driver=False, logging_level="warning")
        try:
            if self.installed:
                program = str(self.vigil.resolve())
            else:
                content = self.vigil.read_bytes()
                program = (ray.put(content), _digest(content))
            arguments = self._sent_along()
            task = ray.remote(_fly).options(
                num_cpus=1,
                max_retries=self.retries,
                # A node that is lost is Ray's to notice; a flight that was killed is ours.
                retry_exceptions=[ConnectionAbortedError],
            )
            waiting, running, done, begun, told = missing[::-1], {}, 0, time.monotonic(), 0.0
            while waiting or running:
                while waiting and len(running) < MOST_SUBMITTED:
                    number = waiting.pop()
                    shard = f"{number}/{self.shards}"
                    running[task.remote(program, self._files, self.command, arguments, shard)] = number
                ready, _ = ray.wait(list(running), timeout=1.0)
                for result in ready:
                    number = running.pop(result)
                    self._keep(number, self._result(result, number))
                    done += 1
                gone = time.monotonic() - begun
                if gone - told > 5 or not (waiting or running):
                    told = gone
                    nodes = sum(node["Alive"] for node in ray.nodes())
                    self._tell(f"{done}/{len(missing)} parts, {gone:.0f} s gone, {nodes} nodes")
        finally:
            if joined:
                ray.shutdown()

    def _result(self, result, number: int) -> bytes:
        try:
            return ray.get(result)
        except RayTaskError as error:
            raise CampaignError(str(error.cause or error)) from error
        except RayError as error:
            raise CampaignError(f"shard {number}/{self.shards} was lost {self.retries + 1} times: {error}") from error

    def _keep(self, number: int, part: bytes) -> None:
        path = self._part(number)
        handle, beside = tempfile.mkstemp(dir=self.parts)
        with os.fdopen(handle, "wb") as file:
            file.write(part)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(beside, 0o644)
        os.replace(beside, path)

    def _tell(self, text: str) -> None:
        if not self.quiet:
            print(text, file=sys.stderr, flush=True)
