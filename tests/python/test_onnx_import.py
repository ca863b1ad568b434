"""Policies in ONNX: what `vigil import` makes of them is what ONNX Runtime makes of them, or a refusal with the reason."""

import json
import random
import shlex
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


def options(model):
    """What names the action of a model with several outputs, and how its row of values is read."""
    return json.loads(model.with_suffix(".options.json").read_text())


def vigil(*arguments):
    return subprocess.run([VIGIL, *arguments], capture_output=True, text=True, timeout=120, check=False)


@pytest.fixture(scope="module")
def imported(models, tmp_path_factory):
    """Of each model the policy that was made of it, and what was said."""
    folder, found = tmp_path_factory.mktemp("imported"), {}
    for model in sorted(models.glob("*.onnx")):
        policy = folder / f"{model.stem}.safetensors"
        done = vigil("import", model, *options(model), "-o", policy, "--compute", model.with_suffix(".inputs.json"))
        assert done.returncode == 0, f"{model.stem}: {done.stderr}"
        found[model.stem] = policy, done.stdout
    return found


def computed(said):
    return json.loads(said.splitlines()[-1])


def largest_difference(ours, theirs):
    assert len(ours) == len(theirs) == 2
    return max(abs(a - b) / max(1.0, abs(b)) for a, b in zip(ours, theirs))


def test_every_shape_gives_what_onnx_runtime_gives(models, imported):
    theirs = {name: json.loads((models / f"{name}.outputs.json").read_text()) for name in imported}
    found = {name: largest_difference(computed(said), theirs[name]) for name, (_, said) in imported.items()}
    print(found)
    assert len(found) >= 28
    assert max(found.values()) < TOLERANCE, found
    assert all(max(map(abs, output)) > 1e-3 for output in theirs.values()), "an output of nothing shows nothing"
    clipped = ("sb3_with_vec_normalize", "rl_games_a2c_network")
    assert all(min(map(abs, theirs[name])) < 1.0 for name in clipped), "outputs at a bound show only the bound"


def test_what_is_exported_gives_in_onnx_runtime_what_it_gives_here_and_comes_back(models, imported, tmp_path):
    exported = tmp_path / "what is exported"
    exported.mkdir()
    here = {}
    for name, (policy, _) in imported.items():
        inputs = models / f"{name}.inputs.json"
        done = vigil("export", "--actor", policy, "-o", exported / f"{name}.onnx")
        assert done.returncode == 0, done.stderr
        # The very line that it prints brings it back.
        [line] = [line for line in done.stdout.splitlines() if "vigil import" in line]
        words = shlex.split(line.split("vigil ")[1].replace("FILE", str(tmp_path / "back.safetensors")))
        done = vigil(*words, "--compute", inputs)
        assert done.returncode == 0, f"{name}: {done.stderr}"
        here[name] = computed(done.stdout)
        (exported / inputs.name).write_text(inputs.read_text())
    # And our own actor, with noise in front of it and in its memory.
    draw = random.Random(1)
    inputs = [[draw.random() for _ in range(count)] for count in (128 * 256, 328, 8)]
    (exported / "actor.inputs.json").write_text(json.dumps(inputs))
    done = vigil("export", "-o", exported / "actor.onnx", "--compute", exported / "actor.inputs.json")
    assert done.returncode == 0, done.stderr
    here["actor"] = computed(done.stdout)

    run = [PYTHON, Path(__file__).with_name("onnx_run.py"), exported]
    subprocess.run(run, check=True, timeout=120)
    found = {}
    for name, ours in here.items():
        theirs = json.loads((exported / f"{name}.outputs.json").read_text())
        original = models / f"{name}.outputs.json"
        of_original = json.loads(original.read_text()) if original.exists() else theirs
        found[name] = max(largest_difference(ours, theirs), largest_difference(theirs, of_original))
    print(found)
    assert len(found) >= 13 and max(found.values()) < TOLERANCE, found


def test_an_export_that_fails_leaves_what_was_there(models, tmp_path):
    kept = tmp_path / "kept.onnx"
    kept.write_text("an earlier one")
    broken = tmp_path / "broken.safetensors"
    broken.write_bytes(b"no actor")
    inputs = tmp_path / "inputs.json"
    inputs.write_text("[[0.5], [0.1, 0.2]]")
    for more, said in [(["--actor", broken], "broken.safetensors"), (["--compute", inputs], "does not fit the policy")]:
        done = vigil("export", "-o", kept, *more)
        assert done.returncode == 1 and said in done.stderr, done.stderr
        assert kept.read_text() == "an earlier one"
    for command in [["import", broken], ["export", "--actor", broken]]:
        done = vigil(*command, "-o", broken)
        assert done.returncode == 1 and "is read for it" in done.stderr, done.stderr


def test_what_cannot_be_imported_is_refused_with_the_reason_and_nothing_is_written(models, tmp_path):
    words = json.loads((models / "refused.json").read_text())
    assert len(words) >= 44
    kept = tmp_path / "kept.safetensors"
    kept.write_text("an earlier one")
    for name, said in words.items():
        done = vigil("import", models / "refused" / name, "-o", kept)
        assert done.returncode == 1, name
        assert said in done.stderr, (said, done.stderr)
        assert name in done.stderr
        assert kept.read_text() == "an earlier one"
    assert [path.name for path in tmp_path.iterdir()] == ["kept.safetensors"]


LIBRARIES = ["sb3_with_vec_normalize", "rl_games_a2c_network", "rsl_rl_actor_critic", "clean_rl_sac_actor", "layer_normalisation"]
LIBRARIES += ["impala_of_rl_games", "largest_of_each_channel", "rsl_rl_row_of_values"]


@pytest.mark.parametrize("name", [*LIBRARIES, "residual_sums", "curves_of_many_kinds"])
def test_what_libraries_export_is_flown_and_attacked(imported, tmp_path, name):
    policy, said = imported[name]
    assert "split point" in said and "split point      none" not in said, said
    done = vigil("attack", "completion", "--flights", "1", "--iterations", "2", "--actor", policy, "-o", tmp_path / "attack")
    assert done.returncode == 0, done.stderr


def test_an_imported_policy_flies_with_field_and_guard_and_replays_to_the_bit(imported, tmp_path):
    policy = tmp_path / "policy.safetensors"
    policy.write_bytes(imported["goal_beside_the_frame"][0].read_bytes())
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

    # It is attacked as our own actor is; what is made for that alone says so.
    attack = ["attack", "completion", "--flights", "1", "--iterations", "1", "--actor", policy]
    attacked = vigil(*attack, "-o", tmp_path / "attack")
    assert attacked.returncode == 0, attacked.stderr
    refused = vigil("attack", "table", "--actor", policy, "-o", tmp_path / "attack")
    assert refused.returncode == 1 and "attack completion" in refused.stderr
    refused = vigil("rollout", "--actor", policy, "--flights", "1")
    assert refused.returncode == 1 and "vigil policy 1" in refused.stderr

    # One flipped bit, and it does not fly.
    content = bytearray(policy.read_bytes())
    content[-3] ^= 1
    policy.write_bytes(content)
    refused = vigil(*flown, tmp_path / "no.json")
    assert refused.returncode == 1 and "was altered" in refused.stderr and "policy.safetensors" in refused.stderr
