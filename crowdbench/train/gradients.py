"""The gradient of a loss over many rows, by threads that share them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from crowdbench.utils.threads import in_chunks


def set_gradients(parameters: Sequence[nn.Parameter], loss: Callable[[slice], Tensor], rows: int, chunk: int) -> float:
    """Give parameters the gradient of a loss that is a sum over rows.

    The gradients of chunks are added in their order, so that the bits do not depend on the number of threads.

    Args:
        parameters: The parameters.
        loss: The part of the loss that some of the rows have.
        rows: Number of rows.
        chunk: Number of rows of a thread at once.

    Returns:
        The loss.
    """
    found: dict[int, tuple[float, tuple[Tensor, ...]]] = {}

    def differentiate(part: slice) -> None:
        value = loss(part)
        found[part.start] = value.item(), torch.autograd.grad(value, parameters, materialize_grads=True)

    in_chunks(differentiate, rows, chunk)
    values, gradients = zip(*(found[start] for start in sorted(found)), strict=True)
    for parameter, *parts in zip(parameters, *gradients, strict=True):
        parameter.grad = torch.stack(parts).sum(dim=0)
    return sum(values)
