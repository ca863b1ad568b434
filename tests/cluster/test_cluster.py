"""The Ray driver: the file that a cluster makes is, byte for byte, the one that one machine writes, whatever is lost."""

import json
import os
import subprocess
import threading
import time
from pathlib import Path

import pytest
import ray
from ray.cluster_utils import Cluster

from vigil_cluster import CampaignError, fly
from vigil_cluster.__main__ import main

TOP = Path(__file__).resolve().parents[2]
VIGIL = TOP / "target" / "release" / "vigil"
ACTOR = TOP / "firmware" / "policy" / "actor" / "actor.safetensors"
DETECTOR = TOP / "detector" / "frozen" / "lstm_ad.safetensors"
FLIGHTS = ["evaluate", "--pilot", "geometric", "--family", "training", "--seed", "40", "--flights", "24"]


def one_machine(folder, words):
    """What one machine writes."""
    out = folder / "whole.json"
    subprocess.run([VIGIL, *words, "-o", out], check=True, capture_output=True)
    return out.read_bytes()


@pytest.fixture
def two_nodes():
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
    ray.init(address=cluster.address, log_to_driver=False)
    cluster.wait_for_nodes()
    yield cluster, nodes
    ray.shutdown()
    cluster.shutdown()


def test_a_node_killed_in_the_middle_changes_no_byte(two_nodes, tmp_path):
    cluster, nodes = two_nodes
    failure = []

    def flown():
        try:
            fly(FLIGHTS, tmp_path / "flown.json", VIGIL, at_a_time=2)
        except Exception as error:  # raised again by the test's own thread
            failure.append(error)

    def parts():
        return len(list((tmp_path / "flown.parts").glob("*.jsonl")))

    flying = threading.Thread(target=flown)
    flying.start()
    begun = time.monotonic()
    while parts() < 3:
        assert time.monotonic() - begun < 120 and flying.is_alive(), failure
        time.sleep(0.01)
    cluster.remove_node(nodes[0], allow_graceful=False)
    left = 12 - parts()
    flying.join(timeout=300)
    assert not flying.is_alive() and not failure, failure
    assert left > 0, "the node was killed while there was work left"
    assert (tmp_path / "flown.json").read_bytes() == one_machine(tmp_path, FLIGHTS)


def test_an_interrupted_campaign_goes_on_with_its_parts_on_a_ray_of_its_own(tmp_path):
    out, parts = tmp_path / "flown.json", tmp_path / "flown.parts"
    words = [*FLIGHTS[:-1], "6", "--wind", "2"]
    line = [*words, "--vigil", str(VIGIL), "--at-a-time", "2", "-o", str(out)]
    assert main([*line, "--address", "nonsense"]) == 1
    assert main(line) == 0
    assert out.read_bytes() == one_machine(tmp_path, words)
    # One part of three was lost on a full disk.
    kept, lost = parts / "40-2.jsonl", parts / "42-2.jsonl"
    before, content = os.stat(kept).st_mtime_ns, lost.read_bytes()
    lost.write_bytes(b"")
    out.unlink()
    assert main(line) == 0
    assert out.read_bytes() == one_machine(tmp_path, words)
    assert os.stat(kept).st_mtime_ns == before and lost.read_bytes() == content

    # Parts of another campaign are neither taken nor overwritten, be they all of it.
    with pytest.raises(CampaignError, match="of another campaign or program"):
        fly([*words[:-1], "0"], out, VIGIL, at_a_time=2)
    # Nor is a part of another's beside one that is flown here.
    lost.unlink()
    own = kept.read_bytes()
    kept.write_bytes(own.replace(b'"arithmetic":"', b'"arithmetic":"x', 1))
    with pytest.raises(CampaignError, match="of another campaign or program"):
        fly(words, out, VIGIL, at_a_time=2)
    assert not lost.exists()
    assert out.read_bytes() == one_machine(tmp_path, words)


def test_files_are_sent_along_and_what_fails_is_said(tmp_path, monkeypatch):
    # Nodes do not have this package.
    monkeypatch.delenv("PYTHONPATH", raising=False)
    ray.init(num_cpus=2, log_to_driver=False)
    try:
        actor = ["evaluate", "--seed", "7", "--flights=1", "--actor", str(ACTOR), "--detector=off"]
        fly(actor, tmp_path / "actor.json", VIGIL)
        assert json.loads((tmp_path / "actor.json").read_bytes())["flights_asked_for"] == 1
        attack = ["attack", "defended", "--seed", "5003", "--flights", "2", "--iterations", "1", "--burst", "20"]
        attack += ["--arms", "none,recover", "--detector", str(DETECTOR)]
        fly(attack, tmp_path / "defended.json", VIGIL, at_a_time=1)
        subprocess.run([VIGIL, *attack, "-o", tmp_path / "one"], check=True, capture_output=True)
        for name in ["defended.json", "defended.csv", "defended.jsonl"]:
            assert (tmp_path / name).read_bytes() == (tmp_path / "one" / name).read_bytes(), name
        for words, program, why in [
            (["--flights", "2", "--wind", "99"], {}, "--wind must be between 0 and 20"),
            (["--flights", "2", "--actor", "no-such-file"], {}, "cannot read no-such-file"),
            (["--flights", "0"], {}, "--flights one above 0"),
            (["--logs", "x"], {}, "--logs is not for a cluster"),
            (["--threads=3"], {}, "--threads is not for a cluster"),
            (["--flights", "2"], {"vigil": TOP / "no-vigil"}, "no-vigil is no program"),
        ]:
            with pytest.raises(CampaignError, match=why):
                fly(["evaluate", *words], tmp_path / "no.json", **{"vigil": VIGIL} | program)
        # A program that is none.
        for program in [tmp_path / "vigil-lab", tmp_path / "vigil"]:
            program.write_bytes(b"\x7fELF no program")
            program.chmod(0o755)
        with pytest.raises(CampaignError, match="cannot run the program"):
            fly(["evaluate", "--flights", "2"], tmp_path / "no.json", program)
        assert not (tmp_path / "no.json").exists()
    finally:
        ray.shutdown()
