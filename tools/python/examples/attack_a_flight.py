"""Attacks 40 frames of a flight as they pass, and lets the frozen detector look at the explanations. Some seconds."""

import vigil.gym
from vigil.attack import FrameAttack
from vigil.detect import Detector, Monitor
from vigil.policy import Actor

actor, detector = Actor(), Detector()
env = vigil.gym.VigilEnv("validation", frames=1, actor=actor)
monitor, adversary = Monitor(actor, detector), FrameAttack(actor, "bim-accumulating", epsilon=1.0, iterations=20)
observation, _ = env.reset(options={"course_seed": 7})
first, effective = None, 0
for step in range(120):
    frame, position = observation["frames"], observation["position"]
    if 60 <= step < 100:
        attacked = adversary.attack(frame, position)
        frame, effective = attacked.frames, effective + attacked.is_effective
    else:
        adversary.pass_on(frame, position)
    action = actor.decide(frame, position)
    judgement = monitor.judge(actor.state(), actor.low_dim())
    if judgement.attacked and first is None:
        first = step
    observation, _, terminated, truncated, info = env.step(action)
    if terminated or truncated:
        print(f"the flight ended at step {step}: {info['outcome']}")
        break
print(f"attacked from step 60: {effective} frames turned the actor by 30 °/s or more; first alarm at step {first}")
