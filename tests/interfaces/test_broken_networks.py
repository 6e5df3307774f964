"""A broken network is an error that names it, and the step in which it is noticed never happened."""

import copy

import pytest
import torch
from interface_cases import drafts, observation

from lerobot_dexflex.controller import SelectionSettings
from lerobot_dexflex.controller.diffusion_prior import DiffusionPrior
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.interfaces.dexflex import DexFlexInterface
from lerobot_dexflex.interfaces.dexgen import DexGenInterface
from lerobot_dexflex.interfaces.gain import GainInterface

PARTS = {
    "prior": "prior",
    "world_model": "world model",
    "ranker": "score",
    "decoder": "decoder",
    "encoder": "encoder",
}


def break_network(module, value=torch.nan):
    with torch.no_grad():
        for weights in module.parameters():
            weights.fill_(value)


def memory(interface):
    """Everything that a learned interface remembers."""
    parts = (interface._hand, interface._touch, interface._drafts, interface._past)
    own = {key: value for key, value in vars(interface).items() if key not in ("controller", "prior")}
    return [own, *({**vars(part)} for part in parts)]


def assert_unchanged(interface, before):
    for now, then in zip(memory(interface), before, strict=True):
        assert now.keys() == then.keys()
        assert all(now[key] is then[key] for key in now)


@pytest.fixture
def interface(controller):
    settings = SelectionSettings(n_pure=3, n_seeded=3, nfe=2, use_residual=True)
    return DexFlexInterface(copy.deepcopy(controller), settings)


@pytest.mark.parametrize("value", [torch.nan, torch.inf])
@pytest.mark.parametrize("part", PARTS)
def test_a_broken_part_is_named_and_nothing_is_executed_or_remembered(interface, part, value):
    for k in range(2):
        interface.step(observation(2, k), drafts("dexflex", 2, k))
    before, command = memory(interface), interface.command
    whole = copy.deepcopy(interface.controller.get_submodule(part).state_dict())
    break_network(interface.controller.get_submodule(part), value)
    for k in range(2, 4):
        with pytest.raises(DexFlexError, match=f"controller's {PARTS[part]} put out NaN or infinity"):
            interface.step(observation(2, k), drafts("dexflex", 2, k))
    assert_unchanged(interface, before)
    assert interface.command is command
    interface.controller.get_submodule(part).load_state_dict(whole)
    interface.step(observation(2, 2), drafts("dexflex", 2, 2))


@pytest.mark.parametrize("part", PARTS)
def test_a_part_that_is_broken_from_the_start_leaves_no_command(interface, part):
    break_network(interface.controller.get_submodule(part))
    with pytest.raises(DexFlexError, match=PARTS[part]):
        interface.step(observation(1), drafts("dexflex", 1))
    assert interface.command is None
    with pytest.raises(DexFlexError, match=PARTS[part]):
        GainInterface(interface, 0.5).step(observation(1), drafts("dexflex", 1))


def test_the_slow_token_is_looked_at_as_well(interface):
    break_network(interface.controller.encoder.slow)
    with pytest.raises(DexFlexError, match="encoder put out NaN"):
        interface.step(observation(1), drafts("dexflex", 1))
    assert interface._slow is None


@pytest.mark.parametrize("broken", ["encoder", "prior of DexGen"])
def test_dexgen_is_looked_at_alike(controller, broken):
    interface = DexGenInterface(copy.deepcopy(controller), DiffusionPrior(controller.config))
    interface.step(observation(2), drafts("dexgen", 2))
    before = memory(interface)
    break_network(interface.controller.encoder if broken == "encoder" else interface.prior)
    with pytest.raises(DexFlexError, match=f"controller's {broken} put out NaN"):
        interface.step(observation(2, 1), drafts("dexgen", 2))
    assert_unchanged(interface, before)
