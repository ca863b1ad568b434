"""Compares our programs with PyTorch, ONNX Runtime, tract, shap, captum and ART, side by side in one run.

Each case first checks that both sides compute the same, then times them in turns, one thread each, on one core, in processor time.
tools/peers/run.sh builds our side and calls this.

Examples:
  tools/peers/run.sh                       everything, about five minutes on an idle core
  tools/peers/run.sh --rounds 3 actor bim  some cases, with few rounds; the other cases' results stay
  tools/peers/run.sh --no-write actor      prints only
"""

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[variable] = "1"

import captum.attr
import numpy as np
import onnx
import shap
import torch
from art.attacks.evasion import BasicIterativeMethod
from art.estimators.regression import PyTorchRegressor
from captum.attr._core import deep_lift
from safetensors import safe_open
from shap.explainers._deep import deep_pytorch
from tqdm import tqdm

import actor as frozen
import export_onnx
import networks

HERE = Path(__file__).resolve().parent
DOCUMENT = frozen.REPOSITORY / "docs/peers.md"
MARKS = ("<!-- measured by tools/peers/run.sh -->", "<!-- end -->")
# Of our attack's loss: 1.5 tanh(10) is the limit to the last bit (sim_bridge/adversary).
ATTACK_TARGET = 10.0
ATTACK_STEP_GAIN = 2.5
YAW = 1
ORDER = ("actor", "shap-hidden", "shap-pixels", "bim", "lstm-ad")


@dataclass
class Peer:
    """Another program for the same work: how to run it, and how often for one measurement.

    `time_ns` replaces `run` for one in another process: the processor time of one run, the mean over as many as it is given.
    """

    run: Callable[[], object] | None = None
    runs: int = 1
    goal: float | None = None
    time_ns: Callable[[int], float] | None = None


@dataclass
class Case:
    """A comparison."""

    title: str
    ours: str
    runs: int
    peers: dict[str, Peer]
    agreement: str
    rounds: int


class Program:
    """A program in a process of its own, waiting for requests."""

    def __init__(self, *arguments: object) -> None:
        """Starts it; `first` is what it says beside that it is ready."""
        words = [str(argument) for argument in arguments]
        self.process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        state, *self.first = self.process.stdout.readline().split() or [""]
        if state != "ready":
            raise SystemExit(f"{words[0]} did not start; see above")

    def ask(self, request: str, ended: str) -> float:
        """Processor time of one run."""
        self.process.stdin.write(f"{request}\n")
        self.process.stdin.flush()
        answer = self.process.stdout.readline()
        if not answer:
            raise SystemExit(f"{ended}; see above")
        return float(answer)


class Ours(Program):
    """Our program, and what it wrote."""

    def __init__(self, program: Path, folder: Path, actor: Path | None) -> None:
        super().__init__(program, folder, *(["--actor", actor] if actor else []))
        with safe_open(folder / "ours.safetensors", framework="numpy") as file:
            self.tensors = {name: file.get_tensor(name) for name in file.keys()}
            self.notes = dict(file.metadata())


