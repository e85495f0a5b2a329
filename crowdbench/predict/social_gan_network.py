"""Social GAN (Gupta et al. 2018): an LSTM that generates futures of a crowd, and one that tells them from real ones.

Sizes are the paper's. Differs from it because it learns faster so: the decoder's output is added to the last
displacement instead of replacing it, so that what is learnt is how people part from going straight on.
"""

from __future__ import annotations

import itertools

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

EMBEDDING = 16
HIDDEN = 32
WIDE = 64
NOISE = 8
"""Random numbers per future; the same for everybody in a scene, whose futures belong together."""


def perceptron(*sizes: int) -> nn.Sequential:
    """Linear layers of the given sizes, a ReLU between any two."""
    layers: list[nn.Module] = []
    for one, two in itertools.pairwise(sizes):
        layers += [nn.Linear(one, two), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


class Encoder(nn.Module):
    """What a pedestrian did, as a vector."""

    def __init__(self, hidden: int) -> None:
        super().__init__()
        self.embed = nn.Linear(2, EMBEDDING)
        self.lstm = nn.LSTM(EMBEDDING, hidden, batch_first=True)

    def forward(self, displacement: Float[Tensor, "row time 2"]) -> Float[Tensor, "row hidden"]:
        """Displacements from step to step, in metres."""
        state: Tensor = self.lstm(torch.relu(self.embed(displacement)))[1][0][0]
        return state


class Pooling(nn.Module):
    """What a pedestrian sees of the others: the largest, in each component, over a perceptron of each of them."""

    def __init__(self) -> None:
        super().__init__()
        self.place = nn.Linear(2, EMBEDDING)
        self.mlp = perceptron(EMBEDDING + HIDDEN, WIDE, HIDDEN)

    def forward(
        self,
        position: Float[Tensor, "scene pedestrian 2"],
        hidden: Float[Tensor, "scene pedestrian hidden"],
        present: Bool[Tensor, "scene pedestrian"],
    ) -> Float[Tensor, "scene pedestrian hidden"]:
        """Positions in metres; everybody sees himself too."""
        between = self.place(position[:, None] - position[:, :, None])
        others = hidden[:, None].expand(*between.shape[:3], -1)
        seen = torch.relu(self.mlp(torch.cat([between, others], dim=-1)))
        return torch.where(present[:, None, :, None], seen, 0.0).amax(dim=2)


class Generator(nn.Module):
    """Futures of all pedestrians of a batch of scenes; of `pooling` they are those of a crowd, else each one's own."""

    def __init__(self, pooling: bool = False) -> None:
        super().__init__()
        self.encoder = Encoder(HIDDEN)
        self.pooling = Pooling() if pooling else None
        self.context = nn.Sequential(perceptron(HIDDEN * (2 if pooling else 1), WIDE, HIDDEN - NOISE), nn.ReLU())
        self.embed = nn.Linear(2, EMBEDDING)
        self.decoder = nn.LSTMCell(EMBEDDING, HIDDEN)
        self.move = nn.Linear(HIDDEN, 2)

    def forward(
        self,
        history: Float[Tensor, "scene time pedestrian 2"],
        present: Bool[Tensor, "scene pedestrian"],
        noise: Float[Tensor, "scene mode noise"],
        steps: int,
    ) -> Float[Tensor, "mode row steps 2"]:
        """Displacements from step to step, in metres, of whoever is present, in the order of `present.nonzero()`."""
        scene, pedestrian = present.nonzero(as_tuple=True)
        if len(scene) == 0:
            return noise.new_zeros((noise.shape[1], 0, steps, 2))
        seen = history.transpose(1, 2)[scene, pedestrian].diff(dim=1)
        hidden = self.encoder(seen)
        if self.pooling is not None:
            spread = hidden.new_zeros((*present.shape, HIDDEN))
            spread[scene, pedestrian] = hidden
            hidden = torch.cat([hidden, self.pooling(history[:, -1], spread, present)[scene, pedestrian]], dim=-1)
        modes, rows = noise.shape[1], len(scene)
        context = self.context(hidden).expand(modes, rows, -1)
        state = torch.cat([context, noise[scene].transpose(0, 1)], dim=-1).reshape(modes * rows, HIDDEN)
        cell = torch.zeros_like(state)
        move = seen[:, -1].repeat(modes, 1)
        moves = []
        for _ in range(steps):
            state, cell = self.decoder(torch.relu(self.embed(move)), (state, cell))
            move = move + self.move(state)
            moves.append(move)
        return torch.stack(moves, dim=1).reshape(modes, rows, steps, 2)


class Discriminator(nn.Module):
    """How real a whole track looks, as a logit."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = Encoder(HIDDEN)
        self.judge = perceptron(HIDDEN, WIDE, 1)

    def forward(self, displacement: Float[Tensor, "row time 2"]) -> Float[Tensor, "row"]:
        """Displacements from step to step, in metres, what was seen and what followed."""
        score: Tensor = self.judge(self.encoder(displacement))[:, 0]
        return score
