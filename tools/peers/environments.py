"""Steps per second of our Gymnasium environment beside others with a camera: one process, one run, taken in turns (docs/python.md).

tools/peers/environments.sh [--seconds N] [--only NAME]; writes JSON to standard output.
"""

import argparse
import json
import os
import statistics
import time

import numpy as np


def vigil(frames):
    import vigil.gym

    env = vigil.gym.VigilEnv("validation", frames=frames, seeds=range(1000))
    env.reset(seed=1)

    def step():
        _, _, terminated, truncated, _ = env.step([0.7, 0.1])
        if terminated or truncated:
            env.reset()

    return step, 1


def vigil_vector(count, threads, frames=1, every=1):
    import vigil.gym

    env = vigil.gym.VigilVectorEnv(count, "validation", frames=frames, every=every, threads=threads, seeds=range(1000))
    env.reset(seed=1)
    actions = np.tile(np.array([0.7, 0.1], np.float32), (count, 1))
    return lambda: env.step(actions), count


def pyflyt():
    """A quadrotor in PyBullet with a depth picture of 128 × 256 pixels in each step of 50 ms, software rendering."""
    from PyFlyt.core import Aviary

    options = dict(use_camera=True, camera_resolution=(128, 256), camera_FOV_degrees=120, camera_fps=20)
    aviary = Aviary(np.array([[0.0, 0.0, 1.5]]), np.zeros((1, 3)), drone_type="quadx", drone_options=options, seed=1)
    aviary.set_mode(7)
    columns(aviary)

    def step():
        # Its control runs at 120 Hz: six of its steps are 50 ms, after which the camera has taken one picture.
        for _ in range(int(round(0.05 / aviary.step_period))):
            aviary.step()
        assert aviary.drones[0].depthImg.size == 128 * 256

    return step, 1


def columns(client):
    """Thirty upright cylinders, as many solids as a course of ours has."""
    random = np.random.default_rng(7)
    visual = client.createVisualShape(client.GEOM_CYLINDER, radius=0.4, length=4.0)
    solid = client.createCollisionShape(client.GEOM_CYLINDER, radius=0.4, height=4.0)
    for x, y in random.uniform([3.0, -8.0], [25.0, 8.0], (30, 2)):
        client.createMultiBody(0, solid, visual, [x, y, 2.0])
    if hasattr(client, "register_all_new_bodies"):
        client.register_all_new_bodies()


def pybullet_alone():
    """PyBullet's physics at 240 Hz and its software picture, nothing else: what gym-pybullet-drones makes its pictures of."""
    import pybullet
    from pybullet_utils.bullet_client import BulletClient

    client = BulletClient(pybullet.DIRECT)
    client.setTimeStep(1.0 / 240.0)
    columns(client)
    view = client.computeViewMatrix([0.0, 0.0, 1.5], [1.0, 0.0, 1.5], [0.0, 0.0, 1.0])
    projection = client.computeProjectionMatrixFOV(60.0, 2.0, 0.1, 100.0)

    def step():
        for _ in range(12):
            client.stepSimulation()
        flags = client.ER_NO_SEGMENTATION_MASK
        depth = client.getCameraImage(256, 128, view, projection, flags=flags)[3]
        assert np.asarray(depth).size == 128 * 256

    return step, 1


