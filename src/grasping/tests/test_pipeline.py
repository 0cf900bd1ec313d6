"""The whole way from depth images to grasps that may be published, without ROS."""

from __future__ import annotations

import functools
import itertools
import re
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from hypothesis import given
from hypothesis import strategies as st
from table_scene import CAMERA, Nearest, depth_picture, looking_at

from common.config import parse
from common.errors import ConfigError
from common.poses import check_pose, pose
from common.rotations import rotation_about
from grasping.pipeline import drawing
from grasping.pipeline.pipeline import GraspPipeline, PipelineResult
from grasping.pipeline.settings import overlaid, sentences, settings_from
from grasping.pipeline.tool_pose import LimitsConfig, Reachability, ReachabilityCache, ReachConfig, rejection_reason

CONFIG = Path(__file__).parents[1] / "config"
YAML = {
    **yaml.safe_load((CONFIG / "ggcnn.yaml").read_text()),
    "tool": yaml.safe_load((CONFIG / "tool_pose.yaml").read_text()),
}
UP = np.array([0.0, 0.0, 1.0])
BOX = (0.03, -0.02, 0.3, (0.08, 0.08, 0.08))
ABOVE = looking_at((0.0, 0.0, 0.8), (0.0, 0.0, 0.0))
ASIDE = looking_at((0.45, 0.1, 0.65), (0.0, 0.0, 0.0))
DT = 1.0 / 15.0


def finder(changes=None, network=None) -> GraspPipeline:
    """The whole chain; the clock advances by a second at each look."""
    s = settings_from(overlaid(YAML, changes or {}))
    network = Nearest() if network is None else network
    return GraspPipeline(s.views(), network, s.steps(UP), itertools.count().__next__)


@functools.lru_cache(maxsize=None)
def depth_seen_from(place: bytes, boxes):
    return depth_picture(np.frombuffer(place).reshape(4, 4), boxes)


def look(chain: GraspPipeline, T_base_camera, boxes=(BOX,), known=True, images=1) -> PipelineResult:
    depth = depth_seen_from(T_base_camera.tobytes(), boxes).copy()
    for i in range(images):
        found = chain.step(depth, CAMERA, T_base_camera if known else None, DT * i)
    return found


@pytest.mark.parametrize("place", [ABOVE, ASIDE], ids=["above", "aside"])
@pytest.mark.parametrize("kind", ["camera", "normal", "vertical"])
def test_the_grasp_is_on_the_box_wherever_the_camera_is(place, kind):
    found = look(finder({"approach": {"kind": kind}}), place)
    assert found.reason == ""
    best = found.grasps[0]
    T = check_pose(best.T_base_grasp)
    assert np.hypot(*(T[:2, 3] - BOX[:2])) < 0.045
    assert T[2, 3] == pytest.approx(0.08, abs=0.006)
    np.testing.assert_allclose(T[:3, 2], (0.0, 0.0, -1.0), atol=0.08)  # the view looks down, and the box is level
    np.testing.assert_allclose(place @ best.T_camera_grasp, T, atol=1e-9)
    np.testing.assert_allclose(CAMERA.project(best.T_camera_grasp[:3, 3]), best.pixel, atol=1e-6)


def test_in_the_cameras_view_the_grasp_is_what_the_network_said():
    found = look(finder({"view": "camera", "approach": {"kind": "camera"}}), ABOVE)
    best = found.grasps[0]
    np.testing.assert_allclose(best.T_camera_grasp[:3, 2], (0.0, 0.0, 1.0), atol=1e-9)
    assert best.angle == pytest.approx(np.pi / 6.0, abs=1e-3)
    assert best.width_px == pytest.approx(45.0 * 400 / 300, rel=1e-3)
    assert best.width == pytest.approx(best.width_px * 0.72 / 570.0, rel=0.02)


