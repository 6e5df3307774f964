"""The forces of the decoder are bounded, and only fingers that are likely to press have a grip."""

import copy

import torch
from torch.nn.functional import normalize

from lerobot_dexflex.controller.decoder import Forces


def test_no_force_exceeds_the_largest_and_its_direction_stays(hand, controller, history, draft):
    state = controller.encode(history)
    vectors = []
    for factor in (1000.0, 0.1):
        scaled = copy.deepcopy(controller)
        for value in scaled.decoder.out.parameters():
            value.mul_(factor)
        vectors.append(scaled.decode(state, draft[0]).vector)
    large, small = vectors
    largest = controller.config.largest_force
    torch.testing.assert_close(large.norm(dim=-1), torch.full((3, hand.n_fingers), largest))
    assert small.norm(dim=-1).max() < largest
    torch.testing.assert_close(normalize(large, dim=-1), normalize(small, dim=-1))


def test_fingers_that_are_unlikely_to_press_have_no_grip():
    vector = torch.arange(12.0).view(1, 4, 3) + 1
    grip = Forces(vector, torch.tensor([[-3.0, -0.01, 0.01, 3.0]])).grip()
    assert torch.equal(grip, vector * torch.tensor([0.0, 0.0, 1.0, 1.0])[:, None])


def test_forces_depend_on_the_motion_that_is_executed(controller, history, draft):
    state = controller.encode(history)
    assert not torch.equal(
        controller.decode(state, draft[0]).vector, controller.decode(state, -draft[0]).vector
    )
