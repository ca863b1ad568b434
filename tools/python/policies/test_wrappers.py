"""Checks that Stable-Baselines3 and TorchRL take our environments as they are, without a warning: their checkers, rollouts, short training.

    tools/python/policies/run.sh test_wrappers.py

Ends with the number of checks passed, about a minute later; a check that fails says what differs.
"""

from __future__ import annotations

import time
import warnings

import gymnasium
import numpy as np
import torch
from gymnasium.utils.env_checker import check_env as check_of_gymnasium
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.env_checker import check_env as check_of_sb3
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor
from tensordict.nn import TensorDictModule
from torchrl.envs import GymEnv, GymWrapper
from torchrl.envs.utils import check_env_specs

import vigil.gym
from vigil.sb3 import VigilVecEnv

SHORT = {"frames": 1, "time_limit": 0.6, "seeds": range(100)}
ACTIONS = np.random.default_rng(3).uniform(-1.0, 1.0, (40, 3, 2)).astype(np.float32)


def same(a: object, b: object) -> None:
    """Dicts of arrays, equal to the bit and of one kind."""
    assert isinstance(a, dict) and isinstance(b, dict) and a.keys() == b.keys()
    for name in a:
        assert np.asarray(a[name]).dtype == np.asarray(b[name]).dtype
        np.testing.assert_array_equal(a[name], b[name])


def check_the_checkers_of_gymnasium_and_sb3() -> None:
    for frames in (1, 5):
        env = gymnasium.make("VigilImages-v0", frames=frames, render_mode="rgb_array")
        check_of_gymnasium(env.unwrapped)
        check_of_sb3(env)
        check_of_gymnasium(gymnasium.make("VigilNormalized-v0", frames=frames, render_mode="rgb_array").unwrapped)
    # Ranges are no images: Stable-Baselines3 recommends to make one row of them.
    check_of_sb3(gymnasium.wrappers.FlattenObservation(gymnasium.make("VigilNormalized-v0", frames=1)))


def check_our_vec_env_gives_what_sb3s_own_gives() -> None:
    for images in (True, False):
        options = {**SHORT, "images": images}
        ours = VigilVecEnv(3, "validation", threads=2, **options)
        theirs = DummyVecEnv([lambda: vigil.gym.VigilEnv("validation", normalized=True, **options) for _ in range(3)])
        for envs in (ours, theirs):
            envs.seed(5)
        same(ours.reset(), theirs.reset())
        ends = 0
        for actions in ACTIONS:
            (seen, rewards, ended, infos), (expected, *outs, others) = ours.step(actions), theirs.step(actions)
            same(seen, expected)
            same({"rewards": rewards, "ended": ended}, dict(zip(("rewards", "ended"), outs)))
            for info, other, end in zip(infos, others, ended):
                assert info["TimeLimit.truncated"] == other["TimeLimit.truncated"]
                if end:
                    same(info["terminal_observation"], other["terminal_observation"])
                    assert info["outcome"] == other["outcome"] and info["is_success"] == other["is_success"]
            ends += ended.sum()
        assert ends == 9, ends
        assert [info["course_seed"] for info in ours.reset_infos] == [info["course_seed"] for info in theirs.reset_infos]


def check_what_our_vec_env_does_not_take_is_refused() -> None:
    envs = VigilVecEnv(2, threads=1, **SHORT)
    assert envs.get_attr("num_envs") == [2, 2] and envs.env_is_wrapped(VecMonitor, [0]) == [False]
    envs.set_options({"course_seed": 7})
    for refused, error, said in (
        (lambda: VigilVecEnv(2, autoreset_mode="NextStep"), ValueError, "autoreset_mode"),
        (lambda: VigilVecEnv(2, buffers={}), ValueError, "buffers"),
        (envs.reset, ValueError, "takes none"),
        (lambda: envs.env_method("potential_field"), NotImplementedError, "one object"),
        (lambda: envs.set_attr("wind", 3.0), NotImplementedError, "one object"),
    ):
        try:
            refused()
        except error as told:
            assert said in str(told), told
        else:
            raise AssertionError(f"{said}: was taken")


