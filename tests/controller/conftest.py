import pytest
import torch

from lerobot_dexflex.controller import DexFlexController, History


@pytest.fixture(scope="session")
def controller():
    """A controller with random weights in every layer, also those that begin at zero, but for the splitter's
    last: it takes every draft for motion."""
    torch.manual_seed(0)
    controller = DexFlexController().eval().requires_grad_(False)
    generator = torch.Generator().manual_seed(1)
    for name, parameter in controller.named_parameters():
        if not (parameter.any() or name.startswith("splitter")):
            parameter.copy_(0.1 * torch.randn(parameter.shape, generator=generator))
    return controller


def _history(rows, seed=0):
    generator = torch.Generator().manual_seed(seed)

    def noise(*shape):
        return torch.randn(rows, *shape, generator=generator)

    return History(
        joints=0.3 + 0.1 * noise(4, 16),
        fingertips=0.08 + 0.02 * noise(4, 4, 3),
        gravity=torch.nn.functional.normalize(noise(3), dim=-1),
        tactile=0.05 * noise(4, 4, 10, 6).clamp(min=0),
        tactile_missing=torch.zeros(rows, 4, dtype=torch.bool),
        slow_loads=noise(8, 4).clamp(min=0),
        slow_fingertips=0.08 + 0.02 * noise(8, 4, 3),
        slow_missing=torch.zeros(rows, dtype=torch.bool),
    )


@pytest.fixture(scope="session")
def history():
    return _history(3)


@pytest.fixture(scope="session")
def draft():
    """Draft (3, 8, 4, 3) and drafts before it (3, 8, 4, 3) [m]."""
    generator = torch.Generator().manual_seed(2)
    chunks = 0.001 * torch.randn(2, 3, 8, 4, 3, generator=generator)
    return chunks[0], chunks[1]
