"""The renderer as an operation of PyTorch, with gradients.

Tensors may be on any device: they are brought to the CPU's memory, rendered by `device`, and the pictures are brought back to where
`means` is. On the CPU nothing is copied on the way in: the backward pass reads the tensors again, so PyTorch raises its error if one was
changed in place before.
"""

from typing import Any, Dict, Optional, Tuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from . import _native

__all__ = ["rasterize"]

_WITH_GRADIENTS = ("means", "quats", "scales", "opacities", "colors", "viewmats", "backgrounds")


def rasterize(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,
    width: int,
    height: int,
    *,
    backgrounds: Optional[Tensor] = None,
    **settings: Any,
) -> Tuple[Tensor, Tensor, Dict[str, Any]]:
    """`sparsesplat.rasterize` on tensors, with its settings by name.

    Gradients flow to means, quats, scales, opacities, colors, viewmats and backgrounds. `Ks` has none: one that requires a
    gradient is a ValueError.
    """
    if Ks.requires_grad:
        raise ValueError("Ks: the renderer has no gradients by the intrinsics, pass Ks.detach()")
    given = (means, quats, scales, opacities, colors, viewmats, backgrounds)
    meta: Dict[str, Any] = {}
    if torch.is_grad_enabled() and any(tensor is not None and tensor.requires_grad for tensor in given):
        pictures, alphas = _Rasterize.apply(*given, Ks, width, height, settings, meta)
        return pictures, alphas, meta
    arrays = [_array(tensor) for tensor in (means, quats, scales, opacities, colors, viewmats, Ks)]
    pictures, alphas, meta = _native.rasterize(*arrays, width, height, backgrounds=_array(backgrounds), **settings)
    home = None if means.is_cpu else means.device
    return _tensor(pictures, home), _tensor(alphas, home), meta


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx, means, quats, scales, opacities, colors, viewmats, backgrounds, Ks, width, height, settings, meta):
        arrays = [_array(tensor) for tensor in (means, quats, scales, opacities, colors, viewmats, Ks)]
        pictures, alphas, told, ctx.tape = _native.record(
            *arrays, width, height, backgrounds=_array(backgrounds), **settings
        )
        # For PyTorch's check that they are unchanged when the tape reads them again.
        ctx.save_for_backward(means, quats, scales, opacities, colors)
        meta.update(told)
        ctx.shape = pictures.shape
        # A gradient by alpha that nobody has costs time if it comes as zeros.
        ctx.set_materialize_grads(False)
        given = (means, quats, scales, opacities, colors, viewmats, backgrounds)
        # Where each gradient belongs; None is the CPU's memory.
        ctx.homes = [None if tensor is None or tensor.is_cpu else tensor.device for tensor in given]
        return _tensor(pictures, ctx.homes[0]), _tensor(alphas, ctx.homes[0])

    @staticmethod
    @once_differentiable
    def backward(ctx, v_pictures, v_alphas):
        # Looked at for the check alone.
        _ = ctx.saved_tensors
        if v_pictures is None:
            v_pictures = torch.zeros(ctx.shape)
        found = ctx.tape.backward(_array(v_pictures), _array(v_alphas))
        gradients = [
            _tensor(found[name], home) if needed else None
            for name, home, needed in zip(_WITH_GRADIENTS, ctx.homes, ctx.needs_input_grad)
        ]
        return (*gradients, None, None, None, None, None)


def _array(tensor: Optional[Tensor]):
    """The tensor as a numpy array, C-contiguous, on the CPU: without a copy if it is so already."""
    if tensor is None:
        return None
    # Few calls: after a rendering each costs a multiple, because PyTorch's code has left the caches.
    return (tensor if tensor.is_contiguous() else tensor.contiguous()).numpy(force=True)


def _tensor(array, home: Optional[torch.device]) -> Tensor:
    """The array as a tensor on a device, or without a copy in the CPU's memory."""
    tensor = torch.from_numpy(array)
    return tensor if home is None else tensor.to(home)
