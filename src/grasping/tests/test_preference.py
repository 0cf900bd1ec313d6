"""Laws of the openings that a hand prefers, and what they do to the choice among grasps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from hypothesis import given
from hypothesis import strategies as st
from table_scene import CAMERA, UP, depth_picture, looking_at

from common.config import parse
from common.errors import ConfigError
from grasping.network.maps import Maps, Peak
from grasping.pipeline.pipeline import GraspPipeline
from grasping.pipeline.projection import pixel_size, project_grasp
from grasping.pipeline.settings import overlaid, settings_from
from grasping.pipeline.tool_pose import ToolPoseConfig, preferred
from grasping.pipeline.view import CameraView, CropConfig

CONFIG = Path(__file__).parents[1] / "config"
YAML = yaml.safe_load((CONFIG / "tool_pose.yaml").read_text())
LOW, HIGH, RAMP = 0.04, 0.1, 0.02
THRESHOLD = 0.2
PIXEL_M = np.float32(0.002)
ABOVE = looking_at((0.0, 0.0, 0.8), (0.0, 0.0, 0.0))
SLENDER, WIDE = (-0.08, 0.0, 0.3, (0.06, 0.06, 0.09)), (0.08, 0.0, 0.3, (0.08, 0.08, 0.07))
qualities = st.floats(-0.5, 1.25, width=32, allow_subnormal=False)
widths = st.floats(-10.0, 80.0, width=32, allow_subnormal=False)
shares = st.floats(0.05, 0.99)


def hand(share=0.5, **changes) -> ToolPoseConfig:
    own = {"preferred_opening": [LOW, HIGH], "outside_quality": share, "outside_ramp": RAMP}
    return parse(ToolPoseConfig, {**YAML, **own, **changes})


def maps(quality, width) -> Maps:
    quality, width = np.broadcast_arrays(np.atleast_1d(np.float32(quality)), np.atleast_1d(np.float32(width)))
    return Maps(quality, np.zeros_like(quality), width)


def after(quality, width, share=0.5, threshold=THRESHOLD) -> np.ndarray:
    return preferred(maps(quality, width), PIXEL_M, hand(share), threshold).quality


@given(st.lists(st.tuples(qualities, widths), min_size=1), shares, st.floats(0.0, 0.5))
def test_no_quality_rises_and_what_is_no_grasp_stays_as_it_is(pixels, share, threshold):
    quality, width = (np.array(column, np.float32) for column in zip(*pixels))
    found = after(quality, width, share, threshold)
    assert found.dtype == np.float32
    assert (found <= quality).all()
    none = quality <= threshold
    np.testing.assert_array_equal(found[none], quality[none])
    assert (found[~none] >= np.float32(threshold)).all()


@given(st.lists(st.tuples(qualities, widths), min_size=1))
def test_without_a_preference_the_maps_are_the_same_to_the_bit(pixels):
    before = maps(*(np.array(column, np.float32) for column in zip(*pixels)))
    assert preferred(before, PIXEL_M, hand(1.0), THRESHOLD) is before


@given(st.lists(st.tuples(qualities, st.floats(LOW / PIXEL_M + 0.1, HIGH / PIXEL_M - 0.1)), min_size=1), shares)
def test_what_the_hand_holds_well_keeps_its_quality_to_the_bit(pixels, share):
    quality, width = (np.array(column, np.float32) for column in zip(*pixels))
    np.testing.assert_array_equal(after(quality, width, share), quality)


@given(qualities, qualities, widths, shares)
def test_of_two_grasps_of_one_opening_the_better_stays_the_better(a, b, width, share):
    low, high = after([min(a, b), max(a, b)], width, share)
    assert low <= high


@given(qualities, widths, widths, shares)
def test_the_further_from_the_preferred_openings_the_lower(quality, a, b, share):
    def outside(width):
        return max(LOW - PIXEL_M * max(width, 0.0), PIXEL_M * width - HIGH, 0.0)

    near, far = sorted((a, b), key=outside)
    of_near, of_far = after(quality, [near, far], share)
    assert of_far <= of_near + 1e-6


def test_the_share_that_is_left():
    widths = np.array([LOW - 2 * RAMP, LOW - RAMP, LOW - 0.5 * RAMP, LOW, HIGH, HIGH + 0.5 * RAMP, 0.2]) / PIXEL_M
    np.testing.assert_allclose(
        after(0.8, widths) - THRESHOLD, 0.6 * np.array([0.5, 0.5, 0.75, 1.0, 1.0, 0.75, 0.5]), atol=1e-6
    )


def test_the_size_of_a_pixel_is_that_of_the_grasps_opening():
    depth = depth_picture(ABOVE, [SLENDER])
    image = CameraView(CropConfig(side=400, rows_up=0)).step(depth, CAMERA).image
    size = pixel_size(image, CAMERA)
    assert size.shape == image.depth.shape
    for row, column in ((150, 150), (120, 90)):
        seen = project_grasp(Peak(row, column, 0.5, 0.0, 30.0), image.crop, len(image.input), depth, CAMERA)
        assert 30.0 * size[row, column] == pytest.approx(seen.width, rel=1e-5)


class LeftSlender(torch.nn.Module):
    """A network that calls good what is near, and slender what is on the left: 20 pixels, else 45."""

    side_multiple = 1

    def forward(self, depth):
        one = torch.ones_like(depth)
        width = torch.where(torch.arange(depth.shape[-1]) < 150, 20.0 / 150.0, 45.0 / 150.0) * one
        return torch.cat([-10.0 * depth, 0.5 * one, 0.8660254 * one, width], dim=1)


def best_x(boxes, **changes) -> float:
    """Returns where the best grasp is [m]; left in the image is -x."""
    tool = {**YAML, "preferred_opening": [0.045, 0.12], "outside_ramp": 0.01, **changes}
    ggcnn = yaml.safe_load((CONFIG / "ggcnn.yaml").read_text())
    s = settings_from(overlaid({**ggcnn, "view": "camera"}, {"tool": tool, "approach": {"kind": "camera"}}))
    chain = GraspPipeline(s.views(), LeftSlender(), s.steps(UP))
    found = chain.step(depth_picture(ABOVE, boxes), CAMERA, ABOVE, 0.0)
    assert found.reason == ""
    assert found.grasps[0].quality == pytest.approx(found.maps.quality[found.grasps[0].peak[:2]])
    return float(found.grasps[0].T_base_grasp[0, 3])


def test_the_hand_prefers_the_lower_wider_box_and_takes_the_slender_one_where_there_is_no_other():
    assert best_x([SLENDER, WIDE], outside_quality=1.0) < 0.0
    assert best_x([SLENDER, WIDE], outside_quality=0.3) > 0.0
    assert best_x([SLENDER], outside_quality=0.01) < 0.0


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({"preferred_opening": [0.1, 0.04]}, "preferred_opening is [0.1, 0.04], but the least must be below"),
    ],
)
def test_a_wrong_preference_is_refused(changes, fault):
    with pytest.raises(ConfigError) as caught:
        hand(**changes)
    assert fault in str(caught.value)


def test_the_file_of_a_hand_from_before_has_no_preference():
    new = ("preferred_opening", "outside_quality", "outside_ramp")
    old = parse(ToolPoseConfig, {key: value for key, value in YAML.items() if key not in new})
    before = maps([0.3, 0.9], [5.0, 70.0])
    assert preferred(before, PIXEL_M, old, THRESHOLD) is before
