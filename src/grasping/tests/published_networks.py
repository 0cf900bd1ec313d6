"""The published networks, written as they are published: what the package's faster ones are compared with."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import nn


class GGCNN(nn.Module):
    """Layer by layer as in the table of the paper's code."""

    def __init__(self):
        super().__init__()
        self.conv1 = nn.Conv2d(1, 32, 9, stride=3, padding=3)
        self.conv2 = nn.Conv2d(32, 16, 5, stride=2, padding=2)
        self.conv3 = nn.Conv2d(16, 8, 3, stride=2, padding=1)
        self.convt1 = nn.ConvTranspose2d(8, 8, 3, stride=2, padding=1, output_padding=1)
        self.convt2 = nn.ConvTranspose2d(8, 16, 5, stride=2, padding=2, output_padding=1)
        self.convt3 = nn.ConvTranspose2d(16, 32, 9, stride=3, padding=3, output_padding=1)
        self.pos_output = nn.Conv2d(32, 1, 2)
        self.cos_output = nn.Conv2d(32, 1, 2)
        self.sin_output = nn.Conv2d(32, 1, 2)
        self.width_output = nn.Conv2d(32, 1, 2)

    def forward(self, x):
        for layer in (self.conv1, self.conv2, self.conv3, self.convt1, self.convt2, self.convt3):
            x = F.relu(layer(x))
        return torch.cat([self.pos_output(x), self.cos_output(x), self.sin_output(x), self.width_output(x)], dim=1)


class GGCNN2(nn.Module):
    """The features by their published numbers."""

    def __init__(self):
        super().__init__()
        self.features = nn.Sequential(
            nn.Conv2d(1, 16, 11, padding=5),
            nn.ReLU(),
            nn.Conv2d(16, 16, 5, padding=2),
            nn.ReLU(),
            nn.MaxPool2d(2, stride=2),
            nn.Conv2d(16, 16, 5, padding=2),
            nn.ReLU(),
            nn.Conv2d(16, 16, 5, padding=2),
            nn.ReLU(),
            nn.MaxPool2d(2, stride=2),
            nn.Conv2d(16, 32, 5, dilation=2, padding=4),
            nn.ReLU(),
            nn.Conv2d(32, 32, 5, dilation=4, padding=8),
            nn.ReLU(),
            nn.UpsamplingBilinear2d(scale_factor=2),
            nn.Conv2d(32, 16, 3, padding=1),
            nn.ReLU(),
            nn.UpsamplingBilinear2d(scale_factor=2),
            nn.Conv2d(16, 16, 3, padding=1),
            nn.ReLU(),
        )
        self.pos_output = nn.Conv2d(16, 1, 1)
        self.cos_output = nn.Conv2d(16, 1, 1)
        self.sin_output = nn.Conv2d(16, 1, 1)
        self.width_output = nn.Conv2d(16, 1, 1)

    def forward(self, x):
        x = self.features(x)
        return torch.cat([self.pos_output(x), self.cos_output(x), self.sin_output(x), self.width_output(x)], dim=1)
