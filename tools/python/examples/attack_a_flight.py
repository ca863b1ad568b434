"""Attacks 40 frames of a flight as they pass, and lets the frozen detector look at the explanations. Some seconds."""

import vigil.gym
from vigil.attack import FrameAttack
from vigil.detect import Detector, Monitor
from vigil.policy import Actor

env = vigil.gym.VigilEnv("validation", frames=1)
actor, detector = Actor(), Detector()
monitor, adversary = Monitor(actor, detector), FrameAttack(actor, "bim-accumulating", epsilon=1.0, iterations=20)
observation, _ = env.reset(options={"course_seed": 7})
first, effective = None, 0
for step in range(120):
    frame, goal = observation["frames"], observation["goal"]
    if 60 <= step < 100:
        attacked = adversary.attack(frame, goal)
        frame, effective = attacked.frames, effective + attacked.is_effective
    else:
        adversary.pass_on(frame, goal)
    action = actor.decide(frame, goal)
    judgement = monitor.judge(actor.state(), goal)
    if judgement.attacked and first is None:
        first = step
    observation, _, terminated, truncated, info = env.step(action)
    if terminated or truncated:
        print(f"the flight ended at step {step}: {info['outcome']}")
        break
print(f"attacked from step 60: {effective} frames turned the actor by 30 °/s or more; first alarm at step {first}")
