import pytest
import torch

from lerobot_dexflex.corpus.schema import columns, snapshot_columns
from lerobot_dexflex.corpus.shard import Shard, shard_path, write_shard
from lerobot_dexflex.hand.kinematics import finger_frames, fingertips, joint_limits
from lerobot_dexflex.hands import LEAP, SHARPA

EPISODES, STEPS = 6, 48
AHEAD = torch.arange(1, 9)[:, None, None]


def make_corpus(hand, root, seed=0):
    """Write a small corpus in the schema: plans and forces depend on touch, drafts are spoilt at times."""
    generator = torch.Generator().manual_seed(seed)
    for split in ("train", "tune"):
        for number in range(2):
            write_shard(shard_path(root / split, number), _shard(hand, generator))
    return root


def _shard(hand, generator):
    """Six episodes side by side, then one after the other."""

    def noise(*shape):
        return torch.randn(EPISODES, *shape, generator=generator)

    fingers, lengths = hand.n_fingers, torch.bincount(torch.tensor(hand.finger_of_joint))
    lower, upper = joint_limits(hand)
    joints = (lower + upper).float() / 2 + 0.2 * noise(hand.n_joints)
    phase, gravity = 3 * noise(fingers), torch.nn.functional.normalize(noise(3), dim=-1)
    pose = torch.cat([0.1 + 0.01 * noise(3), torch.nn.functional.normalize(noise(4), dim=-1)], -1)
    steps = []
    for step in range(STEPS):
        loads = (2 * torch.sin(step / 6 + phase)).clamp(min=0)
        tips = fingertips(hand, joints)
        plan = 0.001 * AHEAD * (loads[:, None, :, None] - 1) * torch.tensor([1.0, -1.0, 0.5])
        spoilt = torch.arange(EPISODES) % 2 == (step // 12) % 2
        draft = plan + spoilt.view(-1, 1, 1, 1) * 0.003 * noise(1, fingers, 3)
        local = loads[..., None] * torch.tensor([0.6, 0.0, 0.8])
        rotation = finger_frames(hand, joints).distal_rotation
        pose = torch.cat([pose[:, :3] + 0.002 * noise(3), pose[:, 3:]], -1)
        row = {
            "joints": joints,
            "fingertips": tips,
            "gravity": gravity,
            "tactile": (loads / 60).repeat_interleave(60, -1),
            "draft": draft,
            "plan": plan,
            "forces": (rotation @ local[..., None]).squeeze(-1),
            "wanted": tips + draft[:, 0],
            "joint_targets": joints + 0.05 * loads.repeat_interleave(lengths, -1),
            "loads": loads,
            "object": pose,
            "expert": ~spoilt,
            "lost": (loads > 0.05).sum(1) < 2,
            "step": torch.full((EPISODES,), step),
            "episode": torch.arange(EPISODES),
            "kind": torch.arange(EPISODES) % 2,
        }
        steps.append(row)
        joints = joints + 0.02 * noise(hand.n_joints)
    tensors = {key: torch.stack([row[key] for row in steps], 1).flatten(0, 1) for key in steps[0]}
    tensors |= {"snapshot_step": torch.zeros(1), "snapshot_physics": torch.zeros(1, 2)}
    tensors |= {"snapshot_command": torch.zeros(1, hand.n_joints)}
    types = columns(hand) | snapshot_columns(hand)
    typed = {key: value.numpy().astype(types[key].dtype) for key, value in tensors.items()}
    return Shard(hand, typed, [{} for _ in range(EPISODES)], {})


@pytest.fixture(scope="session")
def corpora(tmp_path_factory):
    """A corpus of every hand, by the hand's name."""
    return {hand.name: make_corpus(hand, tmp_path_factory.mktemp(hand.name)) for hand in (LEAP, SHARPA)}


@pytest.fixture(scope="session")
def corpus(corpora):
    return corpora[LEAP.name]


@pytest.fixture
def no_curves(monkeypatch):
    """Draw no curves: that takes longer than such a small training."""
    monkeypatch.setattr("lerobot_dexflex.training.curves.plot_curves", lambda folder: None)


@pytest.fixture
def learn():
    """Returns a function that trains a stage on one batch and returns the first and the last loss."""

    def learn(stage, steps=25, lr=2e-3):
        batch = stage.batch()
        optimizer = torch.optim.AdamW(stage.network.parameters(), lr=lr)
        losses = []
        for _ in range(steps):
            torch.manual_seed(0)
            loss, info = stage.loss(batch)
            assert all(torch.isfinite(v) for v in info.values())
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            losses.append(float(loss.detach()))
        stage.average.load_state_dict(stage.network.state_dict())
        stage.network.eval().requires_grad_(False)
        return losses[0], losses[-1]

    return learn
