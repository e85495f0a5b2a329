"""The gradient of a loss over many rows, by threads that share them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from crowdbench.utils.threads import in_chunks


def set_gradients(parameters: Sequence[nn.Parameter], loss: Callable[[slice], Tensor], rows: int, chunk: int) -> None:
    """Give parameters the gradient of a loss that is a sum over rows.

    The gradients of chunks are added in their order, so that the bits do not depend on the number of threads.

    Args:
        parameters: The parameters.
        loss: The part of the loss that some of the rows have.
        rows: Number of rows.
        chunk: Number of rows of a thread at once.
    """
    found: dict[int, tuple[Tensor, ...]] = {}

    def differentiate(part: slice) -> None:
        found[part.start] = torch.autograd.grad(loss(part), parameters, materialize_grads=True)

    in_chunks(differentiate, rows, chunk)
    for parameter, *parts in zip(parameters, *(found[start] for start in sorted(found)), strict=True):
        parameter.grad = torch.stack(parts).sum(dim=0)
