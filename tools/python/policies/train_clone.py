"""Trains a feed-forward policy on three frames of 64 × 96 pixels to act as our actor does, and exports it to ONNX for ``vigil import``.

    tools/python/policies/run.sh train_clone.py -o runs/clone
    vigil import runs/clone/policy.onnx -o runs/clone/policy.safetensors --depth contrast

DAgger: the policy flies, with some of the teacher's decisions at first, and the teacher says in each step what it would have done.
Writes ``curve.csv`` (a row a round: decisions, loss, completion of courses it is not trained on) and ``policy.onnx`` of the best round.
"""

from __future__ import annotations

import argparse
import csv
import json
import time
from pathlib import Path

import numpy as np
import torch

import vigil.gym
from frames import contrast, goal_inputs
from vigil.policy import Actor

ROWS, COLUMNS, STACK = 64, 96, 3
LIMIT = 1.5


class Policy(torch.nn.Module):
    """Three convolutions, a dense layer, the goal beside it, and one layer more: forward speed and yaw ``[batch, 2]`` within ±1.5."""

    def __init__(self) -> None:
        super().__init__()
        self.eyes = torch.nn.Sequential(
            torch.nn.Conv2d(STACK, 12, 5, stride=2, padding=2),
            torch.nn.ReLU(),
            torch.nn.Conv2d(12, 16, 3, stride=2, padding=1),
            torch.nn.ReLU(),
            torch.nn.Conv2d(16, 24, 3, stride=2, padding=1),
            torch.nn.ReLU(),
            torch.nn.Flatten(),
            torch.nn.Linear(24 * (ROWS // 8) * (COLUMNS // 8), 64),
            torch.nn.ReLU(),
        )
        self.acts = torch.nn.Sequential(torch.nn.Linear(64 + 2, 40), torch.nn.ReLU(), torch.nn.Linear(40, 2), torch.nn.Tanh())

    def forward(self, frames: torch.Tensor, goal: torch.Tensor) -> torch.Tensor:
        return LIMIT * self.acts(torch.cat([self.eyes(frames), goal], dim=1))


class Memory:
    """What was seen and what the teacher would have done. Frames are kept once, as halves."""

    def __init__(self) -> None:
        self.frames: list[np.ndarray] = []
        self.goals: list[np.ndarray] = []
        self.actions: list[tuple[float, float]] = []
        self.stacks: list[list[int]] = []

    def begin(self, frame: np.ndarray) -> list[int]:
        self.frames.append(frame)
        return [len(self.frames) - 1] * STACK

    def batch(self, chosen: np.ndarray) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        frames = np.stack([np.stack([self.frames[i] for i in self.stacks[j]]) for j in chosen]).astype(np.float32)
        goals = np.stack([self.goals[j] for j in chosen])
        actions = np.array([self.actions[j] for j in chosen], np.float32)
        return torch.from_numpy(frames), torch.from_numpy(goals), torch.from_numpy(actions)


def seen(frame_m: np.ndarray) -> np.ndarray:
    """``[128, 256]`` metres to ``[64, 96]`` contrast: the middle of each pixel, as an imported policy gets it in flight."""
    rows = (2 * np.arange(ROWS) + 1) * frame_m.shape[0] // (2 * ROWS)
    columns = (2 * np.arange(COLUMNS) + 1) * frame_m.shape[1] // (2 * COLUMNS)
    return contrast(frame_m[rows[:, None], columns[None, :]]).astype(np.float16)


@torch.no_grad()
def decided(policy: Policy, memory: Memory, stack: list[int], goal: np.ndarray) -> np.ndarray:
    frames = torch.from_numpy(np.stack([memory.frames[i] for i in stack]).astype(np.float32))
    return policy(frames[None], torch.from_numpy(goal)[None])[0].numpy()


def fly(
    policy: Policy,
    family: str,
    courses: range,
    teacher: Actor | None = None,
    taught_by: tuple[Memory, float, np.random.Generator] | None = None,
) -> float:
    """Share of courses that the policy completes: alone, or with the teacher for a share of the stretches, whose decisions are remembered."""
    env = vigil.gym.VigilEnv(family, frames=1, actor=teacher, time_limit=60.0)
    arrived = 0
    for course in courses:
        observation, _ = env.reset(options={"course_seed": course})
        memory, teachers_share, random = taught_by or (Memory(), 0.0, None)
        stack, over, taught, step = memory.begin(seen(observation["frames"])), False, False, 0
        if teacher is not None:
            teacher.reset()
        while not over:
            goal = goal_inputs(observation["goal"])
            if teacher is not None:
                right = teacher.decide(observation["frames"], observation["position"])
                memory.goals.append(goal)
                memory.actions.append(tuple(right))
                memory.stacks.append(stack)
                if step % 40 == 0:
                    taught = random.random() < teachers_share
            step += 1
            action = tuple(right) if taught else decided(policy, memory, stack, goal)
            observation, _, ended, cut, info = env.step(action)
            over = ended or cut
            memory.frames.append(seen(observation["frames"]))
            stack = [*stack[1:], len(memory.frames) - 1]
        arrived += info["is_success"]
    return arrived / len(courses)


def learn(policy: Policy, memory: Memory, updates: int, batch: int, rate: float, random: np.random.Generator) -> float:
    """Mean loss of the last quarter of the updates."""
    optimiser = torch.optim.Adam(policy.parameters(), lr=rate)
    falling = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, updates)
    losses = []
    for _ in range(updates):
        frames, goals, actions = memory.batch(random.integers(0, len(memory.stacks), batch))
        loss = torch.nn.functional.smooth_l1_loss(policy(frames, goals), actions)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        falling.step()
        losses.append(float(loss.detach()))
    return float(np.mean(losses[-updates // 4 :]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the run")
    parser.add_argument("--teacher", help="file of the actor that teaches (default: the built-in one)")
    parser.add_argument("--rounds", type=int, default=6)
    parser.add_argument("--courses", type=int, default=50, help="courses a round (default 50)")
    parser.add_argument("--updates", type=int, default=1500, help="updates a round (default 1500)")
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--rate", type=float, default=1e-3, help="learning rate (default 1e-3)")
    parser.add_argument("--flights", type=int, default=24, help="courses an evaluation")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=1, help="of PyTorch")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    torch.manual_seed(arguments.seed)
    random = np.random.default_rng(arguments.seed)
    arguments.output.mkdir(parents=True, exist_ok=True)
    kept = {name: value for name, value in vars(arguments).items() if name != "output"}
    (arguments.output / "arguments.json").write_text(json.dumps(kept, indent=1) + "\n")
    policy, teacher, memory = Policy(), Actor(arguments.teacher), Memory()
    begun, best, rows = time.monotonic(), -1.0, []
    for number in range(arguments.rounds):
        first = 1_000_000 + number * arguments.courses
        share = 1.0 if number == 0 else max(0.0, 0.5 - 0.15 * (number - 1))
        flown = fly(policy, "training", range(first, first + arguments.courses), teacher, (memory, share, random))
        loss = learn(policy, memory, arguments.updates, arguments.batch, arguments.rate, random)
        validation = fly(policy, "validation", range(1_000, 1_000 + arguments.flights))
        rows.append([number + 1, len(memory.stacks), round(time.monotonic() - begun, 1), round(time.process_time(), 1), flown, round(loss, 5), validation])
        with (arguments.output / "curve.csv").open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["round", "decisions", "wall_s", "processor_s", "flown", "loss", "validation"])
            writer.writerows(rows)
        print(f"round {number + 1}  {rows[-1][2]:6.0f} s  flown {100 * flown:.0f} %  loss {loss:.4f}  validation {100 * validation:.0f} %", flush=True)
        if validation >= best:
            best = validation
            example = (torch.zeros(1, STACK, ROWS, COLUMNS), torch.zeros(1, 2))
            torch.onnx.export(policy, example, str(arguments.output / "policy.onnx"), input_names=["frames", "goal"], output_names=["action"], dynamo=False)


if __name__ == "__main__":
    main()
