"""`vigil.policy`, `explain`, `attack`, `detect`: sums, bounds, gradients, the same numbers as in flight, errors."""

import copy
import os
import pickle
import signal
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import vigil.policy as policy_module
from vigil import detect, log
from vigil.attack import FrameAttack, PolicyAttack, StateAttack
from vigil.detect import Detector, Lstm, Monitor, train, windows
from vigil.evaluate import completion
from vigil.explain import FORWARD, YAW, Pixels, PolicyPixels, SplitPoint
from vigil.policy import Actor, Policy


def test_contributions_and_base_add_up_to_the_decision(flown):
    _, _, _, states, actions, held = flown
    explain = SplitPoint(Actor())
    for output in (FORWARD, YAW):
        for i in range(5, 40, 7):
            found = explain.explain(states[i], held[i][1], output)
            assert found.phi.shape == (48,)
            assert found.output == pytest.approx(actions[i][output], abs=1e-5)
            total = found.base + found.phi.sum() + found.bearing + found.distance + found.told
            assert total == pytest.approx(found.output, abs=2e-5)


def test_pixels_add_up_to_the_decision_as_well(flown):
    frames, _, _, _, actions, held = flown
    contexts, low_dims = (np.stack(given) for given in zip(*held))
    usual = frames[:12:4, -1], contexts[:12:4], low_dims[:12:4]
    found = Pixels(Actor(), usual).explain(frames[30, -1], *held[30])
    assert found.phi.shape == (128, 256)
    assert found.output == pytest.approx(actions[30].yaw, abs=1e-4)
    total = found.base + found.phi.sum(dtype=np.float64) + found.memory + found.bearing + found.distance + found.told
    assert total == pytest.approx(found.output, abs=5e-5)
    assert np.abs(found.phi).max() > 1e-5


def test_the_monitor_says_what_explainer_and_detector_say(flown):
    _, _, _, states, _, held = flown
    actor, detector = Actor(), Detector()
    monitor, explain = Monitor(actor, detector), SplitPoint(actor)
    judged = [monitor.judge(state, low_dim) for state, (_, low_dim) in zip(states, held)]
    phi = np.stack([explain.explain(state, low_dim).phi for state, (_, low_dim) in zip(states, held)])
    np.testing.assert_array_equal(phi, np.stack([j.phi for j in judged]))
    scores = detector.scores(phi)
    assert np.isnan(scores[:9]).all() and [j.score for j in judged[:9]] == [None] * 9
    np.testing.assert_array_equal(scores[9:], np.array([j.score for j in judged[9:]], np.float32))
    assert all(j.attacked is False for j in judged[9:])
    monitor.reset()
    assert monitor.judge(states[0], held[0][1]).attacked is None


def passed(adversary, frames, goals, reach):
    """A flight's frames as they come, attacked from the twentieth on, what the attack came to, and the goals."""
    for i, (frame, goal) in enumerate(zip(frames[:, -1], goals)):
        found = adversary.attack(frame, goal) if i >= 20 else adversary.pass_on(frame, goal)
        assert not found or np.abs(found.frames - frame).max() <= reach + 1e-3
        yield found.frames if found else frame, found, goal


def test_an_attack_in_flight_is_noticed(flown):
    frames, _, positions, *_ = flown
    actor = Actor()
    monitor, adversary = Monitor(actor), FrameAttack(actor)
    changes, verdicts = [], []
    for frame, found, position in passed(adversary, frames, positions, reach=20 * 100.0 / 255.0):
        decided = actor.decide(frame, position)
        if found:
            changes.append(abs(found.yaw_change))
            assert decided.yaw == pytest.approx(found.attacked.yaw, abs=1e-4)
        verdicts.append(monitor.judge(actor.state(), actor.low_dim()).attacked)
    assert max(changes) > 0.5
    assert True not in verdicts[:20] and True in verdicts[20:]


@pytest.mark.parametrize("method", ["fgsm", "bim-clipped", "bim-accumulating", "pgd"])
def test_a_state_is_attacked_within_its_bounds(flown, method):
    frames, _, _, _, actions, held = flown
    found = StateAttack(Actor(), method, epsilon=2.0, iterations=5).attack(frames[30, -1], *held[30])
    reach = 2.0 * 100.0 / 255.0 * (5 if method == "bim-accumulating" else 1)
    moved = np.abs(found.frames - frames[30, -1]).max()
    assert 0.1 < moved <= reach + 1e-3
    assert found.frames.min() >= 0.0 and found.frames.max() <= 100.0
    assert found.clean.yaw == pytest.approx(actions[30].yaw, abs=1e-4)
    assert abs(found.yaw_change) > 0.05
    assert (found.yaw_change < 0.0) == (found.clean.yaw >= 0.0), "away"


