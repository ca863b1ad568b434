"""Trains LSTM-AD on explanations of flights that are attacked in their second half. About half a minute."""

import numpy as np

import vigil.gym
from vigil.attack import FrameAttack
from vigil.detect import train
from vigil.explain import SplitPoint
from vigil.policy import Actor

STEPS = 80


def fly(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The explanations of a flight ``[steps, 48]``, and which decisions were made on an attacked frame."""
    actor = Actor()
    env = vigil.gym.VigilEnv("training", frames=1, actor=actor)
    explain, adversary = SplitPoint(actor), FrameAttack(actor, iterations=4)
    observation, _ = env.reset(options={"course_seed": seed})
    rows, attacked = [], []
    for step in range(STEPS):
        frame, position = observation["frames"], observation["position"]
        attacked.append(step >= STEPS // 2)
        if attacked[-1]:
            frame = adversary.attack(frame, position).frames
        else:
            adversary.pass_on(frame, position)
        action = actor.decide(frame, position)
        rows.append(explain.explain(actor.state(), actor.low_dim()).phi)
        observation, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            break
    return np.stack(rows), np.array(attacked)


trained = train([fly(seed) for seed in range(6)], [fly(seed) for seed in range(6, 8)], epochs=3)
for epoch, (loss, choosing, accuracy) in enumerate(trained.epochs, 1):
    print(f"epoch {epoch}: loss {loss:.3f}, on flights that choose {choosing:.3f}, {100 * accuracy:.1f} % right")
rows, attacked = fly(8)
scores = trained.lstm.scores(rows)
for name, of in [("unattacked", ~attacked), ("attacked", attacked)]:
    print(f"{name} steps of a new flight: mean score {np.nanmean(scores[of]):.3f}")
