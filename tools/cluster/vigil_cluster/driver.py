"""A campaign of `vigil` whose seeds are flown some at a time on any node; `vigil merge` makes one report of all lines."""

import contextlib
import hashlib
import json
import os
import platform
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import ray
from ray.exceptions import RayError, RayTaskError

# Arguments of `vigil` that name files which a flight reads; they are sent along.
FILES = {"--actor", "--detector", "--detector-file", "--config", "--attack-actor", "--evade"}
# Arguments that make no sense here, and why.
REFUSED = {
    "--threads": "each task flies on one core",
    "--resume": "flights that are there are not flown again in any case",
    "--logs": "logs would stay where they were flown; fly these seeds again on one machine",
    "--draw-failures": "pictures would stay where they were flown; fly these seeds again on one machine",
    "--view": "a viewer shows flights of its own machine",
}
# Tasks known to Ray at once: enough for any cluster to be busy and for an autoscaler to see the demand.
MOST_SUBMITTED = 2000
# First seed and flights of a command that is not given any.
USUAL = {"evaluate": (1, 100), "completion": (5000, 40), "search": (5000, 20), "defended": (5000, 100)}


class CampaignError(Exception):
    """A campaign that cannot be flown; the message is for people."""


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _on_node(content: bytes, executable: bool = False) -> str:
    """The path of a file of this content on this node."""
    path = Path(tempfile.gettempdir()) / f"vigil-cluster-{os.getuid()}" / _digest(content)
    path.parent.mkdir(mode=0o700, exist_ok=True)
    if path.parent.lstat().st_uid != os.getuid():
        raise CampaignError(f"{path.parent} on {platform.node()} belongs to another user")
    if not path.exists():
        handle, beside = tempfile.mkstemp(dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.chmod(beside, 0o700 if executable else 0o600)
        # Another task of this node may have been first: its program runs, and its file stays.
        with contextlib.suppress(FileExistsError):
            os.link(beside, path)
        os.unlink(beside)
    return str(path)


def _fly_some(program, words: list, seeds: list) -> bytes:
    """Flies some seeds on a node: their lines. The program is a path there or a content; a word may be a content too."""
    node = platform.node()
    if isinstance(program, str) and not os.access(program, os.X_OK):
        raise CampaignError(f"{node} has no program {program}; leave --installed out to have it sent along")
    vigil = program if isinstance(program, str) else _on_node(program, executable=True)
    words = [word if isinstance(word, str) else _on_node(ray.get(word)) for word in words]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "some.json" if words[0] == "evaluate" else folder
        # A worker that is killed takes its flight along.
        line = [vigil, "--ends-with", str(os.getpid()), *words, *seeds, "--threads", "1", "-o", str(out)]
        try:
            done = subprocess.run(line, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
        except OSError as error:
            raise CampaignError(f"{node} cannot run the program: {error}") from error
        if done.returncode < 0:
            name = signal.Signals(-done.returncode).name
            raise ConnectionAbortedError(f"{' '.join(seeds)} on {node} was ended by {name}")
        if done.returncode != 0:
            raise CampaignError(f"{' '.join(seeds)} on {node}: {done.stderr.strip()[-2000:]}")
        (lines,) = Path(folder).glob("*.jsonl")
        return lines.read_bytes()


def _origin(lines: bytes) -> dict:
    """What has to be the same for flights to belong together."""
    heading = json.loads(lines.split(b"\n", 1)[0])
    return {name: value for name, value in heading.items() if name not in ("first_seed", "flights", "git_commit")}


def _taken(words: list, name: str, usual):
    """Takes an argument and its number out of the words."""
    for at, word in enumerate(words):
        flag, equals, value = word.partition("=")
        if flag == name:
            try:
                number = int(value if equals else words.pop(at + 1))
            except (IndexError, ValueError) as error:
                raise CampaignError(f"{name} needs a whole number") from error
            del words[at]
            return number
    if usual is None:
        raise CampaignError(f"{name} is needed")
    return usual


def _read(words: list) -> list:
    """The words, each file that they name replaced by its content."""
    read, before = [], ""
    for word in words:
        flag, equals, value = word.partition("=")
        path = value if flag in FILES and equals else word if before in FILES else None
        before = word
        if path in (None, "on", "off"):  # `--detector off` names no file
            read.append(word)
            continue
        try:
            read += [flag] * bool(equals) + [Path(path).read_bytes()]
        except OSError as error:
            raise CampaignError(f"cannot read {path}: {error.strerror}") from error
    return read


def _write(file: Path, content: bytes) -> None:
    """Writes a file whole, or not at all."""
    beside = file.with_suffix(".new")
    beside.write_bytes(content)
    os.replace(beside, file)


def fly(words, output, vigil, address=None, at_a_time=20, retries=5, installed=False) -> None:
    """Flies what is missing of a campaign, and writes its report to `output`. Raises CampaignError.

    `words` are a command of `vigil` with its arguments, `at_a_time` the seeds of a task. `address` is Ray's: none starts Ray in this
    process, `auto` joins the cluster of this machine.
    """
    words, output, vigil = list(words), Path(output), Path(vigil)
    if not os.access(vigil, os.X_OK):
        raise CampaignError(f"{vigil} is no program; build it, or name it with --vigil")
    # It flies what `vigil` hands on to it, and puts all parts together.
    laboratory = vigil.resolve().with_name("vigil-lab")
    if not os.access(laboratory, os.X_OK):
        raise CampaignError(f"{laboratory} is no program; build it (cargo build --release -p vigil-lab)")
    for word in (word.split("=")[0] for word in words):
        if word in REFUSED:
            raise CampaignError(f"{word} is not for a cluster: {REFUSED[word]}")
    first, count = next((USUAL[word] for word in words[:2] if word in USUAL), (None, None))
    first, count = _taken(words, "--seed", first), _taken(words, "--flights", count)
    if first < 0 or count < 1:
        raise CampaignError("--seed is a number from 0 on, --flights one above 0")
    program = (vigil if words[:1] == ["evaluate"] else laboratory).read_bytes()
    contents = _read(words)
    digests = [word if isinstance(word, str) else _digest(word) for word in contents]
    made_by = json.dumps({"program": _digest(program), "words": digests}).encode()
    parts = output.with_name(f"{output.stem}.parts")
    parts.mkdir(parents=True, exist_ok=True)
    other = CampaignError(f"{parts} holds flights of another campaign or program; name another file, or remove it")
    seeds = {seed: min(at_a_time, first + count - seed) for seed in range(first, first + count, at_a_time)}
    files = {seed: parts / f"{seed}-{flights}.jsonl" for seed, flights in seeds.items()}
    # A disk that was full leaves an empty file.
    there = {seed: file for seed, file in files.items() if file.exists() and file.stat().st_size}
    note = parts / "made-by.json"
    if any(parts.glob("*.jsonl")) and not (note.exists() and note.read_bytes() == made_by):
        raise other
    _write(note, made_by)
    origin = _origin(next(iter(there.values())).read_bytes()) if there else None
    print(f"{len(there)} of {len(files)} parts are there already", file=sys.stderr, flush=True)
    started = not ray.is_initialized()
    if started:
        ray.init(address=address, log_to_driver=False, logging_level="warning")
    try:
        program = str(vigil.resolve()) if installed else ray.put(program)
        # Nodes need Ray, not this package.
        ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])
        # A node that is lost is Ray's to notice; a flight that was killed is ours.
        task = ray.remote(_fly_some).options(num_cpus=1, max_retries=retries, retry_exceptions=[ConnectionAbortedError])
        sent = [word if isinstance(word, str) else ray.put(word) for word in contents]
        missing, running = [seed for seed in files if seed not in there], {}
        while missing or running:
            while missing and len(running) < MOST_SUBMITTED:
                seed = missing.pop(0)
                running[task.remote(program, sent, ["--seed", str(seed), "--flights", str(seeds[seed])])] = seed
            (done, *_), _ = ray.wait(list(running), num_returns=1)
            seed = running.pop(done)
            try:
                lines = ray.get(done)
            except RayTaskError as error:
                raise CampaignError(str(error.cause or error)) from error
            except RayError as error:
                raise CampaignError(f"the flights from {seed} were lost {retries + 1} times: {error}") from error
            origin = origin or _origin(lines)
            if _origin(lines) != origin:
                raise other
            _write(files[seed], lines)
            print(f"{len(files) - len(missing) - len(running)}/{len(files)} parts", file=sys.stderr, flush=True)
    finally:
        if started:
            ray.shutdown()
    if subprocess.run([vigil, "merge", *files.values(), "-o", output], check=False).returncode != 0:
        raise CampaignError("the flights were not put together")
