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

from vigil_cluster.__main__ import main
from vigil_cluster.campaign import Campaign, CampaignError

TOP = Path(__file__).resolve().parents[2]
VIGIL = TOP / "target" / "release" / "vigil"
ACTOR = TOP / "firmware" / "policy" / "actor" / "actor.safetensors"
DETECTOR = TOP / "detector" / "frozen" / "lstm_ad.safetensors"
FLIGHTS = ["--pilot", "geometric", "--family", "training", "--seed", "40", "--flights", "24"]


def whole(folder, arguments):
    """What one machine writes."""
    out = folder / "whole.json"
    subprocess.run([VIGIL, "evaluate", *arguments, "-o", out], check=True, capture_output=True)
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
    campaign = Campaign(["evaluate"], FLIGHTS, tmp_path / "flown.json", VIGIL, shards=12)
    failure = []

    def fly():
        try:
            campaign.fly()
        except Exception as error:  # told by the test's own thread
            failure.append(error)

    flying = threading.Thread(target=fly)
    flying.start()
    begun = time.monotonic()
    while len(list(campaign.parts.glob("*.part.json"))) < 3:
        assert time.monotonic() - begun < 120 and flying.is_alive(), failure
        time.sleep(0.01)
    cluster.remove_node(nodes[0], allow_graceful=False)
    left = 12 - len(list(campaign.parts.glob("*.part.json")))
    flying.join(timeout=300)
    assert not flying.is_alive() and not failure, failure
    assert left > 0, "the node was killed while there was work left"
    assert (tmp_path / "flown.json").read_bytes() == whole(tmp_path, FLIGHTS)


def test_an_interrupted_campaign_goes_on_with_its_parts_on_a_ray_of_its_own(tmp_path):
    out = tmp_path / "flown.json"
    arguments = [*FLIGHTS[:-1], "6", "--wind", "2"]
    campaign = Campaign(["evaluate"], arguments, out, VIGIL, shards=3)
    campaign.parts.mkdir()
    subprocess.run(
        [VIGIL, "evaluate", *arguments, "--shard", "2/3", "-o", campaign.parts / out.name],
        check=True,
        capture_output=True,
    )
    before = os.stat(campaign._part(2)).st_mtime_ns
    line = ["evaluate", *arguments, "--vigil", str(VIGIL), "--shards", "3", "-o", str(out)]
    assert main(line) == 0
    assert out.read_bytes() == whole(tmp_path, arguments)
    assert os.stat(campaign._part(2)).st_mtime_ns >= before

    # Parts of another campaign are neither taken nor overwritten.
    calm = [argument if argument != "2" else "0" for argument in arguments]
    with pytest.raises(CampaignError, match="of another campaign: wind_m_s was 2.0, and is 0.0"):
        Campaign(["evaluate"], calm, out, VIGIL, shards=3).fly()
    assert out.read_bytes() == whole(tmp_path, arguments)


def test_files_are_sent_along_and_what_fails_is_told(tmp_path, capfd):
    ray.init(num_cpus=2, log_to_driver=False)
    try:
        actor = ["--seed", "7", "--flights", "1", "--actor", str(ACTOR), "--detector=off"]
        Campaign(["evaluate"], actor, tmp_path / "actor.json", VIGIL).fly()
        assert json.loads((tmp_path / "actor.json").read_bytes())["flights_asked_for"] == 1
        attack = ["--seed", "5003", "--flights", "1", "--iterations", "1", "--burst", "20", "--arms", "none,recover"]
        attack += ["--detector", str(DETECTOR)]
        Campaign(["attack", "defended"], attack, tmp_path / "defended.json", VIGIL, shards=2).fly()
        one = ["attack", "defended", *attack, "-o", tmp_path / "one"]
        subprocess.run([VIGIL, *one], check=True, capture_output=True)
        for name in ["defended.json", "defended.csv"]:
            assert (tmp_path / name).read_bytes() == (tmp_path / "one" / name).read_bytes(), name
        for arguments, program, told in [
            (["--flights", "2", "--wind", "99"], {}, "--wind must be between 0 and 20"),
            (["--flights", "2", "--actor", "no-such-file"], {}, "cannot read no-such-file"),
            (["--logs", "x"], {}, "--logs is not for a cluster"),
            (["--threads=3"], {}, "--threads is not for a cluster"),
            (["--flights", "2"], {"vigil": TOP / "no-vigil"}, "no-vigil is no program"),
        ]:
            with pytest.raises(CampaignError, match=told):
                Campaign(["evaluate"], arguments, tmp_path / "no.json", **{"vigil": VIGIL} | program).fly()
        # A node without the program: it was there for the driver only.
        program = tmp_path / "vigil"
        program.symlink_to(VIGIL)
        campaign = Campaign(["evaluate"], ["--flights", "2"], tmp_path / "no.json", program, installed=True)
        campaign.vigil = Path("/no/such/vigil")
        with pytest.raises(CampaignError, match="has no program /no/such/vigil"):
            campaign._fly([1])
        # A program that is none.
        program.unlink()
        program.write_bytes(b"\x7fELF no program")
        program.chmod(0o755)
        with pytest.raises(CampaignError, match="cannot run the program"):
            Campaign(["evaluate"], ["--flights", "2"], tmp_path / "no.json", program).fly()
        assert not (tmp_path / "no.json").exists()
    finally:
        ray.shutdown()
