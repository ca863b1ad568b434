"""Policies in ONNX: what `vigil import` makes of them is what ONNX Runtime makes of them, or a refusal with the reason."""

import json
import subprocess
from pathlib import Path

import pytest

TOP = Path(__file__).resolve().parents[2]
VIGIL = TOP / "target" / "release" / "vigil"
PYTHON = TOP / "target" / "venv-onnx" / "bin" / "python"
TOLERANCE = 1e-5


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    folder = tmp_path_factory.mktemp("onnx") / "models"
    subprocess.run([PYTHON, Path(__file__).with_name("onnx_models.py"), folder], check=True, timeout=120)
    return folder


def vigil(*arguments):
    return subprocess.run([VIGIL, *arguments], capture_output=True, text=True, timeout=120, check=False)


def test_every_shape_gives_what_onnx_runtime_gives(models, tmp_path):
    found = {}
    for model in sorted(models.glob("*.onnx")):
        out = tmp_path / f"{model.stem}.safetensors"
        done = vigil("import", model, "-o", out, "--compute", model.with_suffix(".inputs.json"))
        assert done.returncode == 0, f"{model.stem}: {done.stderr}"
        ours = json.loads(done.stdout.splitlines()[-1])
        theirs = json.loads(model.with_suffix(".outputs.json").read_text())
        assert len(ours) == len(theirs) == 2
        found[model.stem] = max(abs(a - b) / max(1.0, abs(b)) for a, b in zip(ours, theirs))
        assert out.stat().st_size > 100
    print(found)
    assert len(found) >= 12
    assert max(found.values()) < TOLERANCE, found
    outputs = [json.loads(path.read_text()) for path in models.glob("*.outputs.json")]
    assert all(max(map(abs, output)) > 1e-3 for output in outputs), "an output of nothing shows nothing"


def test_what_cannot_be_imported_is_refused_with_the_reason_and_nothing_is_written(models, tmp_path):
    words = json.loads((models / "refused.json").read_text())
    assert len(words) >= 18
    kept = tmp_path / "kept.safetensors"
    kept.write_text("an earlier one")
    for name, said in words.items():
        done = vigil("import", models / "refused" / name, "-o", kept)
        assert done.returncode == 1, name
        assert said in done.stderr, (said, done.stderr)
        assert name in done.stderr
        assert kept.read_text() == "an earlier one"
    assert [path.name for path in tmp_path.iterdir()] == ["kept.safetensors"]


def test_an_imported_policy_flies_with_field_and_guard_and_replays_to_the_bit(models, tmp_path):
    policy = tmp_path / "policy.safetensors"
    model = models / "goal_beside_the_frame.onnx"
    assert vigil("import", model, "-o", policy).returncode == 0
    fly = ["evaluate", "--actor", policy, "--flights", "2", "--seed", "7", "--family", "training"]
    refused = vigil(*fly, "-o", tmp_path / "no.json")
    assert refused.returncode == 1 and "add --detector off" in refused.stderr
    flown = [*fly, "--detector", "off", "--guard", "on", "-o"]
    for name in ["a.json", "b.json"]:
        done = vigil(*flown, tmp_path / name)
        assert done.returncode == 0, done.stderr
    a, b = ((tmp_path / name).read_bytes() for name in ["a.json", "b.json"])
    assert a == b
    report = json.loads(a)
    assert report["actor_sha256"] and len({f["state_hash"] for f in report["flights"]}) == 2

    # One flipped bit, and it does not fly.
    content = bytearray(policy.read_bytes())
    content[-3] ^= 1
    policy.write_bytes(content)
    refused = vigil(*flown, tmp_path / "no.json")
    assert refused.returncode == 1 and "was altered" in refused.stderr and "policy.safetensors" in refused.stderr
    # What is made for our own actor says what it takes.
    refused = vigil("attack", "table", "--actor", policy, "-o", tmp_path / "attack")
    assert refused.returncode == 1 and "vigil policy 1" in refused.stderr
