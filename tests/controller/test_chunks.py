import torch

from lerobot_dexflex.controller.chunks import ChunkScale, distance_to


def test_scale_is_isotropic_per_step_and_finger_and_inverts():
    torch.manual_seed(0)
    sizes = 0.001 * torch.arange(1, 9)[:, None] * torch.tensor([1.0, 2.0, 3.0, 0.5])
    chunks = sizes[..., None] * torch.randn(500, 8, 4, 3).clamp(-5, 5)
    scale = ChunkScale(4)
    scale.fit(chunks)
    torch.testing.assert_close(scale.scale, sizes, rtol=0.1, atol=0)
    values = scale.normalize(chunks)
    assert values.shape == (500, 4, 24)
    torch.testing.assert_close(values[:, 2, 3:6], chunks[:, 1, 2] / scale.scale[1, 2])
    torch.testing.assert_close(scale.restore(values), chunks, rtol=1e-5, atol=1e-9)


def test_a_wild_chunk_reaches_the_networks_bounded():
    scale = ChunkScale(4)
    assert scale.normalize(torch.full((1, 8, 4, 3), 10.0)).tolist() == [[[6.0] * 24] * 4]


def test_a_finger_that_never_moves_leaves_the_scale_positive():
    scale = ChunkScale(4)
    scale.fit(torch.zeros(5, 8, 4, 3))
    assert scale.scale.min() > 0
    assert scale.normalize(torch.zeros(1, 8, 4, 3)).eq(0).all()


def test_distance_is_the_rms_over_fingertips_in_millimetres():
    draft = torch.zeros(1, 8, 4, 3)
    chunks = draft.unsqueeze(1).clone()
    chunks[0, 0, :2, :, 0] = 0.003
    chunks[0, 0, :2, :, 1] = 0.004
    chunks[0, 0, 5] = 1.0
    assert torch.allclose(distance_to(chunks, draft), torch.tensor([[5.0]]))
