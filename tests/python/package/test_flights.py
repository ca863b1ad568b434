"""`vigil.evaluate` and `vigil.log`: what the command line says; the examples run; the annotations hold."""

import json
import subprocess
import sys

import numpy as np
import pytest

from conftest import TOP, VIGIL
from vigil import log
from vigil.evaluate import completion

SEEDS = 2


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory):
    """What `vigil evaluate` says of these flights, and their logs."""
    folder = tmp_path_factory.mktemp("evaluated")
    arguments = ["--flights", str(SEEDS), "--seed", "7", "--ground-every", "0", "--threads", "2", "--attack", "bim-accumulating"]
    arguments += ["--iterations", "5", "--burst", "20"]
    command = [VIGIL, "evaluate", *arguments, "-o", folder / "e.json", "--logs", folder / "logs"]
    subprocess.run(command, check=True, capture_output=True, timeout=240)
    return json.loads((folder / "e.json").read_text())["flights"], folder / "logs"


def test_flights_are_those_of_the_command_line(evaluated):
    flights, _ = evaluated
    # The detector that is built in, from its file.
    own_file = TOP / "detector" / "frozen" / "lstm_ad.safetensors"
    attack = {"attack": "bim-accumulating", "iterations": 5, "burst": 20}
    for threads, detector in [(1, None), (3, own_file)]:
        flown = completion("validation", SEEDS, first_seed=7, threads=threads, detector=detector, **attack)
        for ours, theirs in zip(flown.flights, flights, strict=True):
            assert ours.seed == theirs["seed"]
            assert ours.outcome == theirs["outcome"]
            assert ours.time_s == theirs["flight_time_s"]
            assert ours.path_length_m == theirs["path_length_m"]
            assert ours.altered_frames == theirs["attack"]["attacked_steps"]
    assert sum(flight.altered_frames for flight in flown.flights) > 0
    assert any(flight.first_alarm_step is not None for flight in flown.flights)
    low, high = flown.interval_95()
    assert 0.0 <= low <= flown.completion <= high <= 1.0
    assert sum(flown.counts().values()) == SEEDS


def test_a_log_is_read_as_columns(evaluated):
    flights, logs = evaluated
    read = log.read(logs / "7.mcap", frames=True)
    steps = len(read.step)
    assert steps > 50 and (np.diff(read.step) == 1).all()
    np.testing.assert_allclose(np.diff(read.time_s), 0.05, atol=1e-6)
    assert read["position_ned_m"].shape == (steps, 3) and read["phi"].shape == (steps, 48)
    assert read["score"].shape == (steps,) and np.nanmax(read["score"]) > 0.8
    way = np.nansum(np.linalg.norm(np.diff(read["position_ned_m"][:, :2], axis=0), axis=1))
    assert way == pytest.approx(flights[0]["path_length_m"], rel=0.1)
    total = read["contributions"].sum(axis=1)
    explained = np.isfinite(total) & np.isfinite(read["action"][:, 1])
    assert explained.sum() > 20
    assert read["goal"][0, 0] > read["goal"][-1, 0] or flights[0]["outcome"] != "success"
    assert set(read["state"]) >= {"guided"} and set(read["verdict"]) >= {"clean", "attack"}
    assert read.frames.shape == (len(read.frame_steps), 128, 256) and read.frames.dtype == np.float32
    assert 0.0 <= read.frames.min() and read.frames.max() == 100.0
    assert read.info["seed"] == "7" and len(read.info["actor_sha256"]) == 64
    assert read.info["course"] and read.info["outcome"].startswith(flights[0]["outcome"])
    assert "complete" in read.end and read == read and len({read, read}) == 1
    assert len(log.read(logs / "7.mcap").frames) == 0
    table = read.table()
    assert len(table) == steps and {"action_0", "score", "state"} <= set(table.columns)