def trained(model: PPO | SAC, steps: int) -> None:
    """The policy has learned something, whatever it is, and decides."""
    before = [value.clone() for value in model.policy.parameters()]
    model.learn(steps)
    after = list(model.policy.parameters())
    assert all(torch.isfinite(value).all() for value in after)
    assert any(not torch.equal(x, y) for x, y in zip(before, after))
    assert model.ep_info_buffer, "no flight has ended"
    action, _ = model.predict(model.get_env().reset(), deterministic=True)
    assert np.abs(action).max() <= 1.0


def check_sb3_trains_on_flights_side_by_side() -> None:
    envs = VecMonitor(VigilVecEnv(4, threads=1, **SHORT))
    trained(PPO("MultiInputPolicy", envs, n_steps=32, batch_size=32, n_epochs=1, seed=1), 256)
    envs = VecMonitor(VigilVecEnv(4, threads=1, images=False, every=4, **SHORT))
    trained(SAC("MultiInputPolicy", envs, buffer_size=500, learning_starts=40, batch_size=16, train_freq=8, seed=1), 400)


def check_sb3_trains_on_the_registered_environments() -> None:
    env = gymnasium.make("VigilNormalized-v0", **SHORT)
    trained(SAC("MultiInputPolicy", env, buffer_size=300, learning_starts=40, batch_size=16, train_freq=8, seed=1), 200)
    env = gymnasium.make("VigilImages-v0", **SHORT)
    trained(PPO("MultiInputPolicy", env, n_steps=64, batch_size=32, n_epochs=1, seed=1), 128)


def check_torchrl_flies_one() -> None:
    for name in ("VigilNormalized-v0", "VigilImages-v0"):
        for frames in (1, 5):
            check_env_specs(GymEnv(name, frames=frames))
    check_env_specs(GymWrapper(vigil.gym.VigilEnv(privileged=True, copy=True)))
    env = GymWrapper(gymnasium.make("VigilNormalized-v0", **SHORT))
    flown = env.rollout(40, break_when_any_done=False)
    assert flown["next", "truncated"].sum() == 3 and flown.shape == (40,)
    assert flown["frames"].dtype == torch.float32 and 0.0 <= flown["frames"].min() and flown["frames"].max() == 1.0


def check_torchrl_flies_several_side_by_side() -> None:
    def made(count: int) -> GymWrapper:
        env = vigil.gym.VigilVectorEnv(count, "validation", normalized=True, copy=True, autoreset_mode="Disabled", **SHORT)
        return GymWrapper(env)

    check_env_specs(made(3))
    env = made(3)
    env.set_seed(4)
    fixed = iter(ACTIONS)
    policy = TensorDictModule(lambda goal: torch.from_numpy(next(fixed)), in_keys=["goal"], out_keys=["action"])
    flown = env.rollout(40, break_when_any_done=False, policy=policy)
    assert flown.shape == (3, 40) and flown["next", "truncated"].sum() == 9
    # What they fly is what the environment flies without TorchRL.
    plain = vigil.gym.VigilVectorEnv(3, "validation", normalized=True, copy=True, autoreset_mode="SameStep", **SHORT)
    # A rollout resets once more, without a seed.
    plain.reset(seed=4)
    seen, _ = plain.reset()
    for step, actions in enumerate(ACTIONS):
        for name in ("frames", "goal"):
            np.testing.assert_array_equal(flown[name][:, step].numpy(), seen[name])
        seen, rewards, _, truncated, info = plain.step(actions)
        np.testing.assert_array_equal(flown["next", "reward"][:, step, 0].numpy(), rewards.astype(np.float32))
        for i in np.flatnonzero(truncated):
            np.testing.assert_array_equal(flown["next", "frames"][i, step].numpy(), info["final_obs"][i]["frames"])


def main() -> None:
    torch.set_num_threads(1)
    warnings.simplefilter("error")
    checks = [check for name, check in globals().items() if name.startswith("check_") and check.__module__ == __name__]
    for check in checks:
        begun = time.monotonic()
        check()
        print(f"{check.__name__.replace('_', ' ')}: {time.monotonic() - begun:.0f} s", flush=True)
    print(f"{len(checks)} passed, 0 failed")


if __name__ == "__main__":
    main()
