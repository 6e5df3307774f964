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
        shards = [_shard(generator) for _ in range(2)]
        for number, shard in enumerate(shards):
            _save(shard, root / split / f"{number:05d}.safetensors")
        _save(_replays(shards[-1], generator), root / "replays" / split / "00000.safetensors")
    return root


def _save(tensors, path):
    path.parent.mkdir(parents=True, exist_ok=True)
    save_file({k: v.contiguous() for k, v in tensors.items()}, path, metadata={"episodes": json.dumps([])})


def _shard(generator):
    """Six episodes side by side, then one after the other."""

    def noise(*shape):
        return torch.randn(EPISODES, *shape, generator=generator)

    kind = torch.tensor([0, 1, 2, 3, 0, 4], dtype=torch.uint8)
    operated = ((kind == 1) | (kind == 3)).view(-1, 1, 1)
    joints = (JOINT_LOWER + JOINT_UPPER).float() / 2 + 0.2 * noise(16)
    target, command, phase = joints, fingertips(joints), 3 * noise(4)
    gravity = torch.nn.functional.normalize(noise(3), dim=-1)
    steps = []
    for step in range(STEPS):
        loads = (0.5 * torch.sin(step / 6 + phase)).clamp(min=0)
        label = 0.001 * (loads[..., None] - 0.2) * torch.tensor([1.0, -1.0, 0.5])
        draft = label + operated * 0.001 * noise(4, 3)
        wanted = torch.cat([command + label, command + draft]).double()
        solved = solve_fingertips(wanted, target.double().repeat(2, 1), iterations=1).float()
        label_joints, target = solved.split(EPISODES)
        row = {
            "joints": joints,
            "fingertips": fingertips(joints),
            "gravity": gravity,
            "tactile": (loads / 60).repeat_interleave(60, -1).half(),
            "command": command,
            "draft": draft,
            "label": label,
            "executed": draft,
            "joint_targets": target,
            "label_joints": label_joints,
            "loads": loads,
            "expert": (kind == 0) | (kind == 2),
            "lost": (loads > 0.05).sum(1) < 2,
            "step": torch.full((EPISODES,), step, dtype=torch.int16),
            "episode": torch.arange(EPISODES, dtype=torch.int32),
            "kind": kind,
        }
        steps.append(row)
        command, joints = command + draft, target + 0.002 * noise(16)
    return {key: torch.stack([row[key] for row in steps], 1).flatten(0, 1) for key in steps[0]}


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