def test_a_log_that_ends_before_its_first_step_has_the_same_columns_without_values(evaluated, tmp_path):
    whole, at, kind = (evaluated[1] / "7.mcap").read_bytes(), 8, 0
    # MCAP's records up to the first of metadata: their kind, their length, what they hold.
    while kind != 12:
        kind, at = whole[at], at + 9 + int.from_bytes(whole[at + 1 : at + 9], "little")
    (tmp_path / "short.mcap").write_bytes(whole[:at])
    read = log.read(tmp_path / "short.mcap")
    assert len(read.step) == 0 and "not closed" in read.end
    assert read["position_ned_m"].shape == (0, 3) and read["score"].shape == (0,)
    assert read.numbers.keys() == log.read(evaluated[1] / "7.mcap").numbers.keys()
    assert len(read.table()) == 0


def test_what_is_no_log_is_refused(tmp_path):
    with pytest.raises(ValueError, match="missing.mcap"):
        log.read(tmp_path / "missing.mcap")
    (tmp_path / "no.mcap").write_text("no log at all, but long enough to be one")
    with pytest.raises(ValueError, match="no MCAP file"):
        log.read(tmp_path / "no.mcap")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"family": "nowhere"}, "no course family is called `nowhere`"),
        ({"flights": 0}, "flights: 1 or more"),
        ({"seeds": []}, "seeds: is empty"),
        ({"seeds": (seed for seed in range(2))}, "seeds: a collections.abc.Sequence or a numpy.ndarray, got generator"),
        ({"family": 3}, "family: a str, got int"),
        ({"apf": "no"}, "apf: a bool or .*, got str"),
        ({"guard": 1}, "guard: a bool or .*, got int"),
        ({"epsilon": "a"}, "epsilon: above 0 and at most 255, got 'a'"),
        ({"seeds": [-1]}, "seeds: 0 or more"),
        ({"first_seed": -1}, "first_seed: 0 or more"),
        ({"pilot": "me"}, "pilot: actor or geometric"),
        ({"attack": "magic"}, "attack: magic is none of"),
        ({"wind": 50.0}, "wind: 0 to 20 m/s, got 50.0"),
        ({"noise": float("nan")}, "noise: a factor from 0 to 100, got nan"),
        ({"threads": 0}, "threads: 1 or more"),
        ({"iterations": -1}, "iterations: 1 or more"),
        ({"actor": "/no/actor"}, "/no/actor"),
        ({"detector": "/no/detector"}, "/no/detector"),
        ({"actor": 3}, "actor: expected a path, got int"),
        ({"detector": 3}, "detector: expected a path, got int"),
        ({"attack": "pgd", "burst": 2.5}, "burst: .*, got 2.5"),
    ],
)
def test_a_campaign_out_of_range_is_refused(options, said):
    with pytest.raises((TypeError, ValueError), match=said):
        completion(**{"flights": 1, **options})


@pytest.mark.parametrize(
    "example", ["fly_a_course", "explain_a_decision", "attack_a_flight", "train_a_detector", "read_a_log", "complete_courses"]
)
def test_an_example_runs(example, evaluated, tmp_path):
    file = TOP / "tools" / "python" / "examples" / f"{example}.py"
    arguments = [evaluated[1] / "8.mcap"] if example == "read_a_log" else []
    done = subprocess.run([sys.executable, file, *arguments], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    said = {
        "fly_a_course": "course 7: success",
        "explain_a_decision": "the pixel that counts most",
        "attack_a_flight": "first alarm at step 6",
        "train_a_detector": "attacked steps of a new flight",
        "read_a_log": "the log is complete",
        "complete_courses": "unattacked: 6 of 6",
    }
    assert said[example] in done.stdout, done.stdout
    if arguments:
        bare = subprocess.run([sys.executable, file], capture_output=True, text=True, timeout=60)
        assert bare.returncode == 1 and bare.stderr.startswith("Reads a flight log")


def test_the_annotations_hold():
    folder = TOP / "tools" / "python"
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--cache-dir", TOP / "target" / "mypy", "vigil"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr
