import pytest
import torch

from lerobot_dexflex.controller import ControllerConfig, DexFlexController, History
from lerobot_dexflex.hand.kinematics import finger_frames
from lerobot_dexflex.hands import LEAP, SHARPA


@pytest.fixture(scope="session", params=[LEAP, SHARPA], ids=lambda hand: hand.name)
def hand(request):
    """Four fingers of four joints each; five, of which two have five joints."""
    return request.param


@pytest.fixture(scope="session")
def controller(hand):
    """A controller with random weights in every layer, also those that begin at zero, but for the splitter's
    last: it takes every draft for motion."""
    torch.manual_seed(0)
    controller = DexFlexController(ControllerConfig(hand=hand.name)).eval().requires_grad_(False)
    generator = torch.Generator().manual_seed(1)
    for name, parameter in controller.named_parameters():
        if not (parameter.any() or name.startswith("splitter")):
            parameter.copy_(0.1 * torch.randn(parameter.shape, generator=generator))
    return controller


def random_history(hand, rows, seed=0):
    generator, fingers = torch.Generator().manual_seed(seed), hand.n_fingers

    def noise(*shape):
        return torch.randn(rows, *shape, generator=generator)

    joints = 0.3 + 0.1 * noise(4, hand.n_joints)
    return History(
        joints=joints,
        fingertips=0.08 + 0.02 * noise(4, fingers, 3),
        gravity=torch.nn.functional.normalize(noise(3), dim=-1),
        tactile=0.05 * noise(4, fingers, *hand.taxels).clamp(min=0),
        tactile_missing=torch.zeros(rows, fingers, dtype=torch.bool),
        slow_loads=noise(8, fingers).clamp(min=0),
        slow_fingertips=0.08 + 0.02 * noise(8, fingers, 3),
        slow_missing=torch.zeros(rows, dtype=torch.bool),
        rotations=finger_frames(hand, joints[:, 0]).distal_rotation,
        geometry=torch.zeros(rows, fingers, 0),
    )


@pytest.fixture(scope="session")
def history(hand):
    return random_history(hand, 3)


@pytest.fixture(scope="session")
def draft(hand):
    """Draft (3, 8, fingers, 3) and drafts before it (3, 8, fingers, 3) [m]."""
    generator = torch.Generator().manual_seed(2)
    chunks = 0.001 * torch.randn(2, 3, 8, hand.n_fingers, 3, generator=generator)
    return chunks[0], chunks[1]
