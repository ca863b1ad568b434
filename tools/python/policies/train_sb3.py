"""Trains a policy of Stable-Baselines3 (TD3 or SAC on pictures) through ``vigil.gym`` and exports it to ONNX for ``vigil import``.

    tools/python/policies/run.sh train_sb3.py -o runs/sb3 --steps 40000
    vigil import runs/sb3/policy.onnx -o runs/sb3/policy.safetensors --depth contrast

Writes ``curve.csv`` (steps, seconds, completion of courses it is not trained on, return), ``model.zip``, ``best.zip``, ``policy.onnx``.
"""

from __future__ import annotations

import argparse
import csv
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import SAC, TD3
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import OrnsteinUhlenbeckActionNoise
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import DummyVecEnv

import vigil.gym
from frames import OFFSET, PICTURE, POOL, SCALE, STACK, Decisions


# Of a step of 50 ms: a decision holds four.
REWARD = {"decision": -0.005, "dead": -4.0}


class Pictures(BaseFeaturesExtractor):
    """A convolution on the pooled pictures, one dense layer, the goal beside it."""

    def __init__(self, observation_space: Any, features: int = 128) -> None:
        super().__init__(observation_space, features + 2)
        channels, rows, columns = PICTURE
        self.network = torch.nn.Sequential(
            torch.nn.Conv2d(channels, 16, 4, stride=2, padding=1),
            torch.nn.ReLU(),
            torch.nn.Flatten(),
            torch.nn.Linear(16 * (rows // 2) * (columns // 2), features),
            torch.nn.ReLU(),
        )

    def of(self, pictures: torch.Tensor, goal: torch.Tensor) -> torch.Tensor:
        return torch.cat([self.network(pictures), goal], dim=1)

    def forward(self, observed: torch.Tensor) -> torch.Tensor:
        return self.of(observed[:, :-2].reshape(-1, *PICTURE), observed[:, -2:])


class Exported(torch.nn.Module):
    """The deterministic policy on our own frames ``[1, STACK, 128, 256]`` as contrast (0 to 1) and the goal's two inputs: forward speed and
    yaw ``[1, 2]``. The nearest surface is the largest contrast, so pooling is a layer of it."""

    def __init__(self, model: TD3 | SAC) -> None:
        super().__init__()
        self.pool = torch.nn.MaxPool2d(POOL)
        actor = model.actor
        self.features = actor.features_extractor
        self.head = actor.mu if isinstance(model, TD3) else torch.nn.Sequential(actor.latent_pi, actor.mu, torch.nn.Tanh())

    def forward(self, frames: torch.Tensor, goal: torch.Tensor) -> torch.Tensor:
        acted = self.head(self.features.of(self.pool(frames), goal))
        return acted * torch.tensor(SCALE) + torch.tensor(OFFSET)


def export(model: TD3 | SAC, file: Path) -> None:
    """Writes the policy as ONNX."""
    policy = Exported(model).eval()
    example = (torch.zeros(1, STACK, 128, 256), torch.zeros(1, 2))
    torch.onnx.export(policy, example, str(file), input_names=["frames", "goal"], output_names=["action"], dynamo=False)


def completed(model: TD3 | SAC, seeds: range, family: str) -> tuple[float, float]:
    """Share of courses completed, deciding in every step of 50 ms as in flight, and the mean return."""
    env = Decisions(vigil.gym.VigilEnv(family, frames=1, time_limit=60.0), hold=1)
    arrived, returns = 0, 0.0
    for seed in seeds:
        observation, _ = env.reset(options={"course_seed": seed})
        over = False
        while not over:
            action, _ = model.predict(observation, deterministic=True)
            observation, reward, ended, cut, info = env.step(action)
            returns += reward
            over = ended or cut
        arrived += info["is_success"]
    return arrived / len(seeds), returns / len(seeds)


def warm_up(model: TD3 | SAC, decisions: int, seed: int) -> None:
    """Fills the memory with flights of the paper's potential field and noise: noise alone hardly ever arrives anywhere."""
    envs = model.get_env()
    random = np.random.default_rng(seed)
    observed = envs.reset()
    drift = np.zeros((envs.num_envs, 2), np.float32)
    for _ in range(decisions // envs.num_envs):
        drift += 0.3 * (random.standard_normal(drift.shape).astype(np.float32) - 0.5 * drift)
        field = np.stack([(action - OFFSET) / SCALE for action in envs.env_method("field")])
        actions = np.clip(field + drift, -1.0, 1.0).astype(np.float32)
        after, rewards, ends, infos = envs.step(actions)
        next_observed = after.copy()
        for number, ended in enumerate(ends):
            if ended:
                next_observed[number] = infos[number]["terminal_observation"]
        model.replay_buffer.add(observed, next_observed, actions, rewards, ends, infos)
        observed = after


class Curve(BaseCallback):
    """Flies courses now and then, keeps the curve and the best policy."""

    def __init__(self, folder: Path, every: int, flights: int) -> None:
        super().__init__()
        self.folder, self.every, self.flights = folder, every, flights
        self.due = every
        self.best, self.begun = -1.0, time.monotonic()
        self.rows: list[list[float]] = []

    def _on_step(self) -> bool:
        if self.num_timesteps < self.due:
            return True
        self.due += self.every
        cpu = time.process_time()
        training, _ = completed(self.model, range(1_000, 1_000 + self.flights), "training")
        validation, score = completed(self.model, range(1_000, 1_000 + self.flights), "validation")
        self.rows.append([self.num_timesteps, round(time.monotonic() - self.begun, 1), round(cpu, 1), training, validation, round(score, 3)])
        with (self.folder / "curve.csv").open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["steps", "wall_s", "processor_s", "training", "validation", "validation_return"])
            writer.writerows(self.rows)
        print(f"{self.num_timesteps:7} steps  {self.rows[-1][1]:6.0f} s  training {100 * training:.0f} %  validation {100 * validation:.0f} %", flush=True)
        if training + score / 100 >= self.best:
            self.best = training + score / 100
            self.model.save(self.folder / "best.zip")
            export(self.model, self.folder / "policy.onnx")
        return True


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the run")
    parser.add_argument("--algorithm", choices=("td3", "sac"), default="td3")
    parser.add_argument("--steps", type=int, default=40_000, help="decisions of 0.2 s (default 40000)")
    parser.add_argument("--family", default="training", help="family of courses to learn on")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--envs", type=int, default=4, help="flights in turn (default 4)")
    parser.add_argument("--rate", type=float, default=3e-4, help="learning rate (default 3e-4)")
    parser.add_argument("--batch", type=int, default=128)
    parser.add_argument("--memory", type=int, default=60_000, help="decisions kept (default 60000, 1 GB)")
    parser.add_argument("--warm-up", type=int, default=6_000, help="decisions flown by the potential field first")
    parser.add_argument("--evaluate-every", type=int, default=4_000, help="decisions between evaluations")
    parser.add_argument("--flights", type=int, default=40, help="courses an evaluation")
    parser.add_argument("--threads", type=int, default=1, help="of PyTorch")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    arguments.output.mkdir(parents=True, exist_ok=True)
    (arguments.output / "arguments.json").write_text(json.dumps({k: str(v) for k, v in vars(arguments).items() if k != "output"}, indent=1) + "\n")

    def environment(number: int) -> Decisions:
        # Training seeds begin where evaluations never get to.
        return Decisions(vigil.gym.VigilEnv(arguments.family, frames=1, seeds=range(1_000_000 + number, 2_000_000, arguments.envs), time_limit=60.0, reward=REWARD))

    from stable_baselines3.common.monitor import Monitor

    envs = DummyVecEnv([lambda number=number: Monitor(environment(number)) for number in range(arguments.envs)])
    common: dict[str, Any] = dict(
        learning_rate=arguments.rate,
        buffer_size=arguments.memory,
        learning_starts=0,
        batch_size=arguments.batch,
        gamma=0.97,
        n_steps=3,
        train_freq=1,
        gradient_steps=arguments.envs,
        seed=arguments.seed,
        verbose=0,
        policy_kwargs=dict(
            features_extractor_class=Pictures,
            share_features_extractor=True,
            net_arch=dict(pi=[64, 48], qf=[256, 128]),
        ),
    )
    if arguments.algorithm == "td3":
        noise = OrnsteinUhlenbeckActionNoise(np.zeros(2), np.array([0.3, 0.4]), dt=1.0)
        model: TD3 | SAC = TD3("MlpPolicy", envs, action_noise=noise, policy_delay=2, target_policy_noise=0.15, **common)
    else:
        model = SAC("MlpPolicy", envs, ent_coef="auto_0.1", target_entropy=-2.0, **common)
    warm_up(model, arguments.warm_up, arguments.seed)
    model.learn(arguments.steps, callback=Curve(arguments.output, arguments.evaluate_every, arguments.flights))
    model.save(arguments.output / "model.zip")


if __name__ == "__main__":
    main()
