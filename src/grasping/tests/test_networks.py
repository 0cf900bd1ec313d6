"""The package's networks are the published ones, only faster."""

from __future__ import annotations

import numpy as np
import published_networks
import pytest
import torch
import torch.nn.functional as F
from hypothesis import given, settings
from hypothesis import strategies as st

from grasping.network.networks import BFLOAT16, GGCNN, KERAS, NETWORKS, frozen, infer, shuffled_transpose

PUBLISHED = {"ggcnn": published_networks.GGCNN, "ggcnn2": published_networks.GGCNN2}


def pair(name):
    torch.manual_seed(3)
    published = PUBLISHED[name]()
    network = NETWORKS[name]()
    network.load_state_dict(published.state_dict())
    return published, network


@pytest.mark.parametrize("name", NETWORKS)
def test_frozen_networks_are_the_network(name):
    torch.manual_seed(4)
    network = NETWORKS[name]()
    for parameter in network.parameters():
        parameter.data += torch.empty_like(parameter).uniform_(-0.05, 0.05)
    image = torch.randn(1, 1, 156, 156)
    with torch.no_grad():
        wanted = network(image)
        found = frozen(network, 156)(image)
    torch.testing.assert_close(found, wanted, rtol=0.0, atol=1e-5 * float(wanted.abs().max()))


@pytest.mark.parametrize("name", NETWORKS)
def test_in_bfloat16_the_maps_are_the_networks_to_its_rounding(name):
    torch.manual_seed(4)
    network = NETWORKS[name]()
    image = np.random.default_rng(1).normal(size=(156, 156)).astype(np.float32)
    wanted = infer(frozen(network, 156), image)
    found = infer(frozen(network, 156, BFLOAT16), image)
    assert found.dtype == np.float32
    off = np.abs(found - wanted).max() / np.abs(wanted).max()
    assert 1e-4 < off < 0.05


@pytest.mark.parametrize("name", PUBLISHED)
@pytest.mark.parametrize("side", [300, 156])
def test_output_is_the_published_networks(name, side):
    published, network = pair(name)
    image = torch.randn(2, 1, side, side)
    with torch.no_grad():
        wanted = published(image)
        torch.testing.assert_close(network(image), wanted, rtol=0.0, atol=1e-5)
        if side == 300:
            torch.testing.assert_close(frozen(network)(image[:1]), wanted[:1], rtol=0.0, atol=1e-5)


@pytest.mark.parametrize("name", PUBLISHED)
def test_gradients_are_the_published_networks(name):
    published, network = pair(name)
    image = torch.randn(1, 1, 60, 60)
    for net in (published, network):
        net(image).square().sum().backward()
    for (key, a), (_, b) in zip(published.named_parameters(), network.named_parameters()):
        torch.testing.assert_close(b.grad, a.grad, rtol=1e-3, atol=1e-4 * float(a.grad.abs().max()), msg=key)


@settings(max_examples=20)
@given(st.integers(1, 7), st.integers(1, 7), st.integers(1, 4), st.integers(1, 4), st.sampled_from([(9, 3), (5, 2)]))
def test_shuffled_transpose_is_the_transposed_convolution(h, w, inputs, outputs, of):
    side, stride = of
    x, bias = torch.randn(2, inputs, h, w), torch.randn(outputs)
    weight = torch.randn(inputs, outputs, side, side)
    found, wanted = shuffled_transpose(x, weight, bias, stride), F.conv_transpose2d(x, weight, bias, stride)
    torch.testing.assert_close(found, wanted, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("name", "side"), [("ggcnn", 302), ("ggcnn2", 301)])
def test_sides_that_change_the_size_are_refused(name, side):
    with pytest.raises(ValueError, match=f"the image is {side} x {side}, but its sides must be multiples of"):
        NETWORKS[name]()(torch.zeros(1, 1, side, side))


def same_convolution(x, weight, stride):
    """Returns Keras' convolution with padding "same"."""
    pads = []
    for size, kernel in zip(x.shape[:1:-1], weight.shape[:1:-1]):
        total = max((-(-size // stride) - 1) * stride + kernel - size, 0)
        pads += [total // 2, total - total // 2]
    return F.conv2d(F.pad(x, pads), weight, stride=stride)


def same_transpose(x, weight, stride):
    """Returns Keras' transposed convolution: the adjoint of its convolution."""
    size = [stride * n for n in x.shape[2:]]
    zero = torch.zeros(len(x), weight.shape[1], *size, requires_grad=True)
    return torch.autograd.grad(same_convolution(zero, weight, stride), zero, x)[0]


def test_keras_borders_are_keras_same_padding():
    torch.manual_seed(5)
    network = GGCNN(KERAS)
    for parameter in network.parameters():
        parameter.data.uniform_(-0.2, 0.2)
    image = torch.randn(1, 1, 300, 300)
    x = image
    for layer in (network.conv1, network.conv2, network.conv3):
        x = F.relu(same_convolution(x, layer.weight.data, layer.stride[0]) + layer.bias.data[:, None, None])
    for layer in (network.convt1, network.convt2, network.convt3):
        x = F.relu(same_transpose(x, layer.weight.data, layer.stride[0]) + layer.bias.data[:, None, None])
    heads = [network.pos_output, network.cos_output, network.sin_output, network.width_output]
    wanted = torch.cat([same_convolution(x, h.weight.data, 1) + h.bias.data[:, None, None] for h in heads], dim=1)
    with torch.no_grad():
        torch.testing.assert_close(network(image), wanted, rtol=1e-5, atol=1e-5 * float(wanted.abs().max()))
