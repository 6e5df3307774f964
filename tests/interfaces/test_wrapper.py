"""What is around an interface passes everything on."""

import torch
from interface_cases import drafts, observation

from lerobot_dexflex.hands import LEAP
from lerobot_dexflex.interfaces import Interface, make_interface
from lerobot_dexflex.interfaces.wrapper import WrappedInterface


def test_a_wrapper_is_its_interface_until_it_changes_something():
    inner, alone = make_interface(LEAP, "press@0.5"), make_interface(LEAP, "press@0.5")
    wrapped: Interface = WrappedInterface(inner)
    assert (wrapped.name, wrapped.command_space, wrapped.motion) == ("press@0.5", "draft", None)
    for k in range(4):
        if k == 2:
            wrapped.reset(torch.tensor([True, False]))
            alone.reset(torch.tensor([True, False]))
        seen, draft = observation(2, seed=k), drafts("press", 2, seed=k)
        assert torch.equal(wrapped.step(seen, draft), alone.step(seen, draft))
        assert wrapped.motion is inner.motion
    assert WrappedInterface(inner).explanation is None


def test_a_wrapper_tells_why_where_its_interface_does():
    inner = make_interface(LEAP, "raw")
    inner.explanation = "because"  # pyright: ignore[reportAttributeAccessIssue]
    assert WrappedInterface(inner).explanation == "because"