def test_threads_share_what_remembers_nothing(flown):
    frames, _, _, states, _, held = flown
    contexts, low_dims = (np.stack(given) for given in zip(*held[:2]))
    explain, pixels = SplitPoint(Actor()), Pixels(Actor(), (frames[:2, -1], contexts, low_dims))
    attack = StateAttack(Actor(), "bim-clipped", iterations=3)

    def at(step):
        frame, (context, low_dim) = frames[step, -1], held[step]
        yield explain.explain(states[step], low_dim).phi
        yield pixels.explain(frame, context, low_dim).phi
        yield attack.attack(frame, context, low_dim).frames

    with ThreadPoolExecutor(4) as threads:
        shared = list(threads.map(lambda step: list(at(step)), range(12)))
    for step, found in enumerate(shared):
        for one, alone in zip(found, at(step), strict=True):
            np.testing.assert_array_equal(one, alone)


@pytest.mark.parametrize("name", ["goal_beside_the_frame", "three_channels_last", "gru"])
def test_an_imported_policy_decides_as_in_flight_and_is_explained_and_attacked(flown, policies, name):
    frames, goals, *_ = flown
    policy = Policy(policies[name])
    rows, columns, channels = policy.frame_shape
    for stack, goal in zip(frames[20:26], goals[20:26]):
        decided = policy.decide(stack[-1], goal)
    last = np.stack([frames[26 - channels + i][-1] for i in range(channels)])
    own, goal = policy.own_frame(last), goals[25]
    outputs = policy.outputs(own, goal)
    np.testing.assert_allclose(np.clip(outputs, -1.5, 1.5), decided, atol=1e-5)

    # The gradient is the slope along itself.
    gradient = policy.gradient(own, goal)
    assert gradient.shape == own.shape
    along = gradient / np.linalg.norm(gradient)
    step = 1e-2
    slope = (policy.outputs(own + step * along, goal)[1] - policy.outputs(own - step * along, goal)[1]) / (2 * step)
    assert slope == pytest.approx(np.linalg.norm(gradient), rel=0.1)

    usual = [(policy.own_frame(np.repeat(frames[i][-1:], channels, axis=0)), goals[i]) for i in (0, 10, 35)]
    found = PolicyPixels(policy, usual).explain(own, goal)
    assert found.phi.shape == own.shape
    assert found.output == pytest.approx(outputs[1], abs=1e-5)
    assert found.base + found.phi.sum() + found.bearing + found.distance + found.told == pytest.approx(found.output, abs=5e-5)
    assert (found.bearing != 0.0) == policy.has_goal

    for method in PolicyAttack.METHODS:
        attacked = PolicyAttack(policy, method, epsilon=4.0, iterations=5, towards="right").attack(own, goal)
        reach = policy.scale * 4.0 / 255.0 * (5 if method == "bim-accumulating" else 1)
        assert 0.0 < np.abs(attacked.frames - own).max() <= reach * 1.001
        assert attacked.yaw_change > 0.0 or attacked.clean.yaw == 1.5, method
    # From wherever it starts, a step is no larger than epsilon.
    reach = policy.scale * 4.0 / 255.0
    start = np.clip(own + np.random.default_rng(3).uniform(-reach, reach, own.shape), 0.0, policy.scale)
    once = PolicyAttack(policy, "pgd", epsilon=4.0, iterations=1, seed=3).attack(own, goal)
    assert np.abs(once.frames - start).max() <= reach * 1.001


def test_a_policy_at_its_limit_is_attacked_all_the_same_and_one_whose_gradient_is_no_number_is_refused(flown, policies):
    policy = Policy(policies["at_its_limit"])
    own = policy.own_frame(flown[0][30][-1:])
    assert not policy.gradient(own, [10.0, 0.5]).any()
    for method in PolicyAttack.METHODS:
        attacked = PolicyAttack(policy, method, epsilon=64.0).attack(own, [10.0, 0.5])
        assert attacked.yaw_change == pytest.approx(-2.0 * attacked.clean.yaw), method
    with pytest.raises(ValueError, match="policy: its gradient here is not finite"):
        PolicyAttack(policy).attack(own, [10.0, 0.0])