def start_tract(program: Path, folder: Path, model: onnx.ModelProto, inputs: list[np.ndarray]) -> Program:
    """tract with a model and its inputs; `first` are the values of the first output."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "tract.onnx").write_bytes(model.SerializeToString())
    (folder / "tract.bin").write_bytes(b"".join(x.astype("<f4").tobytes() for x in inputs))
    return Program(program, folder / "tract.onnx", folder / "tract.bin")


@dataclass
class Context:
    """What the cases are made of."""

    ours: Ours
    actor: frozen.Actor
    tract: Path | None = None

    def given(self, of: str) -> tuple[torch.Tensor, ...]:
        """Frames [n, 1, 128, 256], what is remembered [n, 328] and low-dimensional observations [n, 8] of `state` or `background`."""
        return tuple(torch.from_numpy(self.ours.tensors[f"{of}_{name}"]) for name in ("frame", "context", "low_dim"))

    def state(self, i: int) -> tuple[torch.Tensor, ...]:
        """The same of one state."""
        return tuple(x[i : i + 1] for x in self.given("state"))


def within(what: str, got: np.ndarray, want: np.ndarray, limit: float) -> str:
    """Checks a difference and says how large it is."""
    difference = float(np.abs(np.asarray(got, dtype=np.float64) - np.asarray(want, dtype=np.float64)).max())
    if not difference <= limit:
        raise SystemExit(f"{what}: differs from ours by {difference:.2e}, allowed is {limit:.0e}")
    return f"{what} {difference:.1e}"


def actor_case(c: Context) -> Case:
    """One new frame through the actor."""
    t = c.ours.tensors
    net = networks.Actor(c.actor.weights).eval().requires_grad_(False)
    whole = export_onnx.session(export_onnx.whole(c.actor))
    feed = {name: t[f"state_{name}"] for name in ("frame", "context", "low_dim")}
    agreement = [
        within("PyTorch", net(*c.given("state")).numpy(), t["state_action"], 1e-5),
        within("ONNX Runtime", whole.run(["action"], feed)[0], t["state_action"], 1e-5),
    ]
    feed = {name: values[:1] for name, values in feed.items()}
    model = export_onnx.whole(c.actor, 1)
    single = export_onnx.session(model)
    inputs = c.state(0)

    def by_torch() -> None:
        with torch.inference_mode():
            net(*inputs)

    peers = {
        "ONNX Runtime": Peer(lambda: single.run(None, feed), 50, goal=2.6),
        "PyTorch": Peer(by_torch, 20),
    }
    if c.tract is not None:
        tract = start_tract(c.tract, frozen.REPOSITORY / "target/peers", model, list(feed.values()))
        first = np.array(tract.first, dtype=np.float32)
        agreement.append(within("tract", first, t["state_action"][0], 1e-5))
        peers["tract"] = Peer(runs=20, goal=5.8, time_ns=lambda runs: tract.ask(str(runs), "tract ended"))
    return Case("One new frame through the actor", "actor", 50, peers, ", ".join(agreement), 30)


def hidden_shap_case(c: Context) -> Case:
    """DeepSHAP at the split point, yaw, 30 backgrounds."""
    t = c.ours.tensors
    head = networks.Head(c.actor.weights, only=YAW)
    background = [torch.from_numpy(t["background_hidden"]), torch.from_numpy(t["background_low_dim"])]
    states = [torch.from_numpy(t["state_hidden"]), torch.from_numpy(t["state_low_dim"])]
    explainer = shap.DeepExplainer(head, background)
    lift = captum.attr.DeepLiftShap(head)
    by_shap = np.concatenate([x[:, :, 0] for x in explainer.shap_values(states, check_additivity=False)], axis=1)
    each = [lift.attribute(tuple(x[i : i + 1] for x in states), tuple(background)) for i in range(len(states[0]))]
    by_captum = np.stack([np.concatenate([x[0].detach().numpy() for x in one]) for one in each])
    agreement = [within("shap", by_shap, t["shap_hidden"], 1e-5), within("captum", by_captum, t["shap_hidden"], 1e-5)]
    one = [x[:1] for x in states]
    peers = {
        "captum": Peer(lambda: lift.attribute(tuple(one), tuple(background)), 5, goal=104.0),
        "shap": Peer(lambda: explainer.shap_values(one, check_additivity=False), 5, goal=160.0),
    }
    return Case("Hidden DeepSHAP, yaw, 30 backgrounds", "shap-hidden", 200, peers, ", ".join(agreement), 20)


def pixel_shap_case(c: Context) -> Case:
    """DeepSHAP at the newest frame's pixels, yaw, 30 backgrounds."""
    t = c.ours.tensors
    # Neither knows the contrast layer; the rule of any other curve is the right one.
    deep_pytorch.op_handler["NearContrast"] = deep_pytorch.nonlinear_1d
    deep_lift.SUPPORTED_NON_LINEAR[networks.NearContrast] = deep_lift.nonlinear
    net = networks.Actor(c.actor.weights, only=YAW, explained=True)
    background, state = list(c.given("background")), list(c.state(0))
    explainer = shap.DeepExplainer(net, background)
    lift = captum.attr.DeepLiftShap(net)
    by_shap = explainer.shap_values(state, check_additivity=False)
    by_captum = lift.attribute(tuple(state), tuple(background))
    # Relative to the largest pixel: the rescale rule divides differences of rounded numbers.
    scale = float(np.abs(t["shap_pixels"]).max())
    agreement = [
        within("shap (of the largest pixel)", by_shap[0][0, ..., 0] / scale, t["shap_pixels"] / scale, 1e-2),
        within("captum", by_captum[0][0].detach().numpy() / scale, t["shap_pixels"] / scale, 1e-2),
    ]
    peers = {
        "shap": Peer(lambda: explainer.shap_values(state, check_additivity=False), goal=20.0),
        "captum": Peer(lambda: lift.attribute(tuple(state), tuple(background)), goal=20.0),
    }
    return Case("Pixel DeepSHAP, newest frame, yaw, 30 backgrounds", "shap-pixels", 1, peers, ", ".join(agreement), 3)


