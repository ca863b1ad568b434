"""What the tests of the Python package share. `tests/python/run.sh` installs the package into target/venv-package."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

import vigil.gym

HERE = Path(__file__).resolve().parent
TOP = HERE.parents[2]
VIGIL = TOP / "target" / "release" / "vigil"


@pytest.fixture(scope="session")
def flown():
    """A flight's first 40 steps by the built-in actor: frames `[40, 5, 128, 256]`, goals, positions, states and actions; what the actor
    held beside each frame: context and low-dimensional observation."""
    from vigil.policy import Actor

    actor = Actor()
    env = vigil.gym.VigilEnv("validation", actor=actor)
    observation, _ = env.reset(options={"course_seed": 7})
    frames, goals, positions, states, actions, held = [], [], [], [], [], []
    for _ in range(40):
        action = actor.decide(observation["frames"][-1], observation["position"])
        frames.append(observation["frames"])
        goals.append(observation["goal"])
        positions.append(observation["position"])
        states.append(actor.state())
        actions.append(action)
        held.append((actor.context(), actor.low_dim()))
        observation, *_ = env.step(action)
    return np.stack(frames), np.stack(goals), np.stack(positions), np.stack(states), actions, held


@pytest.fixture(scope="session")
def policies(tmp_path_factory):
    """Imported policies, by the name of their shape."""
    folder = tmp_path_factory.mktemp("policies") / "models"
    python = TOP / "target" / "venv-onnx" / "bin" / "python"
    subprocess.run([python, HERE.parent / "onnx_models.py", folder], check=True, timeout=120)
    found = {}
    for name in ("goal_beside_the_frame", "three_channels_last", "gru", "at_its_limit"):
        found[name] = folder / f"{name}.safetensors"
        subprocess.run([VIGIL, "import", folder / f"{name}.onnx", "-o", found[name]], check=True, timeout=120)
    return found
