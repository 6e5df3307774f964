"""The splitter says what of a draft is squeeze; untrained, nothing is."""

import copy

import torch

from lerobot_dexflex.controller import ControllerConfig, DexFlexController


def test_untrained_it_takes_every_draft_for_motion(hand, history, draft):
    controller = DexFlexController(ControllerConfig(hand=hand.name)).eval().requires_grad_(False)
    squeeze = controller.squeeze(controller.encode(history), 100 * draft[0])
    assert squeeze.shape == (3, hand.n_fingers, 3)
    assert not squeeze.any()


def test_it_looks_at_state_and_draft_of_which_the_wildest_stays_bounded(controller, history, draft):
    trained = copy.deepcopy(controller)
    torch.nn.init.normal_(trained.splitter.out.weight, std=0.1, generator=torch.Generator().manual_seed(0))
    state = trained.encode(history)
    found = trained.squeeze(state, draft[0])
    assert not torch.equal(found, trained.squeeze(state, -draft[0]))
    other = trained.encode(history._replace(joints=history.joints + 0.1))
    assert not torch.equal(found, trained.squeeze(other, draft[0]))
    wild = [trained.squeeze(state, size * draft[0].sign()) for size in (0.06, 1e6)]
    torch.testing.assert_close(*wild)
