"""What moved the actor's yaw? By the frames, bearing and distance, what it is told besides, then by pixel. Some seconds."""

import numpy as np

import vigil.gym
from vigil.explain import Pixels, SplitPoint
from vigil.policy import Actor

actor = Actor()
env, split_point = vigil.gym.VigilEnv("validation", actor=actor), SplitPoint(actor)
observation, _ = env.reset(options={"course_seed": 7})
backgrounds = []
for step in range(120):
    frames, position = observation["frames"], observation["position"]
    action = actor.decide(frames[-1], position)
    found = split_point.explain(actor.state(), position)
    if step % 20 == 0:
        print(
            f"step {step:3}: yaw {action.yaw:+.2f} = {found.base:+.2f} usually, {found.phi.sum():+.2f} by the frames, "
            f"{found.bearing:+.2f} by the bearing, {found.distance:+.2f} by the distance, {found.told:+.2f} by own velocity and movers"
        )
        backgrounds.append((frames, position))
    observation, *_ = env.step(action)
usual = np.stack([f for f, _ in backgrounds]), np.stack([p for _, p in backgrounds])
found = Pixels(actor, usual).explain(observation["frames"], observation["position"])
frame, row, column = np.unravel_index(np.abs(found.phi).argmax(), found.phi.shape)
metres = observation["frames"][frame, row, column]
print(f"the pixel that counts most: frame {frame} of 5, row {row}, column {column}, at {metres:.1f} m: {found.phi[frame, row, column]:+.4f}")