def test_across_the_surface_means_the_surface_and_straight_down_the_worlds_vertical():
    """From the side, in the camera's own image: three approaches, three directions."""
    changes = {"view": "camera", "peaks": {"threshold": 0.01}, "approach": {"radius": 0.02, "max_tilt": 70.0}}
    directions = {}
    for kind in ("camera", "normal", "vertical"):
        found = look(finder(overlaid(changes, {"approach": {"kind": kind}})), ASIDE)
        directions[kind] = ASIDE[:3, :3].T @ found.grasps[0].T_base_grasp[:3, 2]
    np.testing.assert_allclose(directions["camera"], (0.0, 0.0, 1.0), atol=1e-9)
    np.testing.assert_allclose(directions["vertical"], ASIDE[:3, :3].T @ -UP, atol=1e-9)
    sides = [ASIDE[:3, :3].T @ R for R in (-UP, *(rotation_about(2, 0.3)[:, i] * s for i in (0, 1) for s in (-1, 1)))]
    assert max(directions["normal"] @ side for side in sides) > 0.999


def test_without_the_cameras_place_grasps_are_before_the_camera():
    best = look(finder(), ASIDE, known=False).grasps[0]
    assert best.T_base_grasp is None
    assert (ASIDE @ best.T_camera_grasp)[2, 3] == pytest.approx(0.08, abs=0.006)
    vertical = look(finder({"approach": {"kind": "vertical"}}), ASIDE, known=False)
    assert vertical.grasps == ()
    assert "the vertical is unknown" in vertical.reason


def test_a_grasp_keeps_its_number_while_the_camera_moves():
    chain = finder()
    first = chain.step(depth_picture(ABOVE, [BOX]), CAMERA, ABOVE, 0.0).grasps[0]
    moved = looking_at((0.1, 0.05, 0.8), (0.05, 0.0, 0.0))
    second = chain.step(depth_picture(moved, [BOX]), CAMERA, moved, DT).grasps[0]
    assert first.id == second.id
    assert np.linalg.norm(first.pixel - np.array(second.pixel)) > 10.0


@pytest.mark.parametrize(
    ("changes", "boxes", "reason"),
    [
        ({"peaks": {"threshold": 0.99}}, (BOX,), "no peak of the quality is above 0.99"),
        ({"tool": {"max_opening": 0.04}}, (BOX,), "needs an opening of .* mm, and the hand has 40 mm"),
        ({"limits": {"x": [0.5, 1.0]}}, (BOX,), r"its x is 0.0\d m in the base frame, and 0.50 to 1.00 m are allowed"),
        ({"limits": {"nearest": 0.9}}, (BOX,), r"it is 0.72 m before the camera, and 0.90 to 2.00 m are allowed"),
    ],
)
def test_no_grasp_has_a_reason(changes, boxes, reason):
    found = look(finder(changes), ABOVE, boxes)
    assert found.grasps == ()
    assert re.search(reason, found.reason), found.reason


def test_an_empty_image_has_a_reason_and_the_next_one_works():
    chain = finder()
    nothing = chain.step(np.full((480, 640), np.nan, np.float32), CAMERA, ABOVE, 0.0)
    assert nothing.reason == "the depth image holds no reading inside the crop"
    assert nothing.view is None
    assert look(chain, ABOVE).grasps


class Broken(torch.nn.Module):
    side_multiple = 1

    def forward(self, depth):
        return torch.cat([depth / 0.0] * 4, dim=1)


def test_a_network_that_says_nonsense_is_not_believed():
    assert look(finder(network=Broken()), ABOVE).reason == "the network's maps are not finite"


def test_stamps_that_go_back_begin_anew():
    chain = finder()
    depth = depth_picture(ABOVE, [BOX])
    first = chain.step(depth, CAMERA, ABOVE, 100.0).grasps[0].id
    assert chain.step(depth, CAMERA, ABOVE, 100.1).grasps[0].id == first
    assert chain.step(depth, CAMERA, ABOVE, 1.0).grasps[0].id != first


