"""`vigil.gym`: Gymnasium's own check, the same bits for the same seed, frames that stay true, errors."""

import os
import signal
import threading
import time
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import vigil.gym
from vigil.gym import VigilEnv, VigilVectorEnv

ACTIONS = np.random.default_rng(3).uniform(-1.5, 1.5, (60, 2)).astype(np.float32)


def steps(env, count=60, **reset):
    """Observations, rewards and ends of a flight under fixed actions."""
    observation, info = env.reset(**reset)
    seen = [({k: v.copy() for k, v in observation.items()}, 0.0, False, False)]
    for action in ACTIONS[:count]:
        observation, reward, terminated, truncated, info = env.step(action)
        seen.append(({k: v.copy() for k, v in observation.items()}, reward, terminated, truncated))
        if terminated or truncated:
            break
    return seen


def same(a, b):
    assert len(a) == len(b)
    for (x, *others), (y, *more) in zip(a, b):
        assert others == more
        assert x.keys() == y.keys()
        for name in x:
            np.testing.assert_array_equal(x[name], y[name])


@pytest.mark.parametrize("frames", [1, 5])
@pytest.mark.parametrize(
    ("name", "privileged"), [("Vigil-v0", False), ("Vigil-v0", True), ("VigilNormalized-v0", False), ("VigilImages-v0", False)]
)
def test_gymnasium_finds_nothing_wrong(frames, name, privileged):
    env = gymnasium.make(name, frames=frames, privileged=privileged, render_mode="rgb_array", disable_env_checker=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if name == "Vigil-v0":
            # Gymnasium recommends actions of ±1; ours are the paper's, and gymnasium.wrappers.RescaleAction makes the others.
            warnings.filterwarnings("ignore", ".*symmetric and normalized space.*")
            # The goal's distance and the true state have no end.
            warnings.filterwarnings("ignore", ".*Box observation space (maximum|minimum) value is .*infinity.*")
        check_env(env.unwrapped)


def test_the_registered_id_with_spaces_of_one_flies_the_same_flight_in_other_units():
    env = gymnasium.make("VigilNormalized-v0", frames=1, disable_env_checker=True)
    for space in (env.action_space, *env.observation_space.spaces.values()):
        assert space.is_bounded() and space.low.min() >= -1.0 and space.high.max() == 1.0
    plain, unit = VigilEnv("validation", frames=1), VigilEnv("validation", frames=1, normalized=True)
    (seen, _), (scaled, _) = (e.reset(options={"course_seed": 7}) for e in (plain, unit))
    np.testing.assert_allclose(unit.potential_field() * 1.5, plain.potential_field(), atol=1e-6)
    # Eighths: what is scaled to the whole action and back is the same number. Every second one is beyond it, where both clip it.
    for action in np.round(16.0 * ACTIONS / 1.5).astype(np.float32) / np.float32(8.0):
        # Metres are the normalised range times 100, once rounded: back again it is the same number but for that.
        np.testing.assert_array_equal(scaled["frames"] * np.float32(100.0), seen["frames"])
        distance_m, bearing = seen["goal"]
        np.testing.assert_allclose(scaled["goal"], [min(distance_m / 20.0, 1.0), bearing / np.pi], atol=1e-6)
        assert unit.observation_space.contains(scaled)
        seen, reward, *_ = plain.step(action * np.float32(1.5))
        scaled, again, *_ = unit.step(action)
        assert reward == again
    vector = gymnasium.make_vec("VigilNormalized-v0", num_envs=2, vectorization_mode="vector_entry_point", frames=1)
    observation, _ = vector.reset(seed=np.int64(1))
    assert vector.observation_space.contains(observation) and vector.single_action_space.high.max() == 1.0
    assert vector.np_random_seed == 1


def test_images_are_the_contrast_of_the_frames():
    for frames in (1, 5):
        metres, units = VigilEnv("validation", frames=frames), VigilEnv("validation", frames=frames, images=True)
        (seen, _), (pictured, _) = (e.reset(options={"course_seed": 7}) for e in (metres, units))
        for action in ACTIONS[:10]:
            images = pictured["frames"]
            assert images.shape == (frames, 128, 256) and images.dtype == np.uint8 and units.observation_space.contains(pictured)
            expected = 255.0 / (1.0 + seen["frames"].astype(np.float64) / 3.0)
            assert np.abs(images - expected).max() < 0.501
            np.testing.assert_array_equal(pictured["goal"], seen["goal"])
            (seen, *_), (pictured, *_) = metres.step(action), units.step(action)
    vector = VigilVectorEnv(2, frames=1, normalized=True, images=True, threads=1)
    observation, _ = vector.reset(seed=1)
    assert vector.observation_space.contains(observation) and observation["frames"].shape == (2, 1, 128, 256)


def test_copies_of_frames_can_be_written_to_and_change_nothing():
    plain, copied = VigilEnv("validation"), VigilEnv("validation", copy=True)
    (seen, _), (own, _) = (env.reset(options={"course_seed": 7}) for env in (plain, copied))
    for action in ACTIONS[:10]:
        np.testing.assert_array_equal(seen["frames"], own["frames"])
        own["frames"][...] = 0.0
        (seen, *_), (own, *_) = plain.step(action), copied.step(action)
    observation, _ = gymnasium.make("VigilNormalized-v0", frames=1).reset(seed=1)
    assert observation["frames"].flags.writeable


def flown(mode, steps, **options):
    """Two flights under fixed actions: what each step gave."""
    env = VigilVectorEnv(2, "validation", frames=1, threads=1, autoreset_mode=mode, **options)
    observation, _ = env.reset(seed=3)
    seen = [(observation, None, None, {})]
    for step in range(steps):
        observation, rewards, terminated, truncated, info = env.step(np.tile(ACTIONS[step % 60], (2, 1)))
        seen.append((observation, rewards, terminated | truncated, info))
        if mode == "Disabled" and seen[-1][2].any():
            break
    return env, seen


def test_a_flight_that_ended_begins_anew_in_the_same_step_where_that_is_wanted():
    _, later = flown("NextStep", 25, time_limit=1.0)
    env, seen = flown("SameStep", 25, time_limit=1.0)
    assert env.metadata["autoreset_mode"] is gymnasium.vector.AutoresetMode.SAME_STEP
    # Until the end both are one; there the last observation is beside the first of the new flight.
    end = next(i for i, step in enumerate(seen) if i and step[2].any())
    assert seen[end][2].all() and later[end][2].all()
    info = seen[end][3]
    assert info["_final_obs"].all() and info["final_info"]["outcome"].tolist() == ["time-out"] * 2
    assert info["_course_seed"].all() and info["course_seed"].tolist() == env.course_seeds
    assert info["final_info"]["course_seed"].tolist() == seen[end - 1][3]["course_seed"].tolist() != env.course_seeds
    for number in range(2):
        for name in ("frames", "goal"):
            np.testing.assert_array_equal(info["final_obs"][number][name], later[end][0][name][number])
            # What the next step gives where it begins anew there.
            np.testing.assert_array_equal(seen[end][0][name][number], later[end + 1][0][name][number])
    # From then on it is one step ahead, and flies on.
    assert not seen[end + 1][2].any() and "final_obs" not in seen[end + 1][3]
    for step in seen:
        assert env.observation_space.contains(step[0])


def test_a_flight_that_ended_waits_for_its_reset_where_none_is_wanted_and_the_others_fly_on():
    env, seen = flown("Disabled", 25, time_limit=1.0)
    with pytest.raises(ValueError, match="flights 0, 1 have ended: reset.*reset_mask"):
        env.step(np.zeros((2, 2), np.float32))
    mask = np.array([True, False])
    before = seen[-1][0]
    kept = {name: value.copy() for name, value in before.items()}
    observation, _ = env.reset(seed=[9, 9], options={"reset_mask": mask})
    for name in ("frames", "goal"):
        np.testing.assert_array_equal(observation[name][1], kept[name][1])
        np.testing.assert_array_equal(before[name][1], kept[name][1])
        assert not np.array_equal(observation[name][0], kept[name][0])
    with pytest.raises(ValueError, match="flights 1 have ended"):
        env.step(np.zeros((2, 2), np.float32))
    env.reset(options={"reset_mask": ~mask})
    # The first is the flight that it would be alone with this seed, step by step.
    alone = VigilVectorEnv(1, "validation", frames=1, time_limit=1.0, autoreset_mode="Disabled")
    single, _ = alone.reset(seed=9)
    np.testing.assert_array_equal(single["frames"][0], observation["frames"][0])
    for action in ACTIONS[:5]:
        both, *_ = env.step(np.tile(action, (2, 1)))
        single, *_ = alone.step(action[None])
        np.testing.assert_array_equal(single["frames"][0], both["frames"][0])
    for wrong in (np.array([1, 0]), np.array([True]), np.zeros(2, bool)):
        with pytest.raises(ValueError, match="reset_mask: 2 of bool"):
            env.reset(options={"reset_mask": wrong})
    with pytest.raises(ValueError, match="there is reset_mask, not course_seed"):
        env.reset(options={"course_seed": 3})
    with pytest.raises(ValueError):
        VigilVectorEnv(2, autoreset_mode="sometimes")


def test_a_seed_decides_a_flight_to_the_bit():
    first = steps(VigilEnv(privileged=True, wind=3.0, noise=2.0), seed=11)
    same(first, steps(VigilEnv(privileged=True, wind=3.0, noise=2.0), seed=11))
    other = steps(VigilEnv(privileged=True, wind=3.0, noise=2.0), seed=12)
    assert not np.array_equal(first[0][0]["frames"], other[0][0]["frames"])


def test_flights_side_by_side_are_the_flights_alone_on_any_number_of_threads():
    alone = [steps(VigilEnv("validation", seeds=[4 + i]), 30, seed=0) for i in range(3)]
    for threads in (1, 3):
        vector = VigilVectorEnv(3, "validation", threads=threads)
        vector._draw = lambda number: 4 + number
        observation, _ = vector.reset(seed=0)
        for step, action in enumerate(ACTIONS[:30]):
            for number in range(3):
                for name in ("frames", "goal"):
                    np.testing.assert_array_equal(observation[name][number], alone[number][step][0][name])
            observation, rewards, terminated, truncated, _ = vector.step(np.tile(action, (3, 1)))
            assert not terminated.any() and not truncated.any()
            for number in range(3):
                assert np.float32(rewards[number]) == np.float32(alone[number][step + 1][1])


def test_a_frame_that_was_given_stays_as_it_was_and_cannot_be_written_to():
    one, two = [1.0, 0.3], [[1.0, 0.3]] * 2
    several = VigilVectorEnv(2, time_limit=1.0)
    for env, action in ((VigilEnv(frames=1), one), (VigilEnv(), one), (VigilEnv(every=4), one), (several, two)):
        kept, copies = [], []
        observation, _ = env.reset(seed=5)
        for step in range(90):
            kept.append(observation["frames"])
            copies.append(observation["frames"].copy())
            if step == 50 and isinstance(env, VigilEnv):
                observation, _ = env.reset(seed=6)
                continue
            observation, _, terminated, truncated, _ = env.step(action)
            if isinstance(env, VigilEnv) and (terminated or truncated):
                observation, _ = env.reset()
        for frames, copy in zip(kept, copies):
            np.testing.assert_array_equal(frames, copy)
        with pytest.raises(ValueError, match="read-only"):
            kept[0][...] = 0.0


def test_buffers_of_the_callers_are_written_in_place_with_what_would_be_handed_out_otherwise():
    kinds = {"frames": (3, 128, 256), "goal": (3, 2), "rewards": (3,)}
    buffers = {name: np.full(shape, np.nan, np.float32) for name, shape in kinds.items()}
    buffers |= {name: np.ones(3, bool) for name in ("terminated", "truncated")}
    for mode in ("NextStep", "SameStep"):
        options = dict(family="validation", frames=1, time_limit=0.6, autoreset_mode=mode)
        own, handed = VigilVectorEnv(3, buffers=buffers, threads=2, **options), VigilVectorEnv(3, threads=1, **options)
        (mine, _), (theirs, _) = own.reset(seed=4), handed.reset(seed=4)
        for action in ACTIONS[:40]:
            for name in ("frames", "goal"):
                assert mine[name] is buffers[name]
                np.testing.assert_array_equal(mine[name], theirs[name])
            mine, *outs, info = own.step(np.tile(action, (3, 1)))
            theirs, *expected, other = handed.step(np.tile(action, (3, 1)))
            for name, out, value in zip(("rewards", "terminated", "truncated"), outs, expected):
                assert out is buffers[name]
                np.testing.assert_array_equal(out, value)
            assert info.keys() == other.keys()


@pytest.mark.parametrize("every", [2, 4, 8])
def test_a_thinned_frame_is_a_part_of_the_whole_one(every):
    whole, thin = (VigilEnv("validation", frames=1, noise=0.0, every=n) for n in (1, every))
    (seen, _), (few, _) = (env.reset(options={"course_seed": 7}) for env in (whole, thin))
    beams, outside = 0, 0
    for action in ACTIONS[:30]:
        assert few["frames"].shape == (64 // every, 256 // every) and thin.observation_space.contains(few)
        # Each of its beams goes between pixels of the whole frame: it measures no less than the nearest around it, and no more than the farthest.
        for ring, column in np.ndindex(few["frames"].shape):
            row, first = 2 * every * ring + every - 1, every * column + every // 2 - 1
            around = seen["frames"][max(row - 3, 0) : row + 4, max(first - 1, 0) : first + 3]
            beams, outside = beams + 1, outside + (not 0.98 * around.min() <= few["frames"][ring, column] <= 1.02 * around.max())
        seen, one, *_ = whole.step(action)
        few, other, *_ = thin.step(action)
        assert one == other, "the flight is the same"
    # But for the few that look through where both of its neighbours meet an edge.
    assert outside < 0.003 * beams, (outside, beams)


def test_memory_of_frames_that_nobody_holds_is_used_again_and_that_of_held_ones_is_not():
    env = VigilVectorEnv(2, frames=1, time_limit=2.0)
    forward = [[1.0, 0.3]] * 2
    observation, _ = env.reset(seed=5)
    blocks, kept, copies = set(), [], []
    for step in range(400):
        block = observation["frames"].base
        blocks.add(block.__array_interface__["data"][0])
        del block
        # One frame in fifty is held, by a slice of a slice, for the whole run.
        if step >= 200 and step % 50 == 0:
            kept.append(observation["frames"][1][10:20])
            copies.append(kept[-1].copy())
        observation, *_ = env.step(forward)
        if step == 200:
            assert len(blocks) <= 4, len(blocks)
    for frames, copy in zip(kept, copies):
        np.testing.assert_array_equal(frames, copy)
    assert len(kept) == 4


def test_five_frames_are_the_last_five_and_the_first_stands_for_the_missing_ones():
    env = VigilEnv("validation")
    observation, _ = env.reset(options={"course_seed": 7})
    newest = [observation["frames"][-1].copy()] * 5
    for _ in range(40):
        np.testing.assert_array_equal(observation["frames"], np.stack(newest))
        observation, *_ = env.step([1.0, 0.0])
        newest = newest[1:] + [observation["frames"][-1].copy()]
    one = VigilEnv("validation", frames=1)
    alone, _ = one.reset(options={"course_seed": 7})
    assert alone["frames"].shape == (128, 256)
    assert alone["frames"].dtype == np.float32
    assert 0.1 < alone["frames"].min() < 60.0
    assert alone["frames"].max() == 100.0, "the sky"


def test_the_reward_is_the_sum_of_its_terms():
    terms = {"progress": "line", "success": 0.0, "dead": -7.0, "decision": -0.5}
    env = VigilEnv("validation", frames=1, reward=terms)
    _, before = env.reset(options={"course_seed": 7})
    for _ in range(600):
        _, reward, terminated, _, info = env.step([1.5, 0.0])
        progress = before["goal_distance_m"] - info["goal_distance_m"]
        before = info
        if terminated:
            break
        assert reward == pytest.approx(progress - 0.5, abs=1e-4)
    assert info["outcome"] in ("collision", "out of bounds")
    assert not info["is_success"] and info["course_seed"] == 7
    assert reward == pytest.approx(progress - 0.5 - 7.0, abs=1e-4)
    with pytest.raises(ValueError, match="has ended: reset"):
        env.step([1.0, 0.0])


@pytest.mark.filterwarnings("error")
def test_an_action_is_clipped_however_far_beyond_it_is():
    far, near = VigilEnv(frames=1), VigilEnv(frames=1)
    for env in (far, near):
        env.reset(options={"course_seed": 7})
    for sign in (1.0, -1.0):
        (seen, *more), (expected, *others) = far.step([1e300, sign * 1e39]), near.step([1.5, sign * 1.5])
        np.testing.assert_array_equal(seen["frames"], expected["frames"])
        assert more[:3] == others[:3]


def test_a_time_limit_truncates_and_a_vector_begins_anew_in_the_next_step():
    env = VigilEnv(frames=1, time_limit=0.48)
    env.reset(seed=1)
    ends = [env.step([0.0, 0.0])[2:4] for _ in range(10)]
    assert ends[:-1] == [(False, False)] * 9
    assert ends[-1] == (False, True)
    vector = VigilVectorEnv(2, frames=1, time_limit=0.48, threads=1)
    vector.reset(seed=1)
    for _ in range(10):
        _, _, terminated, truncated, info = vector.step(np.zeros((2, 2), np.float32))
    assert truncated.all() and not terminated.any()
    assert list(info["outcome"]) == ["time-out"] * 2
    seeds = list(vector.course_seeds)
    _, rewards, _, truncated, info = vector.step(np.ones((2, 2), np.float32))
    assert (rewards == 0.0).all() and not truncated.any() and info.keys() == {"course_seed"}
    assert info["course_seed"].tolist() == vector.course_seeds != seeds
    _, _, _, truncated, _ = vector.step(np.zeros((2, 2), np.float32))
    assert not truncated.any()


def test_a_course_file_is_flown_and_drawn_with_the_mesh_beside_it(tmp_path):
    file = tmp_path / "field.toml"
    (tmp_path / "post.obj").write_text("v 1 6 0\nv 2 6 0\nv 2 6 3\nf 1 2 3\n")
    file.write_text(
        'name = "field"\ngoal = { north_m = 4.0, east_m = 0.0 }\n'
        "bounds = { north_m = [-5.0, 25.0], east_m = [-8.0, 8.0], top_m = 6.0 }\n"
        '[[mesh]]\nfile = "post.obj"\n'
    )
    env = VigilEnv(course=file, frames=1, render_mode="rgb_array")
    observation, _ = env.reset(seed=0)
    assert observation["goal"][0] == pytest.approx(4.0, abs=0.5)
    at_first = env.render()
    for _ in range(100):
        _, _, terminated, _, info = env.step([1.5, 0.0])
        if terminated:
            break
    assert info["outcome"] == "success" and info["is_success"]
    picture = env.render()
    assert picture.dtype == np.uint8 and picture.shape == at_first.shape and picture.shape[2] == 3
    assert (picture != at_first).any(), "the way flown is drawn"
    (tmp_path / "post.obj").unlink()
    with pytest.raises(ValueError, match="field.toml:.*post.obj"):
        VigilEnv(course=file)


def test_wind_and_noise_change_a_flight_and_the_true_state_knows_the_goal():
    plain = steps(VigilEnv(privileged=True), 20, options={"course_seed": 3})
    assert plain[0][0]["state"].shape == (75,)
    assert plain[0][0]["state"][51] * 20.0 == pytest.approx(plain[0][0]["goal"][0], abs=1.0)
    for options in ({"wind": 5.0}, {"noise": 4.0}):
        other = steps(VigilEnv(privileged=True, **options), 20, options={"course_seed": 3})
        assert not np.array_equal(plain[-1][0]["frames"], other[-1][0]["frames"]), options


def test_a_step_releases_the_interpreter():
    vector = VigilVectorEnv(32, frames=1, threads=1)
    vector.reset(seed=0)
    counted, over = [0], threading.Event()

    def count():
        while not over.is_set():
            counted[0] += 1

    counter = threading.Thread(target=count)
    actions = np.zeros((32, 2), np.float32)
    counter.start()
    try:
        most = 0
        for _ in range(5):
            before, begun = counted[0], time.monotonic()
            vector.step(actions)
            took = time.monotonic() - begun
            # Held all the while, the lock would be given to the counter for one turn of 5 ms at each end of the call.
            most = max(most, counted[0] - before if took > 0.005 else 0)
    finally:
        over.set()
        counter.join()
    assert most > 1000, most


def test_what_does_not_fit_is_refused_in_words():
    begun, images = VigilEnv(frames=1), {"frames": 1, "images": True}
    begun.reset(seed=0)
    several, seeds = VigilVectorEnv(2, frames=1), [(1.5, "1.5"), ([1, "a"], "'a'"), ({1, 2}, "{1, 2}")]
    options = [
        ({"family": "nowhere"}, "no course family is called `nowhere`; there are: training"),
        ({"frames": 3}, "frames: 1"),
        ({"every": 3}, "every: one of 1, 2, 4, 8, got 3"),
        ({"wind": -1.0}, "wind: 0 to 20 m/s, got -1.0"),
        ({"wind": float("nan")}, "wind: 0 to 20"),
        ({"noise": 1e9}, "noise: a factor"),
        ({"time_limit": 0.0}, "time_limit"),
        ({"time_limit": float("nan")}, "time_limit: above 0 and at most 3600 s, got nan"),
        ({"reward": {"progres": 1.0}}, "no term is called progres"),
        ({"reward": {"progress": "up"}}, "'way' or the 'line'"),
        ({"reward": {"dead": float("inf")}}, "reward: dead: a finite number, got inf"),
        ({"seeds": []}, "seeds: is empty"),
        ({"seeds": {1, 2}}, "seeds: a collections.abc.Sequence or a numpy.ndarray, got set"),
        ({"family": None}, "family: a str, got NoneType"),
        ({"reward": [1]}, "reward: a collections.abc.Mapping, got list"),
        ({"render_mode": "human"}, "render_mode"),
        ({"normalized": True, "privileged": True}, "have no bounds"),
    ]
    frames = np.zeros((2, 128, 256), np.float32)
    buffers = [
        ({"frames": np.zeros((2, 128, 256))}, r"frames is an array of float32 \(2, 128, 256\), got float64"),
        ({"frames": frames[:, :64]}, r"got float32 \(2, 64, 256\)"),
        ({"frames": np.zeros((128, 256, 2), np.float32).transpose(2, 0, 1)}, "one piece in C's order"),
        ({"goal": [[0.0, 0.0]] * 2}, "got list"),
        ({"terminated": np.zeros(2, np.int8)}, "array of bool"),
        ({"truncted": np.zeros(2, bool)}, "there is none called truncted; there are frames, goal"),
    ]
    for call, error, said in [
        (lambda: begun.step([0.0]), ValueError, r"action: expected shape \(2,\)"),
        (lambda: begun.step([[0.0, 0.0]]), ValueError, r"expected shape \(2,\).*got \(1, 2\)"),
        (lambda: begun.step([0.0, np.nan]), ValueError, "finite"),
        (lambda: begun.step([np.inf, 0.0]), ValueError, "finite"),
        (lambda: begun.step(["a", "b"]), TypeError, "expected numbers"),
        (lambda: begun.step(None), TypeError, "expected numbers"),
        *((lambda given=given: VigilEnv(**given), (TypeError, ValueError), said) for given, said in options),
        *((lambda seed=seed: several.reset(seed=seed), TypeError, f"seed: .*got {said}") for seed, said in seeds),
        (lambda: begun.reset(seed=-1), ValueError, "seed: 0 or more"),
        *((lambda given=given: VigilVectorEnv(2, frames=1, buffers=given), ValueError, said) for given, said in buffers),
        (lambda: VigilVectorEnv(2, buffers={"frames": frames}, **images), ValueError, "no ranges with images=True"),
        (lambda: VigilEnv(every=2.0), TypeError, "every: expected a whole number, got 2.0"),
        (lambda: VigilEnv(frames=1, seeds=[2**64]).reset(), ValueError, "seeds: 0 or more, below 2.64, got 18446744073709551616"),
        (lambda: VigilEnv(frames=1, seeds=[1.9]).reset(), TypeError, "seeds: expected a whole number, got 1.9"),
        (lambda: VigilEnv(frames=1).step([0.0, 0.0]), ValueError, "reset first"),
        (lambda: VigilVectorEnv(2, frames=1).step(np.zeros((2, 2))), ValueError, "reset first"),
        (lambda: VigilVectorEnv(2, threads=0), ValueError, "threads: 1 or more"),
        (lambda: VigilVectorEnv(0), ValueError, "num_envs"),
        (lambda: VigilVectorEnv(10**6), ValueError, "num_envs: 1 to 16384, whose frames are 2 GB, got 1000000"),
    ]:
        with pytest.raises(error, match=said):
            call()
    begun.step([0.0, 0.0])


def test_a_reset_that_is_refused_draws_nothing():
    env, other = VigilEnv(frames=1), VigilEnv(frames=1)
    for one in (env, other):
        one.reset(seed=3)
    for wrong in ({"course_seed": -1}, {"course": 4}):
        with pytest.raises(ValueError, match="course_seed"):
            env.reset(seed=9, options=wrong)
        assert env.course_seed == other.course_seed
    for one in (env, other):
        one.reset()
    assert env.course_seed == other.course_seed
    vector = VigilVectorEnv(2, frames=1, threads=1)
    before = list(vector._random)
    with pytest.raises(ValueError, match="have not begun: reset all of them first"):
        vector.reset(seed=9, options={"reset_mask": np.array([True, False])})
    assert vector._random == before


def test_environments_in_other_processes_have_an_actor_each():
    given = {"id": "Vigil-v0", "frames": 1, "actor": vigil.policy.Actor()}
    assert gymnasium.make(**given).spec.kwargs["actor"].path is None
    envs = gymnasium.make_vec(**given, num_envs=2, vectorization_mode="async", vector_kwargs={"context": "spawn"})
    observation, _ = envs.reset(seed=1)
    assert observation["position"].shape == (2, 9)
    envs.close()


def test_a_forked_process_is_refused_the_threads_that_stayed_behind_and_does_not_hang():
    env = VigilVectorEnv(2, frames=1, threads=2)
    env.reset(seed=1)
    child = os.fork()
    if child == 0:
        signal.alarm(30)
        try:
            env.step(np.zeros((2, 2)))
        except ValueError as refused:
            os._exit(0 if "after the fork, or with threads=1" in str(refused) else 1)
        finally:
            os._exit(2)
    assert os.waitpid(child, 0)[1] == 0
    env.step(np.zeros((2, 2)))
