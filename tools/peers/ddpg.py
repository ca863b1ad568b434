"""Our DDPG update (docs/learning.md) in PyTorch: the same losses, gradients and steps on the same batch."""

import copy

import torch
from torch import nn

from actor import FEATURES, FRAMES, LIMIT
from networks import Encoder, Head, Weights, gru, linear

# Layers with more inputs learn at a lower rate; last biases at a higher one (tools/src/actor_training/networks.rs).
FULL_RATE_INPUTS = 64.0
LAST_BIAS_SHARE = 20.0


class ActorNet(nn.Module):
    """Behind the encoder: features [n, 5, 1024] and position to the outputs before saturation."""

    def __init__(self, weights: Weights) -> None:
        super().__init__()
        self.gru, self.head = gru(weights), Head(weights, saturated=False)

    def forward(self, features: torch.Tensor, position: torch.Tensor) -> torch.Tensor:
        return self.head(self.gru(features)[1][0], position)


class CriticNet(nn.Module):
    """Behind the encoder: features, position and action to the value."""

    def __init__(self, weights: Weights) -> None:
        super().__init__()
        self.gru, self.positional = gru(weights), linear(weights, "positional")
        self.dense, self.dense_2, self.output = (linear(weights, name) for name in ("dense", "dense_2", "output"))

    def state(self, features: torch.Tensor) -> torch.Tensor:
        """The GRU's state."""
        return self.gru(features)[1][0]

    def value(self, state: torch.Tensor, position: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """Of an action in a state."""
        joined = torch.cat([torch.tanh(state), torch.tanh(self.positional(position)), action], dim=1)
        hidden = nn.functional.elu(self.dense_2(nn.functional.elu(self.dense(joined))))
        return self.output(hidden)[:, 0]


def squash(pre: torch.Tensor) -> torch.Tensor:
    """The action."""
    return LIMIT * torch.tanh(pre)


def groups(modules: list[nn.Module], rate: float) -> list[dict]:
    """Adam's parameter groups with their rates."""
    found = []
    for module in modules:
        for name, parameter in module.named_parameters():
            share = 1.0
            if parameter.ndim == 4 or name.endswith("weight_ih_l0"):
                share = min(1.0, FULL_RATE_INPUTS / parameter[0].numel())
            elif name.endswith("output.bias"):
                share = LAST_BIAS_SHARE
            found.append({"params": [parameter], "lr": rate * share})
    return found


class Ddpg:
    """All networks and their optimisers.

    `as_trained`: two of five frames train the encoder, half of the transitions are mirrored, and an imitation is added, as our
    training has it. Otherwise DDPG as it is written.
    """

    def __init__(self, actor: Weights, critic: Weights, config: dict[str, float], as_trained: bool, bf16: bool = False) -> None:
        self.config, self.as_trained, self.bf16 = config, as_trained, bf16
        self.encoder, self.actor, self.critic = Encoder(actor), ActorNet(actor), CriticNet(critic)
        self.encoder.to(memory_format=torch.channels_last)
        self.online = [self.encoder, self.actor, self.critic]
        self.targets = copy.deepcopy(self.online)
        self.weights, self.slow = (
            [p for module in modules for p in module.parameters()] for modules in (self.online, self.targets)
        )
        for parameter in self.slow:
            parameter.requires_grad_(False)
        options = {"betas": (0.9, 0.999), "eps": 1e-8, "fused": True}
        critic_groups = groups([self.encoder, self.critic], config["critic_rate"])
        self.critic_adam = torch.optim.Adam(critic_groups, **options)
        self.actor_adam = torch.optim.Adam(groups([self.actor], config["actor_rate"]), **options)
        self.generator = torch.Generator().manual_seed(1)

    def encode(self, encoder: Encoder, frames: torch.Tensor) -> torch.Tensor:
        """Kept frames [m, 128, 256] to features [m, 1024]."""
        contrast = frames[:, None].float().mul_(1.0 / 255.0).contiguous(memory_format=torch.channels_last)
        with torch.autocast("cpu", torch.bfloat16, enabled=self.bf16):
            return encoder(contrast).float()

    def update(self, batch: dict[str, torch.Tensor]) -> dict[str, float]:
        """One update; what it saw."""
        frames, next_frames = batch["frames"], batch["next_frames"]
        position, next_position = batch["position"], batch["next_position"]
        action, guide, n = batch["action"], batch["guide"], len(batch["action"])
        if self.as_trained:
            mirror = torch.rand(n, generator=self.generator) < 0.5
            sign = torch.stack([torch.ones(n), 1.0 - 2.0 * mirror], dim=1)
            frames, next_frames = (f.clone() for f in (frames, next_frames))
            for f in (frames, next_frames):
                f[mirror] = f[mirror].flip(-1)
            position, next_position, action, guide = (x * sign for x in (position, next_position, action, guide))
        shape = (n, FRAMES, FEATURES)
        target_encoder, target_actor, target_critic = self.targets
        with torch.no_grad():
            features = self.encode(target_encoder, next_frames.flatten(0, 1)).reshape(shape)
            next_action = squash(target_actor(features, next_position))
            next_value = target_critic.value(target_critic.state(features), next_position, next_action)
            aim = batch["reward"] + batch["discount"] * next_value
        if self.as_trained:
            features = self.encode_two(frames)
        else:
            features = self.encode(self.encoder, frames.flatten(0, 1)).reshape(shape)

        # Critic, and the encoder with it.
        cut = features.detach().requires_grad_()
        state = self.critic.state(cut)
        error = self.critic.value(state, position, action) - aim
        critic_loss = (batch["weight"] * error.square()).mean()
        d_features, *critic_gradients = torch.autograd.grad(critic_loss, [cut, *self.critic.parameters()])

        # Actor: what the critic says stops at the features.
        pre = self.actor(cut, position)
        mine = squash(pre)
        excess = (pre.abs() - 1.0).clamp(min=0.0).square().sum(1)
        value = self.critic.value(state.detach(), position, mine)
        by_value = self.config["value_weight"] if self.as_trained else 1.0
        actor_loss = (self.config["saturation_penalty"] * excess - by_value * value).mean()
        actor_parameters = list(self.actor.parameters())
        actor_gradients = torch.autograd.grad(actor_loss, actor_parameters, retain_graph=self.as_trained)
        if self.as_trained:
            width = self.config["imitation_width"]
            imitation = nn.functional.smooth_l1_loss(mine, guide, beta=width, reduction="none").sum(1).mean()
            d_imitation, *more = torch.autograd.grad(imitation, [cut, *actor_parameters])
            d_features = d_features + d_imitation
            actor_gradients = [a + b for a, b in zip(actor_gradients, more)]
        for parameters, gradients in ((self.critic.parameters(), critic_gradients), (actor_parameters, actor_gradients)):
            for parameter, gradient in zip(parameters, gradients):
                parameter.grad = gradient
        for parameter in self.encoder.parameters():
            parameter.grad = None
        features.backward(d_features)

        limit = self.config["gradient_norm"]
        with_critic = [*self.encoder.parameters(), *self.critic.parameters()]
        critic_norm = torch.nn.utils.clip_grad_norm_(with_critic, limit)
        actor_norm = torch.nn.utils.clip_grad_norm_(actor_parameters, limit)
        self.critic_adam.step()
        self.actor_adam.step()
        with torch.no_grad():
            torch._foreach_lerp_(self.slow, self.weights, self.config["tau"])
        return {
            "critic_loss": critic_loss.item(),
            "value": value.mean().item(),
            "critic_norm": critic_norm.item(),
            "actor_norm": actor_norm.item(),
        }

    def encode_two(self, frames: torch.Tensor) -> torch.Tensor:
        """Features of five frames; the gradient goes through the newest and, four times, through one of the older."""
        n = len(frames)
        drawn = torch.randint(0, FRAMES - 1, (n,), generator=self.generator)
        rows = torch.arange(n)
        taught = torch.zeros(n, FRAMES, dtype=torch.bool)
        taught[rows, drawn] = taught[:, -1] = True
        features = torch.empty(n, FRAMES, FEATURES)
        with torch.no_grad():
            features[~taught] = self.encode(self.encoder, frames[~taught])
        live = self.encode(self.encoder, frames[taught])
        share = torch.where(taught, 1.0, 0.0)
        share[rows, drawn] = float(FRAMES - 1)
        still = live.detach()
        features[taught] = still + share[taught][:, None] * (live - still)
        return features

    def first_moments(self) -> dict[str, torch.Tensor]:
        """Adam's running means of encoder, actor and critic, by name."""
        means = {}
        for name, module, adam in (
            ("encoder", self.encoder, self.critic_adam),
            ("actor", self.actor, self.actor_adam),
            ("critic", self.critic, self.critic_adam),
        ):
            for key, parameter in module.named_parameters():
                means[f"{name}.{key}"] = adam.state[parameter]["exp_avg"]
        return means


def batch_of(ours: dict) -> dict[str, torch.Tensor]:
    """The recorded batch."""
    return {key.removeprefix("batch_"): torch.from_numpy(ours[key]) for key in ours if key.startswith("batch_")}
