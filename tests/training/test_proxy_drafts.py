import torch

from lerobot_dexflex.training import proxy_drafts
from lerobot_dexflex.training.proxy_drafts import constant_velocity


def motion(rows=400):
    torch.manual_seed(0)
    return 0.001 * torch.randn(rows, 16, 4, 3)


def test_drafts_have_the_shape_of_motion_and_leave_it_alone():
    clean = motion()
    before = clean.clone()
    draft, past = proxy_drafts.proxy_drafts(clean[:, :8], clean[:, 8:])
    assert draft.shape == past.shape == (400, 8, 4, 3)
    assert torch.equal(clean, before)
    held = (draft == draft[:, :1]).flatten(1).all(1).double().mean()
    assert 0.55 < held < 0.8
    assert (draft - clean[:, 8:]).abs().max() < 0.02


def test_constant_velocity_repeats_the_first_displacement():
    assert torch.equal(constant_velocity(motion()[:, 0])[:, 5], motion()[:, 0])


def test_delay_moves_the_past_into_the_draft():
    clean = motion()
    delayed = proxy_drafts._delay(clean)
    steps = [next(n for n in (1, 2, 3) if torch.equal(delayed[k, 8], clean[k, 8 - n])) for k in range(400)]
    assert set(steps) == {1, 2, 3}


def test_only_one_finger_is_lost_or_pushed():
    clean = motion()
    changed = (proxy_drafts._fingers(clean) != clean).any(1).any(-1).sum(1)
    assert changed.max() == 1


def test_every_way_keeps_a_millimetre_motion_below_a_centimetre():
    clean = motion()
    for way in ("_same", "_noise", "_gain", "_delay", "_fingers", "_bias", "_smooth"):
        corrupted = getattr(proxy_drafts, way)(clean)
        assert corrupted.shape == clean.shape
        assert corrupted.abs().max() < 0.01, way
