"""Flies a course with the built-in actor through the environment, and leaves a picture of the way. Some seconds.

python3 fly_a_course.py [SEED]
"""

import sys

import vigil.gym
from vigil.policy import Actor

seed = int(sys.argv[1]) if len(sys.argv) > 1 else 7
actor = Actor()
env = vigil.gym.VigilEnv("validation", frames=1, actor=actor, render_mode="rgb_array")
observation, info = env.reset(options={"course_seed": seed})
total, ended = 0.0, False
while not ended:
    action = actor.decide(observation["frames"], observation["position"])
    observation, reward, terminated, truncated, info = env.step(action)
    total, ended = total + reward, terminated or truncated
picture = env.render()
assert picture is not None
with open(f"course-{seed}.ppm", "wb") as file:
    file.write(b"P6 %d %d 255\n" % (picture.shape[1], picture.shape[0]) + picture.tobytes())
print(f"course {seed}: {info['outcome']} after {info['time_s']:.1f} s, reward {total:.1f}; course-{seed}.ppm shows it")
