"""A device that is not the CPU, for machines without one: it refuses what CUDA refuses.

Tensors on it say that they are on `ELSEWHERE`, and compute on the CPU underneath. An operation that meets
a CPU tensor as well fails, and so does reading one with NumPy before `cpu()`.
"""

from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map

ELSEWHERE = torch.device("lazy")  # One that PyTorch knows by name and needs no library for.
_TRANSFERS = (torch.ops.aten._to_copy.default, torch.ops.aten.copy_.default)


class _There(torch.Tensor):
    inside: torch.Tensor

    @staticmethod
    def __new__(cls, inside: torch.Tensor):
        made = torch.Tensor._make_wrapper_subclass(
            cls, inside.shape, inside.stride(), dtype=inside.dtype, device=ELSEWHERE
        )
        made.inside = inside
        return made

    @classmethod
    def __torch_dispatch__(cls, function, types, args=(), kwargs=None):
        return _run(function, args, kwargs or {})

    def numpy(self, *args: Any, **kwargs: Any):
        raise TypeError("can't convert a tensor that is elsewhere to numpy. Use Tensor.cpu() first.")

    __array__ = numpy

    def tolist(self):
        return self.inside.tolist()


class Elsewhere(TorchDispatchMode):
    """While it is on, tensors can be made on `ELSEWHERE`."""

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        return _run(function, args, kwargs or {})


def moved(tensors: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Return tensors on `ELSEWHERE`."""
    return {key: _There(value) for key, value in tensors.items()}


def _run(function, args, kwargs):
    tensors = [t for t in tree_flatten((args, kwargs))[0] if isinstance(t, torch.Tensor)]
    there = any(isinstance(t, _There) for t in tensors)
    device = kwargs.get("device")
    if there and function not in _TRANSFERS and any(type(t) is torch.Tensor and t.ndim for t in tensors):
        raise RuntimeError(f"{function} met tensors on {ELSEWHERE} and on cpu.")
    if device is not None:
        there = torch.device(device).type == ELSEWHERE.type
        kwargs = kwargs | {"device": torch.device("cpu")}
    args, kwargs = tree_map(lambda t: t.inside if isinstance(t, _There) else t, (args, kwargs))
    result = function(*args, **kwargs)
    return tree_map(lambda t: _There(t) if isinstance(t, torch.Tensor) and there else t, result)