@pytest.mark.parametrize("name", ["goal_beside_the_frame", "three_channels_last"])
def test_an_imported_policy_is_judged_at_its_split_point_and_attacked_frame_by_frame(flown, policies, tmp_path, name):
    frames, goals, *_ = flown
    policy = Policy(policies[name])
    with pytest.raises(ValueError, match="nothing was decided yet"):
        policy.state()
    with pytest.raises(ValueError, match="detector: .* give detector=FILE, the policy's own, or detector=False, and guard=True"):
        completion(flights=1, actor=policies[name])
    adversary = FrameAttack(policy, "bim-clipped", epsilon=8.0, iterations=5, towards="right")
    unattacked, states, actions, moved = Policy(policies[name]), [], [], []
    for stack, (frame, found, goal) in zip(frames, passed(adversary, frames, goals, reach=8.0 * 100.0 / 255.0)):
        clean = unattacked.decide(stack[-1], goal)
        actions.append(policy.decide(frame, goal))
        if found:
            assert found.clean.yaw == pytest.approx(clean.yaw, abs=1e-5)
            moved.append(found.yaw_change)
            assert actions[-1].yaw == pytest.approx(found.attacked.yaw, abs=1e-5)
        states.append(policy.state())
    assert max(moved) > 0.0 and min(moved) >= -1e-5

    usual = np.stack(states[:20:4]), goals[:20:4]
    explain = SplitPoint(policy, usual)
    explained = [explain.explain(state, goal) for state, goal in zip(states, goals)]
    for found, action in zip(explained, actions):
        assert np.clip(found.output, -1.5, 1.5) == pytest.approx(action.yaw, abs=1e-4)
        assert found.base + found.phi.sum() + found.bearing + found.distance + found.told == pytest.approx(found.output, abs=1e-4)

    # A detector of it, written from Python, judges what the network gives for the explanations of the tick.
    random = np.random.default_rng(3)
    params = Detector().native.network()[0]
    lstm = Lstm(params, np.zeros(48, np.float32), np.full(48, 0.1, np.float32))
    file = tmp_path / "detector.safetensors"
    digest = detect.freeze(file, lstm, policy, usual, threshold=0.4, training_config="by = 'hand'")
    detector = pickle.loads(pickle.dumps(Detector(file)))
    assert (detector.sha256, detector.actor_sha256) == (digest, policy.sha256)
    assert detector.threshold == pytest.approx(0.4)
    monitor = Monitor(policy, detector)
    judged = [monitor.judge(state, goal) for state, goal in zip(states, goals)]
    scores = lstm.scores(np.stack([j.phi for j in judged]))
    np.testing.assert_array_equal(scores[9:], np.array([j.score for j in judged[9:]], np.float32))
    with pytest.raises(ValueError, match="48 wide, the network's 7"):
        detect.freeze(tmp_path / "no", train([rows_of(1)], [rows_of(2)], epochs=1).lstm, policy, usual)
    with pytest.raises(ValueError, match="threshold"):
        detect.freeze(tmp_path / "no", lstm, policy, usual, threshold=float(random.integers(2, 9)))
    assert not (tmp_path / "no").exists()


def test_an_imported_policy_takes_the_goal_of_a_position(flown, policies):
    frames, _, positions, *_ = flown
    of_position, of_goal = (Policy(policies["goal_beside_the_frame"]) for _ in range(2))
    assert of_position.decide(frames[0][-1], positions[0]) == of_goal.decide(frames[0][-1], positions[0][:2])


def test_an_actor_written_from_python_decides_as_the_program_does(flown, tmp_path):
    frames, _, positions, _, actions, _ = flown
    built_in = Actor()
    tensors = built_in.tensors()
    same = policy_module.freeze(tmp_path / "same.safetensors", tensors, seed=3, training_config="rate = 0.1")
    again = Actor(tmp_path / "same.safetensors")
    assert again.sha256 == same != built_in.sha256
    assert again.decide(frames[0][-1], positions[0]) == actions[0]
    # Its yaw's weights the other way round.
    tensors["output.weight"][:, 1] *= -1.0
    tensors["output.bias"][1] *= -1.0
    file = tmp_path / "mirrored.safetensors"
    digest = policy_module.freeze(file, tensors)
    mirrored = Actor(file).decide(frames[0][-1], positions[0])
    assert mirrored.yaw == pytest.approx(-actions[0].yaw, abs=1e-6)
    assert digest == Actor(file).sha256
    assert len(completion(seeds=[7], actor=file, detector=False, threads=1).flights) == 1, "it flies"
    for wrong, said in [
        ({k: v for k, v in tensors.items() if k != "trunk_1.bias"}, "trunk_1.bias missing"),
        ({**tensors, "more": np.zeros(3, np.float32)}, "more unknown"),
        ({**tensors, "output.bias": np.zeros(3, np.float32)}, r"output.bias: expected shape \(2,\)"),
        ({**tensors, "output.bias": np.full(2, np.nan, np.float32)}, "output.bias: holds a value that is not"),
    ]:
        with pytest.raises(ValueError, match=said):
            policy_module.freeze(tmp_path / "no", wrong)
    assert not (tmp_path / "no").exists()