def mujoco(rays):
    """MuJoCo's physics at 200 Hz of a free body with four thrusts, and in each step of 50 ms a depth picture of 128 × 256 pixels, rendered in
    software by OpenGL, or (rays) the ranges of 64 × 256 rays to its solids, as many as our LiDAR has."""
    os.environ.setdefault("MUJOCO_GL", "egl")
    import mujoco

    places = np.random.default_rng(7).uniform([3.0, -8.0], [25.0, 8.0], (30, 2))
    solids = "".join(f'<geom type="cylinder" size="0.4 2" pos="{x} {y} 2"/>' for x, y in places)
    arms = [(x, y) for x in (-0.15, 0.15) for y in (-0.15, 0.15)]
    sites = "".join(f'<site name="s{i}" pos="{x} {y} 0"/>' for i, (x, y) in enumerate(arms))
    motors = "".join(f'<motor site="s{i}" gear="0 0 1 0 0 {(-1) ** (i in (1, 2)) * 0.01}"/>' for i in range(4))
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="0.005"/><visual><global offwidth="256" offheight="128"/></visual><worldbody><light pos="0 0 10"/>
        <geom type="plane" size="50 50 1"/>{solids}<body name="vehicle" pos="0 0 1.5"><freejoint/><geom type="box" size="0.15 0.15 0.05" mass="1"/>
        {sites}<camera name="depth" pos="0.2 0 0" xyaxes="0 -1 0 0 0 1" fovy="60"/></body></worldbody><actuator>{motors}</actuator></mujoco>"""
    )
    data, body = mujoco.MjData(model), model.body("vehicle").id
    data.ctrl[:] = 9.81 / 4.0
    up, right = np.meshgrid(np.radians(np.linspace(30, -30, 64)), np.radians(np.linspace(-60, 60, 256)), indexing="ij")
    ways = np.stack([np.cos(up) * np.cos(right), -np.cos(up) * np.sin(right), np.sin(up)], axis=-1).reshape(-1, 3)
    ranges, solid = np.zeros(len(ways)), np.zeros(len(ways), np.int32)
    renderer = None if rays else mujoco.Renderer(model, 128, 256)
    if renderer:
        renderer.enable_depth_rendering()

    def step():
        mujoco.mj_step(model, data, nstep=10)
        if renderer:
            renderer.update_scene(data, camera="depth")
            depth = renderer.render()
        else:
            turned = np.ascontiguousarray(ways @ data.xmat[body].reshape(3, 3).T)
            mujoco.mj_multiRay(model, data, data.xpos[body], turned.ravel(), None, True, body, solid, ranges, None, len(ways), 100.0)
            depth = ranges
        assert depth.size == (64 if rays else 128) * 256 and abs(data.qpos[2] - 1.5) < 0.2

    return step, 1


SUBJECTS = {
    "Vigil, newest frame": lambda: vigil(1),
    "Vigil, five frames": lambda: vigil(5),
    "Vigil, 8 flights, 1 thread": lambda: vigil_vector(8, 1),
    "Vigil, 8 flights, 2 threads": lambda: vigil_vector(8, 2),
    "Vigil, 8 flights, five frames, 2 threads": lambda: vigil_vector(8, 2, 5),
    "Vigil, 32 flights, 1 thread": lambda: vigil_vector(32, 1),
    "Vigil, 32 flights, 2 threads": lambda: vigil_vector(32, 2),
    "Vigil, 64 flights, 1 thread": lambda: vigil_vector(64, 1),
    "Vigil, 64 flights, 2 threads": lambda: vigil_vector(64, 2),
    "Vigil, 64 flights, 1 thread, every fourth beam": lambda: vigil_vector(64, 1, every=4),
    "PyFlyt": pyflyt,
    "PyBullet alone": pybullet_alone,
    "MuJoCo, rendered": lambda: mujoco(False),
    "MuJoCo, rays": lambda: mujoco(True),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=2.0, help="of each turn")
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--only", default="", help="subjects whose name holds this")
    arguments = parser.parse_args()
    # PyBullet writes to standard output.
    output = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    subjects, rates, cpu, missing = {}, {}, {}, {}
    for name, make in ((name, make) for name, make in SUBJECTS.items() if arguments.only in name):
        try:
            subjects[name] = make()
            subjects[name][0]()
        except Exception as e:  # noqa: BLE001, whatever keeps a peer from running is told
            missing[name] = f"{type(e).__name__}: {e}".splitlines()[0]
    for _ in range(arguments.turns):
        for name, (step, count) in subjects.items():
            steps, begun, worked = 0, time.perf_counter(), time.process_time()
            while time.perf_counter() - begun < arguments.seconds:
                step()
                steps += count
            rates.setdefault(name, []).append(steps / (time.perf_counter() - begun))
            cpu.setdefault(name, []).append(steps / (time.process_time() - worked))
    found = {
        name: {
            "steps_per_second": round(statistics.median(rates[name]), 1),
            "steps_per_processor_second": round(statistics.median(cpu[name]), 1),
            "turns": [round(r, 1) for r in rates[name]],
            "turns_of_processor_time": [round(r, 1) for r in cpu[name]],
        }
        for name in subjects
    }
    json.dump({"measured": found, "not_run": missing}, output, indent=2)
    print(file=output)


if __name__ == "__main__":
    main()
