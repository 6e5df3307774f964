"""Encode what the hand feels into a body latent, a contact latent, a token per finger and a slow token."""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional
from vector_quantize_pytorch import FSQ

from lerobot_dexflex.controller.config import ControllerConfig
from lerobot_dexflex.controller.history import History

_TOUCH_FEATURES = 48
_HEADS = 4
_LEAST_SUM, _FORCE_UNIT = 0.02, 4.0
"""The centre of pressure fades out below this load, and loads count in this unit [N]."""


class State(NamedTuple):
    """An encoded history; all that the other networks know of the world."""

    body: Tensor
    """p, from proprioception. Shape (batch, body_width)."""
    contact: Tensor
    """c, from attention over the fingers. Shape (batch, contact_width)."""
    fingers: Tensor
    """Finger tokens. Shape (batch, fingers, finger_width)."""
    slow: Tensor
    """Embedding of the slow discrete token g. Shape (batch, slow_width)."""

    @property
    def latent(self) -> Tensor:
        """Z = [p, c, finger tokens]. Shape (batch, latent_width)."""
        return torch.cat([self.body, self.contact, self.fingers.flatten(1)], -1)

    @property
    def features(self) -> Tensor:
        """Z and the slow token. Shape (batch, feature_width)."""
        return torch.cat([self.latent, self.slow], -1)


