import sys
from pathlib import Path

import pytest
import torch

sys.path.insert(0, str(Path(__file__).parent))  # interface_cases

from lerobot_dexflex.controller import DexFlexController
from lerobot_dexflex.controller.diffusion_prior import DiffusionPrior
from lerobot_dexflex.interfaces import INTERFACES, make_interface


@pytest.fixture(scope="session")
def controller():
    """A controller of random weights, also where it would start at zero."""
    torch.manual_seed(0)
    controller = DexFlexController()
    with torch.no_grad():
        for value in controller.parameters():
            value.add_(0.02 * torch.randn_like(value))
    return controller.eval().requires_grad_(False)


@pytest.fixture(scope="session")
def controller_folder(controller, tmp_path_factory):
    """The folder of the random controller, with random weights of DexGen."""
    folder = tmp_path_factory.mktemp("controller")
    controller.save_pretrained(folder)
    prior = DiffusionPrior(controller.config)
    prior.network.load_state_dict(controller.prior.state_dict())
    prior.save(folder)
    return folder


@pytest.fixture
def make(controller_folder):
    """Make any interface by name, learned ones around the random controller."""

    def build(name, **options):
        if INTERFACES[name].learned:
            options = {"controller": controller_folder, **options}
        return make_interface(name, **options)

    return build
