"""A broken network is an error that names it, and the step in which it is noticed never happened."""

import copy

import pytest
import torch
from interface_cases import observation
from learned_cases import draft_of, flex

from lerobot_dexflex.controller.diffusion_prior import DiffusionPrior
from lerobot_dexflex.errors import DexFlexError
from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces.dexgen import DexGenInterface

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
    own = {key: value for key, value in vars(interface).items() if key not in ("controller", "prior")}
    parts = (interface._hand, *interface._parts)
    return own | {(k, key): v for k, part in enumerate(parts) for key, v in vars(part).items()}


def assert_unchanged(interface, before):
    now = memory(interface)
    assert now.keys() == before.keys()
    assert all(now[key] is before[key] for key in now)


@pytest.fixture
def interface(controller):
    return flex(copy.deepcopy(controller))


def test_a_broken_splitter_is_named_where_it_is_used(controller):
    broken = copy.deepcopy(controller)
    break_network(broken.splitter)
    assert flex(broken).step(observation(1), draft_of(1)).isfinite().all()
    with pytest.raises(DexFlexError, match="controller's splitter put out NaN"):
        flex(broken, use_splitter=True).step(observation(1), draft_of(1))


@pytest.mark.parametrize("value", [torch.nan, torch.inf])
@pytest.mark.parametrize("part", PARTS)
def test_a_broken_part_is_named_and_nothing_is_executed_or_remembered(interface, part, value):
    for k in range(2):
        interface.step(observation(2, k), draft_of(2, k))
    before = memory(interface)
    whole = copy.deepcopy(interface.controller.get_submodule(part).state_dict())
    break_network(interface.controller.get_submodule(part), value)
    for k in range(2, 4):
        with pytest.raises(DexFlexError, match=f"controller's {PARTS[part]} put out NaN or infinity"):
            interface.step(observation(2, k), draft_of(2, k))
    assert_unchanged(interface, before)
    interface.controller.get_submodule(part).load_state_dict(whole)
    interface.step(observation(2, 2), draft_of(2, 2))


@pytest.mark.parametrize("part", PARTS)
def test_a_part_that_is_broken_from_the_start_leaves_no_trace(interface, part):
    before = memory(interface)
    break_network(interface.controller.get_submodule(part))
    with pytest.raises(DexFlexError, match=PARTS[part]):
        interface.step(observation(1), draft_of(1))
    assert_unchanged(interface, before)
    assert interface.motion is None


def test_the_slow_token_is_looked_at_as_well(interface):
    break_network(interface.controller.encoder.slow)
    with pytest.raises(DexFlexError, match="encoder put out NaN"):
        interface.step(observation(1), draft_of(1))
    assert interface._slow is None


def test_a_network_that_no_candidate_needs_may_be_broken(interface):
    """With the constant grip the decoder is not asked."""
    break_network(interface.controller.decoder)
    assert flex(interface.controller, "nogrip").step(observation(1), draft_of(1)).isfinite().all()


@pytest.mark.parametrize("broken", ["encoder", "prior of DexGen", "inverse dynamics of DexGen"])
def test_dexgen_is_looked_at_alike(controller, broken):
    interface = DexGenInterface(LEAP, copy.deepcopy(controller), DiffusionPrior(controller.config))
    interface.step(observation(2), draft_of(2))
    before = memory(interface)
    networks = {
        "encoder": interface.controller.encoder,
        "prior of DexGen": interface.prior.network,
        "inverse dynamics of DexGen": interface.prior.dynamics,
    }
    break_network(networks[broken])
    with pytest.raises(DexFlexError, match=f"controller's {broken} put out NaN"):
        interface.step(observation(2, 1), draft_of(2))
    assert_unchanged(interface, before)