class Attacked(torch.nn.Module):
    """A frame to the yaw before its saturation, with what is beside it fixed: what ART differentiates."""

    def __init__(self, weights: networks.Weights, *beside: torch.Tensor) -> None:
        super().__init__()
        self.net, self.beside = networks.Actor(weights, saturated=False), beside

    def forward(self, frames: torch.Tensor) -> torch.Tensor:
        return self.net(frames, *(x.expand(len(frames), -1) for x in self.beside))[:, YAW : YAW + 1]


def attack_steps(setting: dict) -> tuple[float, float]:
    """Step and reach of a setting, as our attack has them."""
    epsilon, iterations = setting["epsilon_255"] / 255.0, setting["iterations"]
    if setting["method"] == "bim-accumulating":
        return epsilon, 1.0
    return min(ATTACK_STEP_GAIN * epsilon / iterations, epsilon), epsilon


def torch_bim(net: Attacked, frames: torch.Tensor, target: float, setting: dict) -> torch.Tensor:
    """BIM written in PyTorch."""
    step, reach = attack_steps(setting)
    low, high = (frames - reach).clamp(min=0.0), (frames + reach).clamp(max=1.0)
    x = frames.clone()
    for _ in range(setting["iterations"]):
        x.requires_grad_()
        (gradient,) = torch.autograd.grad((net(x) - target).square().sum(), x)
        x = torch.minimum(torch.maximum(x.detach() - step * gradient.sign(), low), high)
    return x


def art_bim(net: Attacked, setting: dict) -> BasicIterativeMethod:
    """ART's BIM with the same loss, step and reach."""
    step, reach = attack_steps(setting)
    shape = (1, frozen.ROWS, frozen.COLS)
    estimator = PyTorchRegressor(net, torch.nn.MSELoss(), shape, clip_values=(0.0, 1.0), device_type="cpu")
    iterations = setting["iterations"]
    return BasicIterativeMethod(estimator, reach, step, iterations, targeted=True, batch_size=1, verbose=False)


def attack_case(c: Context, strength: list[dict]) -> Case:
    """BIM, 20 iterations, on the newest frame; fills `strength` with the mean change of yaw at each setting."""
    t = c.ours.tensors
    settings, ours = json.loads(c.ours.notes["attacks"]), t["attack_yaw_changes"]
    nets = []
    for i in range(ours.shape[1]):
        frames, *beside = c.state(i)
        net = Attacked(c.actor.weights, *beside).eval().requires_grad_(False)
        target = -ATTACK_TARGET if float(t["state_action"][i, YAW]) >= 0.0 else ATTACK_TARGET
        nets.append((net, frames, target))
    for setting, mine in tqdm(list(zip(settings, ours)), desc="attack strength", leave=False):
        changes = []
        for net, frames, target in nets:
            attack = art_bim(net, setting)
            altered = torch.from_numpy(attack.generate(frames.numpy(), np.array([target], dtype=np.float32)))
            with torch.no_grad():
                before, after = net(frames).item(), net(altered).item()
            changes.append(frozen.LIMIT * (np.tanh(after) - np.tanh(before)))
        row = {"method": setting["method"], "epsilon_255": setting["epsilon_255"], "iterations": setting["iterations"]}
        row |= {"ours": float(np.abs(mine).mean()), "art": float(np.abs(changes).mean())}
        strength.append(row)
    weakest = min(row["ours"] - row["art"] for row in strength)
    net, frames, target = nets[0]
    y, first = np.array([target], dtype=np.float32), settings[0]
    by_art, by_torch = art_bim(net, first).generate(frames.numpy(), y), torch_bim(net, frames, target, first)
    agreement = within("ART and PyTorch between themselves", by_art, by_torch.numpy(), 1e-6)
    agreement += f"; mean change of yaw over {len(nets)} states, ours less ART's, at the least favourable of {len(strength)} settings: {weakest:+.0e}"
    paper = {"method": "bim-accumulating", "epsilon_255": 1.0, "iterations": 20}
    attack = art_bim(net, paper)
    peers = {
        "PyTorch": Peer(lambda: torch_bim(net, frames, target, paper), goal=5.6),
        "ART": Peer(lambda: attack.generate(frames.numpy(), y), goal=6.5),
    }
    return Case("BIM, 20 iterations, newest frame", "bim", 1, peers, agreement, 5)