def test_a_file_is_named_in_any_way_that_python_has(tmp_path):
    digest = policy_module.freeze(os.fsencode(tmp_path / "actor"), Actor().tensors())
    (entry,) = os.scandir(tmp_path)
    assert policy_module.freeze(entry, Actor(entry).tensors()) == digest == Actor(os.fsencode(entry)).sha256
    assert len(completion(seeds=[7], actor=entry, detector=False, threads=1).flights) == 1
    assert os.listdir(tmp_path) == ["actor"]


def rows_of(seed, width=7, steps=60):
    """Noise whose mean moves while it is attacked."""
    random = np.random.default_rng(seed)
    attacked = np.arange(steps) >= steps // 2
    return (random.normal(size=(steps, width)) + 3.0 * attacked[:, None]).astype(np.float32), attacked


def test_a_detector_is_trained_on_rows_of_any_width_and_kept(tmp_path):
    learn, choose = [rows_of(i) for i in range(12)], [rows_of(i) for i in range(12, 15)]
    trained = train(learn, choose, epochs=4, threads=2)
    rows, attacked = rows_of(99)
    scores = trained.lstm.scores(rows)
    assert np.isnan(scores[:9]).all()
    assert scores[9:30].max() < 0.5 < scores[35:].min()
    assert len(trained.epochs) == 4 and trained.epochs[trained.chosen - 1][1] == min(e[1] for e in trained.epochs)
    assert trained.epochs[trained.chosen - 1][2] > 0.8
    again = train(learn, choose, epochs=4, threads=1)
    assert again.epochs == trained.epochs
    np.testing.assert_array_equal(again.lstm.params, trained.lstm.params)
    trained.lstm.save(os.fsencode(tmp_path / "own"))
    copies = pickle.loads(pickle.dumps(trained)).lstm, copy.deepcopy(trained).lstm
    for same in (Lstm.load(os.fsencode(tmp_path / "own")), Detector.load(tmp_path / "own"), *copies):
        np.testing.assert_array_equal(same.scores(rows), scores)
    found, labels = windows([rows_of(1), (rows[:5], attacked[:5])])
    assert found.shape == (51, 10, 7) and labels.sum() == 30


def test_training_ends_at_ctrl_c():
    # A shell in the background lets what it starts ignore SIGINT.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        train([rows_of(1)], [rows_of(2)], epochs=10_000)
    timer.join()
    signal.signal(signal.SIGINT, before)


def test_a_copy_of_a_policy_is_made_anew_from_its_file(flown, policies):
    frames, _, positions, _, actions, _ = flown
    actor, policy = Actor(), Policy(policies["three_channels_last"])
    first = policy.decide(frames[0][-1], positions[0])
    for frame, position in zip(frames[:9, -1], positions):
        actor.decide(frame, position)
        policy.decide(frame, position)
    assert pickle.loads(pickle.dumps(actor)).decide(frames[0][-1], positions[0]) == actions[0]
    assert copy.deepcopy(policy).decide(frames[0][-1], positions[0]) == first


