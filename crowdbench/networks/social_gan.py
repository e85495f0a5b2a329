"""The generator of futures of Social GAN (Gupta et al. 2018). The discriminator is in `studies/social_gan/training.py`.

It differs from the paper to train faster: the decoder's output is added to the last displacement instead of replacing
it, and the network learns how pedestrians deviate from constant velocity. The sizes of the generator come from the
published code; the encoder in section 3.6 of the paper is half as large.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from crowdbench.networks.layers import perceptron

EMBEDDING = 16
"""Size of the embedding of a displacement or a relative position."""

SGAN_HIDDEN = 32
"""Size of the state of encoder and decoder."""

SGAN_WIDE = 64
"""Size of the hidden layer of every perceptron."""

SGAN_NOISE = 8
"""Normal numbers per future. All pedestrians of a scene share them, so that their futures belong together."""


class TrajectoryEncoder(nn.Module):
    """An LSTM over a pedestrian's displacements."""

    def __init__(self, hidden: int) -> None:
        super().__init__()
        self.embed = nn.Linear(2, EMBEDDING)
        self.lstm = nn.LSTM(EMBEDDING, hidden, batch_first=True)

    def forward(self, displacement: Float[Tensor, "row time 2"]) -> Float[Tensor, "row hidden"]:
        """Return the last hidden state after displacements from step to step in metres."""
        state: Tensor = self.lstm(torch.relu(self.embed(displacement)))[1][0][0]
        return state


class Pooling(nn.Module):
    """The social pooling module (Gupta et al. 2018, section 3.4): the influence of all others on a pedestrian.

    A perceptron on relative position and hidden state of each of them, then the maximum of every component.
    """

    def __init__(self) -> None:
        super().__init__()
        self.place = nn.Linear(2, EMBEDDING)
        self.mlp = perceptron(EMBEDDING + SGAN_HIDDEN, SGAN_WIDE, SGAN_HIDDEN)

    def forward(
        self,
        position: Float[Tensor, "row 2"],
        hidden: Float[Tensor, "row hidden"],
        present: Bool[Tensor, "scene pedestrian"],
    ) -> Float[Tensor, "row hidden"]:
        """Pool over the pedestrians of each scene. A row is a pedestrian, as in `Generator.forward`.

        Args:
            position: Positions in metres.
            hidden: Hidden states of the encoder.
            present: True for pedestrians that exist.

        Returns:
            The pooled vector of every pedestrian; the pedestrian itself is pooled too.
        """
        # Only pairs within a scene: crowds differ so much in size that nine of ten pairs of a padded batch are padding.
        scene, first, second = (present[:, :, None] & present[:, None]).nonzero(as_tuple=True)
        row = present.flatten().cumsum(0).sub(1).view(present.shape)
        own, other = row[scene, first], row[scene, second]
        between = self.place(position[other] - position[own])
        features = torch.relu(self.mlp(torch.cat([between, hidden[other]], dim=-1)))
        return torch.zeros_like(hidden).scatter_reduce(0, own[:, None].expand_as(features), features, "amax")


class Generator(nn.Module):
    """Generator of futures of all pedestrians in a batch of scenes: encoder, pooling, an LSTM decoder with noise.

    Without `pooling` every pedestrian is predicted as if it were alone.
    """

    def __init__(self, pooling: bool = False) -> None:
        super().__init__()
        self.encoder = TrajectoryEncoder(SGAN_HIDDEN)
        self.pooling = Pooling() if pooling else None
        self.context = nn.Sequential(
            perceptron(SGAN_HIDDEN * (2 if pooling else 1), SGAN_WIDE, SGAN_HIDDEN - SGAN_NOISE), nn.ReLU()
        )
        self.embed = nn.Linear(2, EMBEDDING)
        self.decoder = nn.LSTMCell(EMBEDDING, SGAN_HIDDEN)
        self.move = nn.Linear(SGAN_HIDDEN, 2)

    def forward(
        self,
        history: Float[Tensor, "scene time pedestrian 2"],
        present: Bool[Tensor, "scene pedestrian"],
        noise: Float[Tensor, "scene mode noise"],
        steps: int,
    ) -> Float[Tensor, "mode row steps 2"]:
        """Generate one future for each vector of noise.

        Args:
            history: Observed positions in metres, relative to a point near them.
            present: True for pedestrians that exist.
            noise: Normal numbers.
            steps: Number of steps to predict.

        Returns:
            Displacements from step to step in metres. A row is a pedestrian who is present, in the order of
            `present.nonzero()`.
        """
        scene, pedestrian = present.nonzero(as_tuple=True)
        if len(scene) == 0:
            return noise.new_zeros((noise.shape[1], 0, steps, 2))
        observed = history.transpose(1, 2)[scene, pedestrian].diff(dim=1)
        hidden = self.encoder(observed)
        if self.pooling is not None:
            hidden = torch.cat([hidden, self.pooling(history[scene, -1, pedestrian], hidden, present)], dim=-1)
        modes, rows = noise.shape[1], len(scene)
        context = self.context(hidden).expand(modes, rows, -1)
        state = torch.cat([context, noise[scene].transpose(0, 1)], dim=-1).reshape(modes * rows, SGAN_HIDDEN)
        cell = torch.zeros_like(state)
        move = observed[:, -1].repeat(modes, 1)
        moves = []
        for _ in range(steps):
            state, cell = self.decoder(torch.relu(self.embed(move)), (state, cell))
            move = move + self.move(state)
            moves.append(move)
        return torch.stack(moves, dim=1).reshape(modes, rows, steps, 2)