def lstm_ad_case(c: Context) -> Case:
    """One window through LSTM-AD."""
    t = c.ours.tensors
    names = {name.removeprefix("lstm_ad_"): value for name, value in t.items() if name.startswith("lstm_ad_")}
    windows, scores = names.pop("windows"), names.pop("scores")
    session = export_onnx.session(networks.lstm_ad(names))
    feeds = [{"window": window[:, None, :]} for window in windows]
    by_onnx = np.array([session.run(["score"], feed)[0][0, 0] for feed in feeds])
    agreement = within("ONNX Runtime", by_onnx, scores, 1e-5)
    peers = {"ONNX Runtime": Peer(lambda: session.run(None, feeds[0]), 200, goal=1.0)}
    return Case("LSTM-AD, one window", "lstm-ad", 500, peers, agreement, 30)


def measure(case: Case, ours: Ours, rounds: int | None) -> dict:
    """Times both sides in turns."""

    def once(peer: Peer) -> float:
        if peer.time_ns is not None:
            return peer.time_ns(peer.runs)
        before = time.process_time_ns()
        for _ in range(peer.runs):
            peer.run()
        return (time.process_time_ns() - before) / peer.runs

    times: dict[str, list[float]] = {name: [] for name in ["ours", *case.peers]}
    for i in tqdm(range((rounds or case.rounds) + 1), desc=case.title, leave=False):
        mine = ours.ask(f"{case.ours} {case.runs}", f"our program ended in case {case.ours}")
        row = {"ours": mine} | {name: once(peer) for name, peer in case.peers.items()}
        # The first round warms caches and allocators.
        if i > 0:
            for name, ns in row.items():
                times[name].append(ns / 1e3)
    peers = {}
    for name, peer in case.peers.items():
        ratios = sorted(theirs / mine for theirs, mine in zip(times[name], times["ours"]))
        ratio = statistics.median(ratios)
        peers[name] = {
            "median_us": statistics.median(times[name]),
            "ratio": ratio,
            "ratio_low": ratios[0],
            "ratio_high": ratios[-1],
            "goal": peer.goal,
            "met": None if peer.goal is None else ratio >= peer.goal,
        }
    return {
        "title": case.title,
        "rounds": len(times["ours"]),
        "ours_median_us": statistics.median(times["ours"]),
        "peers": peers,
        "agreement": case.agreement,
    }