@pytest.mark.filterwarnings("error")
def test_what_does_not_fit_is_refused_in_words(flown, policies, tmp_path):
    frames, goals, positions, states, _, held = flown
    actor, frame, position, (context, low_dim) = Actor(), frames[0][-1], positions[0], held[0]
    policy, far = Policy(policies["goal_beside_the_frame"]), frame * 2.0 + 100.0
    own = policy.own_frame(np.repeat(frame[None], policy.frame_shape[2], axis=0))
    bad = frame.copy()
    bad[3, 4] = np.nan
    files = [tmp_path / name for name in ("no.safetensors", "no.npz")]
    for file in files:
        file.write_bytes(b"nothing")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    missing, rows, none = tmp_path / "missing.safetensors", rows_of(1), (np.empty((0, 48), np.float32), [])
    for call, error, said in [
        (lambda: actor.decide(frame[:64], position), ValueError, r"frame: expected shape \(128, 256\), got \(64, 256\)"),
        (lambda: actor.decide(bad, position), ValueError, "frame: holds a value that is not a finite number: nan"),
        (lambda: actor.decide(np.full((128, 256), 1e39), position), ValueError, r"frame: holds a value that is beyond float32: 1e\+39"),
        (lambda: actor.decide(frame.astype(np.uint8), position), TypeError, "frame: expected floating-point .*got dtype uint8"),
        (lambda: actor.decide(far, position), ValueError, "frame: ranges are 0 to 100 m, one is 300.0 m"),
        (lambda: actor.decide(-frame, position), ValueError, "frame: ranges are 0 to 100 m, one is -"),
        (lambda: Pixels(actor, ([far], [context], [low_dim])), ValueError, "frame: ranges are 0 to 100 m, one is 300.0 m"),
        (lambda: policy.own_frame(np.stack([far] * policy.frame_shape[2])), ValueError, "frames: ranges are 0 to 100 m"),
        (lambda: actor.decide(frame, [1.0]), ValueError, r"goal: expected shape \(2,\) or \(9,\)"),
        (lambda: actor.decide(frame, [-1.0, 0.0]), ValueError, "a distance of 0 m or more, got -1.0 m"),
        (lambda: actor.decide(frame, [*position[:8], 1e11]), ValueError, "a time of at most 1000000000 s"),
        (lambda: Monitor(actor).judge(states[0][:47], low_dim), ValueError, r"state: expected shape \(48,\)"),
        (lambda: SplitPoint(actor).explain(states[0], low_dim, output=2), ValueError, "output: 0"),
        (lambda: SplitPoint(actor).explain(states[0], low_dim, 1.0), TypeError, "output: expected a whole number, got 1.0"),
        (lambda: SplitPoint(actor).explain(states[0], position), ValueError, r"low_dim: expected shape \(8,\)"),
        (lambda: SplitPoint(actor, none), ValueError, "empty"),
        (lambda: StateAttack(actor, "magic"), ValueError, "is none of fgsm"),
        (lambda: StateAttack(actor, "swell"), ValueError, "method: swell needs a flight's frames"),
        (lambda: StateAttack(actor, "pgd", epsilon=0.0), ValueError, "epsilon: above 0 and at most 255, got 0.0"),
        (lambda: FrameAttack(actor, iterations=-1), ValueError, "iterations: 1 or more, below 2.32, got -1"),
        (lambda: PolicyAttack(policy, seed=1.5), TypeError, "seed: expected a whole number, got 1.5"),
        (lambda: StateAttack("a.safetensors"), TypeError, "actor: a vigil.policy.Actor, got str"),
        (lambda: FrameAttack(None), TypeError, "actor: a vigil.policy.Actor or a vigil.policy.Policy, got NoneType"),
        (lambda: PolicyAttack(actor), TypeError, "policy: a vigil.policy.Policy, got Actor"),
        (lambda: PolicyPixels(actor, [(own, goals[0])]), TypeError, "policy: a vigil.policy.Policy, got Actor"),
        (lambda: detect.freeze(missing, None, actor, none), TypeError, "lstm: a vigil.detect.Lstm, got NoneType"),
        (lambda: policy_module.freeze(missing, actor.tensors(), updates=-1), ValueError, "updates: 0 or more"),
        (lambda: Detector().scores(np.zeros((20, 47), np.float32)), ValueError, r"rows: expected shape \('any', 48\)"),
        (lambda: train([(rows[0], np.zeros(60, bool))], [rows]), ValueError, "attacked and unattacked"),
        (lambda: train([rows], [rows_of(2, width=8)]), ValueError, "wide to choose"),
        (lambda: train([rows], [rows], threads=0), ValueError, "threads: 1 or more"),
        (lambda: train([rows], [rows], rate=np.nan), ValueError, "rate: above 0 and below 1, got nan"),
        *((lambda kind=kind: kind(files[0]), ValueError, "no.safetensors") for kind in (Actor, Policy, Detector)),
        *((lambda kind=kind: kind(missing), ValueError, "missing.safetensors") for kind in (Actor, Policy, Detector)),
        *((lambda kind=kind: kind(3), TypeError, "path: expected a path, got int") for kind in (Actor, Policy, Detector, log.read)),
        (lambda: Lstm.load(files[1]), ValueError, "no.npz: not a file that Lstm.save has written"),
        (lambda: Lstm.load(tmp_path / "other.npz"), ValueError, "other.npz: not a file that Lstm.save has written"),
    ]:
        with pytest.raises(error, match=said):
            call()
    assert not missing.exists()
