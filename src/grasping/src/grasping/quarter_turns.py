"""Convolutions that do not care how the picture is turned, by quarter turns: turned input, turned output.

Features come in fours, one for each quarter turn of the picture. When the picture turns by a quarter anticlockwise,
each feature's pictures turn, and the four change places in a ring (a group convolution: Cohen and Welling, ICML 2016).
So a few examples teach what they would teach in all four attitudes, with a quarter of the weights.

What is no feature (inputs and outputs) turns as its representation says: the square matrix that its channels are
multiplied with when the picture turns by a quarter anticlockwise. A height stays, (1); the cosine and sine of twice an
angle in the picture change sign, (-1); a vector along right and down turns, ((0, 1), (-1, 0)).
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import nn


class FromMaps(nn.Module):
    """Convolution from maps to features."""

    def __init__(self, turn: torch.Tensor, features: int, kernel: int) -> None:
        """Makes the layer; `turn` is the maps' representation, shape (i, i)."""
        super().__init__()
        self.weight = nn.Parameter(torch.empty(features, len(turn), kernel, kernel))
        self.bias = nn.Parameter(torch.zeros(features))
        self.register_buffer("turns", _powers(turn), persistent=False)
        nn.init.kaiming_normal_(self.weight, nonlinearity="relu")

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Returns the features, shape (n, 4 features, h, w)."""
        # A turned kernel expects turned maps, and undoes their turn by the inverse, which is the transpose.
        kernels = [
            torch.rot90(torch.einsum("oikl,ji->ojkl", self.weight, turn), s, (2, 3))
            for s, turn in enumerate(self.turns)
        ]
        return F.conv2d(x, torch.cat(kernels), self.bias.repeat(4), padding=self.weight.shape[-1] // 2)


class Features(nn.Module):
    """Convolution from features to features, 3 x 3."""

    def __init__(self, inputs: int, outputs: int, dilation: int) -> None:
        super().__init__()
        self.dilation = dilation
        self.weight = nn.Parameter(torch.empty(outputs, 4 * inputs, 3, 3))
        self.bias = nn.Parameter(torch.zeros(outputs))
        nn.init.kaiming_normal_(self.weight, nonlinearity="relu")

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Returns the features, shape (n, 4 outputs, h, w)."""
        o = len(self.weight)
        ring = self.weight.view(o, 4, -1, 3, 3)
        kernels = [torch.rot90(ring.roll(s, 1).reshape(o, -1, 3, 3), s, (2, 3)) for s in range(4)]
        return F.conv2d(x, torch.cat(kernels), self.bias.repeat(4), padding=self.dilation, dilation=self.dilation)


class ToMaps(nn.Module):
    """From features to maps, pixel by pixel; zero until it is trained."""

    def __init__(self, features: int, turn: torch.Tensor) -> None:
        """Makes the layer; `turn` is the maps' representation, shape (o, o)."""
        super().__init__()
        self.weight = nn.Parameter(torch.zeros(len(turn), features))
        self.bias = nn.Parameter(torch.zeros(len(turn)))
        self.register_buffer("turns", _powers(turn), persistent=False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Returns the maps, shape (n, o, h, w)."""
        kernel = torch.cat([turn @ self.weight for turn in self.turns], dim=1)
        # Of a constant only that may be added which no turn changes.
        return F.conv2d(x, kernel[:, :, None, None], self.turns.mean(0) @ self.bias)


def _powers(turn: torch.Tensor) -> torch.Tensor:
    """Returns what 0 to 3 quarter turns do, shape (4, k, k)."""
    return torch.stack([torch.linalg.matrix_power(turn, s) for s in range(4)])
