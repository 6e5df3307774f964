import torch

from lerobot_dexflex.controller import SelectionSettings
from lerobot_dexflex.controller.chunks import ChunkScale, distance_to, seed_chunks


def test_scale_is_isotropic_per_finger_and_inverts():
    chunks = 0.002 * torch.randn(500, 8, 4, 3) * torch.tensor([1.0, 2.0, 3.0, 0.5])[:, None]
    scale = ChunkScale()
    scale.fit(chunks)
    values = scale.normalize(chunks)
    assert values.shape == (500, 96)
    assert torch.allclose(scale.restore(values), chunks, atol=1e-8)
    assert torch.allclose(scale.scale, 0.002 * torch.tensor([1.0, 2.0, 3.0, 0.5]), rtol=0.05)


def test_seeds_cycle_over_levels_then_kinds():
    draft, past = torch.ones(1, 8, 4, 3), torch.zeros(1, 8, 4, 3)
    past[:, -1] = 3.0
    settings = SelectionSettings(n_seeded=8, levels=(0.5, 0.75), seeds=("draft", "mean", "0.5"))
    values = seed_chunks(draft, past, settings)[0, :, 0, 0, 0]
    assert values.tolist() == [1, 1, 2, 2, 0.5, 0.5, 1, 1]


def test_distance_is_the_rms_over_fingertips_in_millimetres():
    draft = torch.zeros(1, 8, 4, 3)
    chunks = draft.unsqueeze(1).clone()
    chunks[0, 0, :2, :, 0] = 0.003
    chunks[0, 0, :2, :, 1] = 0.004
    chunks[0, 0, 5] = 1.0
    assert torch.allclose(distance_to(chunks, draft), torch.tensor([[5.0]]))
