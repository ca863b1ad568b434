"""What moved the actor's yaw? The frames, bearing and distance, own motion; then the newest frame's pixels and the memory. Some seconds."""

import numpy as np

import vigil.gym
from vigil.explain import Pixels, SplitPoint
from vigil.policy import Actor

actor = Actor()
env, split_point = vigil.gym.VigilEnv("validation", frames=1, actor=actor), SplitPoint(actor)
observation, _ = env.reset(options={"course_seed": 7})
backgrounds = []
for step in range(120):
    frame = observation["frames"]
    action = actor.decide(frame, observation["position"])
    found = split_point.explain(actor.state(), actor.low_dim())
    if step % 20 == 0:
        print(
            f"step {step:3}: yaw {action.yaw:+.2f} = {found.base:+.2f} usually, {found.phi.sum():+.2f} by the frames, "
            f"{found.bearing:+.2f} by the bearing, {found.distance:+.2f} by the distance, {found.told:+.2f} by own motion"
        )
        backgrounds.append((frame, actor.context(), actor.low_dim()))
    observation, *_ = env.step(action)
usual = tuple(np.stack(given) for given in zip(*backgrounds))
found = Pixels(actor, usual).explain(frame, actor.context(), actor.low_dim())
row, column = np.unravel_index(np.abs(found.phi).argmax(), found.phi.shape)
print(f"the last frame: {found.phi.sum():+.2f}, what is remembered: {found.memory:+.2f}")
print(f"the pixel that counts most: row {row}, column {column}, at {frame[row, column]:.1f} m: {found.phi[row, column]:+.4f}")