def test_each_stage_is_timed():
    assert look(finder(), ABOVE).seconds == {"view": 1, "network": 1, "peaks": 1, "poses": 1}


def test_images_for_people():
    found = look(finder(), ASIDE)
    plain = drawing.plain(found.maps)
    assert plain.shape == (300, 300, 3)
    assert plain[..., :2].max() == 0
    np.testing.assert_array_equal(plain[..., 2], np.uint8(255.0 * np.clip(found.maps.quality, 0.0, 1.0)))
    best = found.grasps[0]
    with_disc = drawing.with_disc(plain, best)
    assert tuple(with_disc[best.peak.row, best.peak.column]) == drawing.DISC
    assert plain[best.peak.row, best.peak.column, 1] == 0
    heat = drawing.heat_map(found, {best.id}, "a reason")
    assert heat.shape == (600, 600, 3)
    assert (heat == drawing.REFUSED).all(axis=-1).any()


def test_the_packages_file_is_whole_and_every_line_states_its_unit():
    assert len(sentences(settings_from(YAML))) == 12
    for name in ("ggcnn.yaml", "tool_pose.yaml"):
        for line in (CONFIG / name).read_text().splitlines():
            key, _, value = line.partition(": ")
            if value and not key.lstrip().startswith("#"):
                assert " # " in line, line


def test_the_limits_know_no_base_before_the_calibration():
    limits = parse(LimitsConfig, YAML["limits"])
    far_out = pose(p=(5.0, 0.0, 0.8))
    assert rejection_reason(far_out, None, 0.05, 0.1, limits) == ""
    assert "its x is 5.00 m" in rejection_reason(far_out, far_out, 0.05, 0.1, limits)


REACH = parse(ReachConfig, YAML["reach"])
YES = Reachability(True, "")


@given(st.floats(0.0, 100.0))
def test_what_was_not_answered_is_asked_again_after_a_second(now):
    book = ReachabilityCache(REACH)
    book.asked(1, pose(), 0.0)
    book.answered(1, None)
    assert book.wanted(1, pose(), now) == (now > 1.0)


def test_every_section_is_checked_and_all_its_faults_are_named_at_once():
    wrong = {
        "view": "sideways", "unknown": 1, "peaks": {"count": 0}, "limits": {"x": [1.0, -1.0]}, "tracking": 7,
        "network": {"speed": 1, "precision": "half"},
    }  # fmt: skip
    with pytest.raises(ConfigError) as caught:
        settings_from(overlaid(YAML, wrong))
    for fault in (
        "view is 'sideways', but must be one of camera, table", "unknown is not a known key", "peaks/count is 0",
        "limits/x is", "tracking/ is 7", "network/speed is not a known key", "network/precision is 'half'",
    ):  # fmt: skip
        assert fault in str(caught.value)


def test_an_answer_holds_for_its_pose_while_it_is_asked_anew_and_is_forgotten_with_its_grasp():
    book, T = ReachabilityCache(REACH), pose(p=(0.4, 0.0, 0.1))
    assert book.wanted(1, T, 0.0) and book.known(1) is None
    book.asked(1, T, 0.0)
    assert not book.wanted(1, T, 0.5)
    book.answered(1, YES)
    assert book.known(1) == YES
    assert not book.wanted(1, T @ pose(p=(0.004, 0.0, 0.0)), 1.0)
    assert book.wanted(1, T, REACH.keep + 1.0)
    book.asked(1, T, REACH.keep + 1.0)
    assert book.known(1) == YES, "while it is asked anew"
    for other in (T @ pose(p=(0.006, 0.0, 0.0)), T @ pose(rotation_about(2, 0.1))):
        assert book.wanted(1, other, REACH.keep + 1.5)
    book.asked(1, other, REACH.keep + 2.0)
    assert book.known(1) is None, "the answer was of another pose"
    book.keep_only({2})
    book.answered(1, YES)
    assert book.known(1) is None