class TouchNet(nn.Module):
    """Features of one fingertip's taxels: a small image, its channels the frames; the load and its centre."""

    rows: Tensor
    columns: Tensor

    def __init__(self, config: ControllerConfig) -> None:
        super().__init__()
        frames, (rows, columns) = len(config.frames), config.layout.taxels
        self.register_buffer("rows", torch.linspace(-1, 1, rows), persistent=False)
        self.register_buffer("columns", torch.linspace(-1, 1, columns), persistent=False)
        self.touch_scale = config.touch_scale
        self.convolutions = nn.Sequential(
            nn.Conv2d(frames, 12, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.Conv2d(12, 24, 3, padding=1),
            nn.ReLU(),
        )
        self.out = nn.Linear(24 * ((rows + 1) // 2) * ((columns + 1) // 2) + frames + 3, _TOUCH_FEATURES)

    def forward(self, tactile: Tensor) -> Tensor:
        """Map forces (batch, frames, fingers, *taxels) [N] to features (batch, fingers, 48)."""
        images = tactile.transpose(1, 2)  # (batch, fingers, frames, *taxels)
        total = images.sum((-1, -2))  # (batch, fingers, frames)
        maps = self.convolutions(compress(images, self.touch_scale).flatten(0, 1)).flatten(1)
        newest, sum_now = images[:, :, 0], total[:, :, 0].clamp(min=_LEAST_SUM)
        along = (newest.sum(-1) * self.rows).sum(-1) / sum_now
        across = (newest.sum(-2) * self.columns).sum(-1) / sum_now
        plain = torch.stack([along, across, total[:, :, 0] / _FORCE_UNIT], -1)
        loads = compress(total, self.touch_scale)
        return self.out(torch.cat([maps.unflatten(0, total.shape[:2]), loads, plain], -1))


class SlowToken(nn.Module):
    """Quantise 1.5 seconds of loads and fingertip motion into one of a few codes."""

    def __init__(self, config: ControllerConfig) -> None:
        super().__init__()
        self.config = config
        width = config.n_fingers * (config.slow_samples * (1 + 3) + 1)
        last = nn.Linear(64, len(config.slow_levels))
        nn.init.normal_(last.weight, std=0.5)  # Spread over the codes from the start.
        self.squeeze = nn.Sequential(nn.Linear(width, 64), nn.SiLU(), last)
        self.quantizer = FSQ(levels=list(config.slow_levels))
        self.embed = nn.Sequential(
            nn.Linear(len(config.slow_levels), 32), nn.SiLU(), nn.Linear(32, config.slow_width)
        )
        self.missing = nn.Parameter(torch.zeros(config.slow_width))

    def forward(self, history: History) -> tuple[Tensor, Tensor]:
        """Return the embedding (batch, slow_width) and the code (batch,)."""
        hidden = history.tactile_missing
        loads = compress(history.slow_loads, self.config.touch_scale).masked_fill(hidden[:, None], 0)
        tips = history.slow_fingertips
        moves = (tips[:, 1:] - tips[:, :1]) / (4 * self.config.tip_step_scale)
        place = (tips[:, 0] - tips[:, 0].mean(1, keepdim=True)) / self.config.tip_scale
        parts = [loads.flatten(1), moves.flatten(1), place.flatten(1), hidden.to(loads)]
        codes, indices = self.quantizer(self.squeeze(torch.cat(parts, -1)).unsqueeze(1))
        absent = history.slow_missing[:, None]
        return torch.where(absent, self.missing, self.embed(codes.squeeze(1))), indices.squeeze(1)


class Encoder(nn.Module):
    """From a `History` to a `State`.

    Latents are layer-normed, so that predicting them is a bounded problem. Touch that is missing, or was
    never to be used, is replaced by a learned token of its finger.
    """

    tip_center: Tensor
    joint_center: Tensor
    joint_range: Tensor
    finger_joints: Tensor

    def __init__(self, config: ControllerConfig) -> None:
        super().__init__()
        self.config = config
        layout = config.layout
        for name, values in {
            "joint_center": layout.joint_center(),
            "joint_range": layout.joint_range(),
            "tip_center": layout.tip_center(),
        }.items():
            self.register_buffer(name, torch.from_numpy(values).float(), persistent=False)
        self.register_buffer("finger_joints", torch.from_numpy(layout.finger_joints()), persistent=False)
        frames, fingers, geometry = len(config.frames), layout.n_fingers, layout.geometry_width
        self.touch = TouchNet(config)
        self.missing_touch = nn.Parameter(torch.zeros(fingers, _TOUCH_FEATURES))
        local = _TOUCH_FEATURES + frames * (self.finger_joints.shape[1] + 3) + 9 + 3 + geometry
        self.finger_bias = nn.Parameter(torch.randn(fingers, 96) * 0.1)
        self.finger_in = nn.Linear(local, 96)
        self.finger_out = nn.Linear(96, config.finger_width)
        self.body = nn.Sequential(
            nn.Linear(frames * (layout.n_joints + 3 * fingers) + 3 + fingers * geometry, 192),
            nn.SiLU(),
            nn.Linear(192, config.body_width),
        )
        self.query = nn.Linear(config.body_width, config.finger_width)
        self.key_value = nn.Linear(config.finger_width, 2 * config.finger_width)
        self.finger_place = nn.Parameter(torch.randn(fingers, config.finger_width) * 0.1)
        self.contact = nn.Sequential(
            nn.Linear((1 + fingers) * config.finger_width, 128),
            nn.SiLU(),
            nn.Linear(128, config.contact_width),
        )
        self.slow = SlowToken(config)
        self.load_head = nn.Linear(config.finger_width, 1)
        self.contact_head = nn.Linear(config.finger_width + config.body_width + config.contact_width, 1)
        self.grip_head = nn.Linear(config.slow_width, fingers)

    def forward(self, history: History, slow: Tensor | None = None) -> State:
        """Encode a history.

        Args:
            history: The states and their past.
            slow: Slow token to use, as `slow_token` returned it up to 8 steps ago; None computes it.
                Shape (batch, slow_width).
        """
        joints, tips = self._proprioception(history)
        missing = history.tactile_missing
        if not self.config.use_touch:
            missing = torch.ones_like(missing)
        touch = torch.where(missing[..., None], self.missing_touch, self.touch(history.tactile))
        rotation, geometry = history.rotations, history.geometry
        gravity = (rotation.mT @ history.gravity[:, None, :, None]).squeeze(-1)
        own = functional.pad(joints, (0, 1))[..., self.finger_joints]  # (batch, frames, fingers, longest)
        moves = own.transpose(1, 2).flatten(2), tips.transpose(1, 2).flatten(2)
        local = torch.cat([touch, *moves, rotation.flatten(2), gravity, geometry], -1)
        hidden = functional.silu(self.finger_in(local) + self.finger_bias)
        fingers = _norm(self.finger_out(hidden))
        whole = [joints.flatten(1), tips.flatten(1), history.gravity, geometry.flatten(1)]
        body = _norm(self.body(torch.cat(whole, -1)))
        if slow is None:
            slow = self.slow_token(history)
        return State(body, self._pool(body, fingers), fingers, slow)

    def slow_token(self, history: History) -> Tensor:
        """Return the slow token's embedding, to be cached for up to 8 steps. Shape (batch, slow_width)."""
        if not self.config.use_slow:
            history = history.without_slow()
        if not self.config.use_touch:
            history = history.without_touch()
        return self.slow(history)[0]

    def readout(self, state: State) -> tuple[Tensor, Tensor, Tensor]:
        """Return what the latents say in plain terms.

        Returns:
            log(1 + load [N]) per finger, the logit that it carries load a horizon later, and what the slow
            token alone says of log(1 + right force [N]); (batch, fingers) each.
        """
        shared = (
            torch.cat([state.body, state.contact], -1).unsqueeze(1).expand(-1, state.fingers.shape[1], -1)
        )
        later = self.contact_head(torch.cat([state.fingers, shared], -1)).squeeze(-1)
        return self.load_head(state.fingers).squeeze(-1), later, self.grip_head(state.slow)

    def _proprioception(self, history: History) -> tuple[Tensor, Tensor]:
        """Return joints (batch, frames, joints) and tips (batch, frames, fingers, 3): now, then changes."""
        joints, tips, config = history.joints, history.fingertips, self.config
        place = (joints[:, :1] - self.joint_center) / self.joint_range
        turned = (joints[:, :1] - joints[:, 1:]) / config.joint_step_scale
        where = (tips[:, :1] - self.tip_center) / config.tip_scale
        moved = (tips[:, :1] - tips[:, 1:]) / config.tip_step_scale
        return torch.cat([place, turned], 1), torch.cat([where, moved], 1)

    def _pool(self, body: Tensor, fingers: Tensor) -> Tensor:
        """Attend from the body to the fingers and mix with their tokens."""
        tokens = fingers + self.finger_place
        keys, values = self.key_value(tokens).unflatten(-1, (2, _HEADS, -1)).permute(2, 0, 3, 1, 4)
        query = self.query(body).unflatten(-1, (_HEADS, 1, -1))  # (batch, heads, 1, head_dim)
        weights = (query * keys).sum(-1).mul(keys.shape[-1] ** -0.5).softmax(-1)  # (batch, heads, fingers)
        pooled = (weights.unsqueeze(-1) * values).sum(2).flatten(1)
        return _norm(self.contact(torch.cat([pooled, fingers.flatten(1)], -1)))


def compress(force: Tensor, scale: float) -> Tensor:
    """Resolve light touch and bound strong touch: asinh of force over scale, both [N]."""
    return torch.asinh(force / scale)


def _norm(x: Tensor) -> Tensor:
    return functional.layer_norm(x, x.shape[-1:])
