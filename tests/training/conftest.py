import json

import pytest
import torch
from safetensors.torch import save_file

from lerobot_dexflex.hand.kinematics import JOINT_LOWER, JOINT_UPPER, fingertips, solve_fingertips

EPISODES, STEPS, REPLAYS = 6, 48, 40


def make_corpus(root, seed=0):
    """Write a small corpus in the schema; labels depend on touch, and operators are disturbed."""
    generator = torch.Generator().manual_seed(seed)
    for split in ("train", "tune"):
        for number in range(2):
            shard = _shard(generator)
            _save(shard, root / split / f"{number:05d}.safetensors")
        _save(_replays(shard, generator), root / "replays" / split / "00000.safetensors")
    return root


def _save(tensors, path):
    path.parent.mkdir(parents=True, exist_ok=True)
    save_file({k: v.contiguous() for k, v in tensors.items()}, path, metadata={"episodes": json.dumps([])})


def _shard(generator):
    episodes = [_episode(k, generator) for k in range(EPISODES)]
    return {key: torch.cat([episode[key] for episode in episodes]) for key in episodes[0]}


def _episode(number, generator):
    def noise(*shape):
        return torch.randn(*shape, generator=generator)

    kind = (0, 1, 2, 3, 0, 4)[number]
    joints = (JOINT_LOWER + JOINT_UPPER).float() / 2 + 0.2 * noise(16)
    phase = 3 * noise(4)
    command = fingertips(joints[None])[0]
    target = joints.clone()
    gravity = torch.nn.functional.normalize(noise(3), dim=0)
    rows = []
    for step in range(STEPS):
        tips = fingertips(joints[None])[0]
        loads = (0.5 * torch.sin(step / 6 + phase)).clamp(min=0)
        tactile = (loads[:, None] * torch.ones(60) / 60).flatten()
        label = 0.001 * (loads[:, None] - 0.2) * torch.tensor([1.0, -1.0, 0.5])
        draft = label if kind in (0, 2, 4) else label + 0.001 * noise(4, 3)
        executed = draft
        label_joints, target = solve_fingertips(
            torch.stack([command + label, command + executed]).double(), target.double().expand(2, -1)
        )
        rows.append(
            {
                "joints": joints,
                "fingertips": tips,
                "gravity": gravity,
                "tactile": tactile.half(),
                "command": command,
                "draft": draft,
                "label": label,
                "executed": executed,
                "joint_targets": target.float(),
                "label_joints": label_joints.float(),
                "loads": loads,
                "expert": torch.tensor(kind in (0, 2)),
                "lost": (loads > 0.05).sum() < 2,
                "step": torch.tensor(step, dtype=torch.int16),
                "episode": torch.tensor(number, dtype=torch.int32),
                "kind": torch.tensor(kind, dtype=torch.uint8),
            }
        )
        command = command + executed
        target = target.float()
        joints = target + 0.002 * noise(16)
    return {key: torch.stack([row[key] for row in rows]) for key in rows[0]}


def _replays(shard, generator):
    rows = torch.randint(10, STEPS - 9, (REPLAYS,), generator=generator)
    ahead = rows[:, None] + torch.arange(1, 9)
    return {
        "shard": torch.ones(REPLAYS, dtype=torch.int32),
        "row": rows.int(),
        "source": (torch.arange(REPLAYS) % 4).to(torch.uint8),
        "chunk": shard["executed"][ahead - 1],
        "joints": shard["joints"][ahead],
        "fingertips": shard["fingertips"][ahead],
        "tactile": shard["tactile"][ahead],
        "loads": shard["loads"][ahead],
        "lost": shard["lost"][ahead - 1].any(1),
        "object_motion": torch.zeros(REPLAYS, 2),
    }


@pytest.fixture(scope="session")
def corpus(tmp_path_factory):
    return make_corpus(tmp_path_factory.mktemp("corpus"))
