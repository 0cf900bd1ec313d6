"""What is evaluated near the objects only are the plain network's maps, and the same grasps."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from table_scene import CAMERA, depth_picture, looking_at

from grasping.network.around import around
from grasping.network.maps import HIGHEST_QUALITY, Smoothing, decisive, gaussian, radius
from grasping.network.networks import BFLOAT16, NETWORKS, PRECISIONS, frozen, infer
from grasping.network.strips import array, put, side_by_side, strips, tensor, with_margin
from grasping.network.weights import load
from grasping.pipeline.pipeline import GraspPipeline
from grasping.pipeline.settings import overlaid, settings_from
from grasping.pipeline.view import TableView

PACKAGE = Path(__file__).parents[1]
YAML = {
    **yaml.safe_load((PACKAGE / "config" / "ggcnn.yaml").read_text()),
    "tool": yaml.safe_load((PACKAGE / "config" / "tool_pose.yaml").read_text()),
}
UP = np.array([0.0, 0.0, 1.0])
ABOVE = looking_at((0.0, 0.0, 0.8), (0.0, 0.0, 0.0))
ASIDE = looking_at((0.35, 0.1, 0.7), (0.0, 0.0, 0.0))
BOX = (0.03, -0.02, 0.3, (0.08, 0.05, 0.08))
SMALL = (-0.12, 0.1, 1.0, (0.02, 0.04, 0.03))
AT_EDGE = (0.3, 0.16, 0.2, (0.1, 0.06, 0.05))


def network(name):
    """A network with the shipped weights, or with random weights and biases."""
    if name == "shipped":
        return load((PACKAGE / "weights" / "ggcnn2.pt").read_bytes()).network
    torch.manual_seed(7)
    found = NETWORKS[name]()
    for parameter in found.parameters():
        if parameter.ndim == 1:
            parameter.data.uniform_(-0.2, 0.2)
    return found.eval()


def within(mask, distance):
    return cv2.dilate(mask.astype(np.uint8), np.ones((2 * distance + 1,) * 2, np.uint8)) > 0


def is_the_networks(net, image, objects, wanted):
    with torch.no_grad():
        plain = net(torch.from_numpy(image)[None, None])[0].numpy()
    maps, known = around(net)(image, objects, wanted)
    assert known[wanted].all()
    np.testing.assert_allclose(maps[:, known], plain[:, known], rtol=0.0, atol=1e-5 * max(1.0, np.abs(plain).max()))
    assert not maps[:, ~known].any()


NAMES = ("ggcnn", "ggcnn_keras", "ggcnn2", "shipped")
rectangles = st.tuples(st.integers(0, 119), st.integers(0, 119), st.integers(1, 40), st.integers(1, 40))


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=6)
@given(
    st.lists(rectangles, min_size=1, max_size=3),
    st.lists(rectangles, min_size=1, max_size=3),
    st.integers(0, 25),
    st.integers(0, 1000),
)
def test_near_objects_and_anywhere_else_the_maps_are_the_networks(name, places, others, margin, seed):
    random = np.random.default_rng(seed)
    objects, elsewhere = np.zeros((2, 120, 120), bool)
    for mask, found in ((objects, places), (elsewhere, others)):
        for row, column, rows, columns in found:
            mask[row : row + rows, column : column + columns] = True
    image = np.where(objects, random.normal(size=objects.shape), random.normal()).astype(np.float32)
    is_the_networks(network(name), 0.2 * image, objects, within(objects, margin) | elsewhere)


@pytest.mark.parametrize("name", NAMES)
def test_an_image_full_of_objects_is_the_networks(name):
    image = np.random.default_rng(2).normal(size=(120, 144)).astype(np.float32)
    is_the_networks(network(name), image, *np.ones((2, *image.shape), bool))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("boxes", [(BOX,), (AT_EDGE, SMALL)], ids=["box", "at the edge"])
def test_views_of_a_table_give_the_networks_maps(name, boxes):
    s = settings_from(YAML)
    view = TableView(s.crop, s.table).step(noisy(depth_picture(ASIDE, boxes), 0), CAMERA)
    assert view.flat
    is_the_networks(network(name), view.image.input, view.graspable, decisive(view.graspable, Smoothing(), 0.2))


@pytest.mark.parametrize("name", NAMES)
def test_in_bfloat16_the_maps_near_objects_are_the_networks_in_bfloat16(name):
    objects = np.zeros((120, 120), bool)
    objects[30:70, 50:80] = True
    image = np.where(objects, np.random.default_rng(3).normal(size=objects.shape), 0.5).astype(np.float32)
    net, wanted = network(name), within(objects, 10)
    exact, rounded = (infer(frozen(net, 120, precision), image) for precision in PRECISIONS)
    maps, known = around(net, BFLOAT16)(image, objects, wanted)
    off, rounding = (np.abs(maps - other)[:, known].max() for other in (rounded, exact))
    assert off <= rounding
    assert 1e-4 < rounding / np.abs(exact).max() < 0.05


def noisy(depth, seed):
    """A depth image with noise, holes, and readings that are not finite."""
    random = np.random.default_rng(seed)
    depth = depth + (0.002 * random.normal(size=depth.shape)).astype(np.float32)
    depth[random.random(depth.shape) < 0.03] = np.nan
    depth[100:120, 300:310] = np.nan
    depth[::37, ::41] = np.inf
    return depth


class Everywhere(torch.nn.Module):
    """A network that nothing is known of."""

    side_multiple = 12

    def __init__(self, net):
        super().__init__()
        self.net = net

    def forward(self, depth):
        return self.net(depth)


def chain(net, changes):
    s = settings_from(overlaid(YAML, changes))
    return GraspPipeline(s.views(), net, s.steps(UP))


SCENES = (  # image by image: what stands there, and where the camera is
    [((BOX, SMALL), ASIDE)] * 4 + [((BOX,), ASIDE)] * 2 + [((), ASIDE)] + [((AT_EDGE, BOX), ASIDE)] * 3,
    [((AT_EDGE, SMALL), ABOVE)] * 6,
)


@pytest.mark.parametrize(("name", "scene"), [("shipped", SCENES[0]), ("ggcnn", SCENES[1])], ids=["shipped", "ggcnn"])
def test_the_grasps_are_those_of_a_network_that_is_evaluated_everywhere(name, scene):
    net = network(name)
    if name == "ggcnn":  # random weights say nothing above the threshold
        net.pos_output.bias.data += 0.5
    near, everywhere = chain(net, {}), chain(Everywhere(net), {})
    count = 0
    for i, (boxes, place) in enumerate(scene):
        depth = noisy(depth_picture(place, boxes), i)
        a, b = (c.step(depth, CAMERA, place, i / 15.0) for c in (near, everywhere))
        assert a.reason == b.reason
        assert [(c.peak.row, c.peak.column) for c in a.candidates] == [
            (c.peak.row, c.peak.column) for c in b.candidates
        ]
        for one, other in zip(a.candidates, b.candidates):
            np.testing.assert_allclose(one.peak, other.peak, rtol=0.0, atol=1e-3)
        assert [g.id for g in a.grasps] == [g.id for g in b.grasps]
        for one, other in zip(a.grasps, b.grasps):
            np.testing.assert_allclose(one.T_base_grasp, other.T_base_grasp, atol=1e-4)
        count += len(a.grasps)
    assert count > 5


def test_an_image_without_readings_and_a_bare_table_have_the_reasons_of_before():
    near = chain(network("shipped"), {})
    assert (
        near.step(np.full((480, 640), np.nan, np.float32), CAMERA).reason
        == "the depth image holds no reading inside the crop"
    )
    assert near.step(depth_picture(ABOVE, ()), CAMERA, None, 1.0).reason == "nothing stands on the table"


@pytest.mark.parametrize("changes", [{}, {"view": "camera"}], ids=["near objects", "everywhere"])
def test_the_chain_has_the_precision_of_its_settings(changes):
    """The grasp is the same, its quality is rounded."""
    depth = noisy(depth_picture(ABOVE, (BOX,)), 3)
    in_bfloat16 = overlaid(changes, {"network": {"precision": "bfloat16"}})
    exact, rounded = (chain(network("shipped"), c).step(depth, CAMERA, ABOVE).grasps[0] for c in (changes, in_bfloat16))
    np.testing.assert_allclose(rounded.T_base_grasp[:3, 3], exact.T_base_grasp[:3, 3], atol=0.003)
    assert 0.0 < abs(rounded.quality - exact.quality) < 0.02


@pytest.mark.parametrize(
    ("changes", "bias"),
    [({"view": "camera"}, 0.0), ({"peaks": {"threshold": 0.0}}, 0.0), ({}, 2.0 * HIGHEST_QUALITY)],
    ids=["not flat", "no threshold", "high quality"],
)
def test_where_peaks_can_be_anywhere_the_network_is_evaluated_everywhere(changes, bias):
    net = network("shipped")
    net.pos_output.bias.data += bias
    depth = noisy(depth_picture(ABOVE, (BOX,)), 3)
    a, b = (chain(n, changes).step(depth, CAMERA, ABOVE) for n in (net, Everywhere(net)))
    for one, other in zip(a.maps.everywhere(), b.maps.everywhere()):
        np.testing.assert_array_equal(one, other)


@settings(max_examples=40)
@given(st.integers(0, 10**6), st.floats(0.05, 1.0), st.floats(0.0, 8.0), st.floats(0.0, 4.0))
def test_beyond_what_decides_no_quality_is_above_the_threshold(seed, threshold, sigma, angle_sigma):
    random = np.random.default_rng(seed)
    graspable = gaussian(random.random((90, 120), dtype=np.float32), random.uniform(0.0, 6.0))
    graspable = graspable > np.quantile(graspable, random.uniform(0.3, 0.99))
    smoothing = Smoothing(sigma, angle_sigma, 1.0)
    known = decisive(graspable, smoothing, threshold)
    quality = gaussian(np.where(graspable, np.float32(HIGHEST_QUALITY), np.float32(0.0)), sigma)
    assert known[graspable].all()
    assert known[within(quality > threshold, max(radius(angle_sigma), radius(1.0)))].all()


def test_without_a_threshold_all_of_the_maps_decide():
    assert decisive(np.ones((20, 20), bool), Smoothing(), None) is None
    assert decisive(np.ones((20, 20), bool), Smoothing(), 0.0) is None


@given(st.integers(0, 10**6), st.integers(1, 12), st.integers(0, 8))
def test_strips_hold_all_that_is_wanted_and_no_pixel_twice_in_a_band(seed, rows, gap):
    random = np.random.default_rng(seed)
    wanted = random.random((30, 40)) < random.uniform(0.0, 0.3)
    held, ends = np.zeros_like(wanted), {}
    for strip in strips(wanted, rows, gap):
        assert 0 <= strip.row <= 30 - rows
        assert 0 <= strip.start < strip.stop <= 40
        part = wanted[strip.row : strip.row + rows, strip.start : strip.stop]
        assert part[:, [0, -1]].any(axis=0).all()
        assert strip.start - ends.get(strip.row, -gap - 1) > gap
        ends[strip.row] = strip.stop
        held[strip.row : strip.row + rows, strip.start : strip.stop] = True
    assert held[wanted].all()


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.sampled_from([(1, 1), (3, 1), (5, 1), (5, 2)]))
def test_a_layer_in_strips_is_the_layer(seed, of):
    torch.manual_seed(seed)
    random, rows, (kernel, dilation) = np.random.default_rng(seed), 6, of
    pad = dilation * (kernel // 2)
    layer = torch.nn.Conv2d(3, 4, kernel, padding=pad, dilation=dilation)
    x = random.normal(size=(30, 40, 3)).astype(np.float32)
    wanted = random.random((30, 40)) < 0.05
    found, result = strips(wanted, rows, 2 * pad), np.zeros((30, 40, 4), np.float32)
    laid = side_by_side([with_margin(x, strip, rows, pad, pad) for strip in found])
    with torch.no_grad():
        values = torch.nn.functional.conv2d(tensor(laid), layer.weight, layer.bias, dilation=dilation)
        put(result, found, array(values), 2 * pad)
        plain = array(layer(tensor(x)))
    np.testing.assert_allclose(result[wanted], plain[wanted], atol=1e-5)