def table(results: dict) -> str:
    """The results as Markdown."""

    def us(x: float) -> str:
        return f"{x:.1f} µs" if x < 100 else f"{x:.0f} µs" if x < 1e4 else f"{x / 1e3:.0f} ms"

    lines = [
        f"{results['processor']}, {results['isa']}, load average {results['load_average']:g}; differences of results before timing: `results.json`.",
        "",
        "| Case | Ours | Peer | Theirs | Theirs / ours | Goal |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for short, case in results["cases"].items():
        for name, p in case["peers"].items():
            goal = "" if p["goal"] is None else f"≥ {p['goal']:g}: {'met' if p['met'] else 'missed'}"
            spread = f"**{p['ratio']:.2f}** ({p['ratio_low']:.2f}–{p['ratio_high']:.2f})"
            cells = [f"`{short}`", us(case["ours_median_us"]), name, us(p["median_us"]), spread, goal]
            lines.append(f"| {' | '.join(cells)} |")
    if results["attack_strength"]:
        apart = [abs(r["ours"] - r["art"]) for r in results["attack_strength"]]
        between = f"{np.median(apart):.2g} in the middle, {max(apart):.2g} at most"
        lines += ["", f"Our and ART's change of yaw (of ±1.5), {len(apart)} settings of BIM, differ by {between}."]
    return "\n".join(lines)


def merged(results: dict) -> dict:
    """With the cases that an earlier run measured in the same way and that this one left out."""
    file = HERE / "results.json"
    if not file.exists():
        return results
    earlier = json.loads(file.read_text())
    same = ("processor", "isa", "actor_sha256", "versions")
    if any(earlier.get(key) != results[key] for key in same):
        return results
    cases = earlier["cases"] | results["cases"]
    ordered = {name: cases[name] for name in ORDER if name in cases}
    return results | {"cases": ordered, "attack_strength": results["attack_strength"] or earlier["attack_strength"]}


def write(results: dict) -> None:
    """results.json, and the table in docs/peers.md."""
    (HERE / "results.json").write_text(json.dumps(results, indent=2, ensure_ascii=False) + "\n")
    text = DOCUMENT.read_text()
    before, rest = text.split(MARKS[0])
    _, after = rest.split(MARKS[1])
    DOCUMENT.write_text(f"{before}{MARKS[0]}\n\n{table(results)}\n\n{MARKS[1]}{after}")


def processor() -> str:
    """Its name."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def main() -> None:
    strength: list[dict] = []
    makers: dict[str, Callable[[Context], Case]] = {
        "actor": actor_case,
        "shap-hidden": hidden_shap_case,
        "shap-pixels": pixel_shap_case,
        "bim": lambda c: attack_case(c, strength),
        "lstm-ad": lstm_ad_case,
    }
    parser = argparse.ArgumentParser(prog="run.sh", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(makers)}; default: all")
    parser.add_argument("--rounds", type=int, help="rounds of each case, instead of its own number")
    parser.add_argument("--actor", type=Path, help="another actor.safetensors than the built-in one")
    parser.add_argument("--core", type=int, help="core to run on; default: the first one this process may use")
    parser.add_argument("--ours", type=Path, default=frozen.REPOSITORY / "target/release/vigil-peers", help=argparse.SUPPRESS)
    parser.add_argument("--tract", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--no-write", dest="write", action="store_false", help="leave results.json and docs/peers.md as they are")
    arguments = parser.parse_args()
    for name in arguments.cases:
        if name not in makers:
            parser.error(f"there is no case `{name}`; there are {', '.join(makers)}")
    if arguments.rounds is not None and arguments.rounds < 1:
        parser.error("--rounds must be 1 or more")
    core = arguments.core if arguments.core is not None else min(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {core})
    torch.set_num_threads(1)
    # captum says with every call that it sets hooks.
    warnings.filterwarnings("ignore", message="Setting forward, backward hooks")
    ours = Ours(arguments.ours, frozen.REPOSITORY / "target/peers", arguments.actor)
    context = Context(ours, frozen.load(arguments.actor or frozen.ACTOR), arguments.tract)
    if context.actor.sha256 != ours.notes["actor_sha256"]:
        raise SystemExit("our program holds another actor than the repository; build it again (tools/peers/run.sh does)")
    chosen = arguments.cases or list(makers)
    packages = ("torch", "onnxruntime", "shap", "captum", "adversarial-robustness-toolbox")
    results = {
        "processor": processor(),
        "isa": ours.notes["isa"],
        "actor_sha256": context.actor.sha256,
        "versions": {name: version(name) for name in packages},
        "load_average": round(os.getloadavg()[0], 1),
        "cases": {name: measure(makers[name](context), ours, arguments.rounds) for name in makers if name in chosen},
        "attack_strength": strength,
    }
    print(table(results))
    if arguments.write:
        write(merged(results))
        print(f"\nwritten to {HERE / 'results.json'} and {DOCUMENT}", file=sys.stderr)


if __name__ == "__main__":
    main()
