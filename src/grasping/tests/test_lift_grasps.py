"""Laws of the grasps that a network of lifts chooses in the whole chain from depth images."""

from __future__ import annotations

import itertools
import re

import numpy as np
import pytest
import torch
from table_scene import CAMERA, Nearest, depth_picture
from test_pipeline import ABOVE, ASIDE, BOX, DT, UP, YAML, Broken

from common.poses import check_pose, inverse
from grasping.pipeline import drawing
from grasping.pipeline.lift_grasps import ALIKE_RAD
from grasping.pipeline.pipeline import GraspPipeline, PipelineResult
from grasping.pipeline.settings import overlaid, settings_from
from grasping.poses.hand_view import SCALARS
from grasping.poses.hypotheses import MAX_TILT_RAD, turned
from grasping.poses.lift_network import LiftNetwork
from grasping.poses.taste import nobody

BOXES = (BOX, (-0.12, 0.1, 0.0, (0.05, 0.05, 0.06)))
LOW = {"peaks": {"threshold": 0.0}}


class Likes(LiftNetwork):
    """Believes in lifts the more, the better GG-CNN's quality and line, and the nearer the tilt to the wanted one."""

    def __init__(self, tilt=0.0):
        super().__init__()
        self._cos = float(np.cos(tilt))

    def forward(self, features):
        quality, agrees, _, _, _, down = features[:, -SCALARS:].T[:6]
        return 10.0 * quality + 2.0 * agrees - 50.0 * torch.abs(down - self._cos) - 4.0


class AnyTilt(LiftNetwork):
    """Believes that all grasps lift as well."""

    def forward(self, features):
        return 0.0 * features[:, 0] + 3.0


class Believes(LiftNetwork):
    """Believes that each grasp that opens more than `narrowest` [m] lifts with a probability."""

    def __init__(self, probability, trusts=0.5, narrowest=0.0):
        super().__init__(trusts=trusts)
        self.probability, self._narrowest = probability, narrowest

    def forward(self, features):
        opening = 0.05 + 0.05 * features[:, 6 - SCALARS]
        sure = float(np.log(self.probability / (1.0 - self.probability)))
        return torch.where(opening > self._narrowest, sure, -sure)


class Nonsense(LiftNetwork):
    def forward(self, features):
        return np.nan * features[:, 0]


def chain(changes=None, lifts=None, network=None, taste=None):
    s = settings_from(overlaid(YAML, changes or {}))
    lifts = Likes() if lifts is None else lifts
    clock = itertools.count().__next__
    return GraspPipeline(s.views(), network or Nearest(), s.steps(UP), clock, lifts, taste)


def look(of: GraspPipeline, place=ABOVE, boxes=BOXES, known=True, images=1) -> PipelineResult:
    depth = depth_picture(place, boxes)
    for i in range(images):
        found = of.step(depth, CAMERA, place if known else None, DT * i)
    return found


def orientations(found: PipelineResult) -> np.ndarray:
    return np.array([grasp.T_camera_grasp[:3, :3] for grasp in found.grasps])


@pytest.mark.parametrize("place", [ABOVE, ASIDE], ids=["above", "aside"])
def test_what_lifts_from_above_has_the_pose_that_it_had_without_the_network(place):
    changes = {"approach": {"kind": "vertical"}, "peaks": {"quality_sigma": 2.0, "threshold": 0.01}, "max_tilt": 0.0}
    s = settings_from(overlaid(YAML, changes))
    old = look(GraspPipeline(s.views(), Nearest(), s.steps(UP)), place).grasps[0]
    new = look(chain(changes), place).grasps[0]
    T = check_pose(new.T_base_grasp)
    np.testing.assert_allclose(T[:3, 2], -UP, atol=0.01)
    np.testing.assert_allclose(T[:3, 3], old.T_base_grasp[:3, 3], atol=0.015)
    assert turned(T[:3, :3], old.T_base_grasp[:3, :3]) < 0.2
    assert new.own_approach and not old.own_approach


def alike(found, other) -> None:
    """Asserts that two results have the same grasps."""
    assert [c.peak for c in found.candidates] == [c.peak for c in other.candidates]
    np.testing.assert_array_equal(orientations(found), orientations(other))
    assert [(g.quality, g.width) for g in found.grasps] == [(g.quality, g.width) for g in other.grasps]


@pytest.mark.parametrize("place", [ABOVE, ASIDE], ids=["above", "aside"])
@pytest.mark.parametrize("view", ["table", "camera"])
def test_ggcnns_own_grasps_come_from_straight_above_where_the_network_trusts_them(place, view):
    changes = {"view": view, "peaks": {"threshold": 0.01}, "approach": {"kind": "vertical"}}
    s = settings_from(overlaid(YAML, changes))
    alone = look(GraspPipeline(s.views(), Nearest(), s.steps(UP)), place).grasps
    found = look(chain(changes, Believes(0.52)), place).grasps
    assert len(found) > 1 and all(grasp.own_approach for grasp in found)
    for one, other in zip(alone, found):
        np.testing.assert_allclose(other.T_base_grasp[:3, 2], -UP, atol=0.02)
        np.testing.assert_allclose(other.T_base_grasp[:3, 3], one.T_base_grasp[:3, 3], atol=0.005)
        assert turned(other.T_base_grasp[:3, :3], one.T_base_grasp[:3, :3]) < 0.02
        assert (other.quality, other.width) == (pytest.approx(0.52), pytest.approx(one.width))
    alike(look(chain(changes, Believes(0.48)), place), look(chain(changes, Believes(0.48, trusts=1.0)), place))


def test_of_ggcnns_grasps_each_is_trusted_alone():
    """The network believes in wide openings; the best of GG-CNN's grasps is narrow."""
    changes = {"peaks": {"threshold": 0.01}, "approach": {"kind": "vertical"}}
    s = settings_from(overlaid(YAML, changes))
    alone = look(GraspPipeline(s.views(), Nearest(), s.steps(UP))).grasps
    between = 0.5 * (alone[0].width + alone[1].width)
    assert alone[1].width > between
    found = look(chain(changes, Believes(0.9, narrowest=between))).grasps
    np.testing.assert_allclose(found[0].T_base_grasp, alone[1].T_base_grasp, atol=0.02)
    assert all(grasp.width > between for grasp in found)


def test_where_trust_comes_and_goes_from_image_to_image_the_grasp_stays():
    lifts = Believes(0.5)
    of, depth, seen = chain(None, lifts), depth_picture(ABOVE, BOXES), []
    for i in range(20):
        lifts.probability = (0.48, 0.52)[i % 2]
        seen.append(of.step(depth, CAMERA, ABOVE, DT * i).grasps)
    assert all(seen) and len({grasps[0].id for grasps in seen}) == 1
    T = np.array([grasps[0].T_base_grasp for grasps in seen])
    assert np.linalg.norm(T[:, :3, 3] - T[0, :3, 3], axis=1).max() < 0.01


@pytest.mark.parametrize(
    ("changes", "boxes"), [({"peaks": {"threshold": 0.99}}, BOXES), ({"limits": {"x": [0.5, 1.0]}}, BOXES), ({}, ())]
)
def test_without_a_grasp_of_ggcnn_there_is_none_to_trust(changes, boxes):
    found = look(chain(changes, Believes(0.995)), boxes=boxes)
    alike(found, look(chain(changes, Believes(0.995, trusts=1.0)), boxes=boxes))
    assert bool(found.candidates) == bool(boxes) and (found.reason != "") == ("limits" in changes or not boxes)


def test_with_a_taste_the_operators_grasp_comes_before_that_of_ggcnn():
    taste = nobody()._replace(weights=np.ones(len(nobody().weights)))
    assert look(chain(LOW, Believes(0.9))).grasps[0].uncertainty is None
    assert look(chain(LOW, Believes(0.9), taste=taste)).grasps[0].uncertainty is not None


@pytest.mark.parametrize("place", [ABOVE, ASIDE], ids=["above", "aside"])
@pytest.mark.parametrize("view", ["table", "camera"])
@pytest.mark.parametrize("most", [0.0, 20.0, 45.0])
def test_tilts_count_from_the_tables_normal_and_are_bounded_wherever_the_camera_is(place, view, most):
    found = look(chain({"view": view, "max_tilt": most, **LOW}, Likes(tilt=np.radians(40.0))), place)
    cos = np.array([grasp.T_base_grasp[:3, 2] @ -UP for grasp in found.grasps])
    assert len(cos) and np.degrees(np.arccos(cos.min())) < most + 2.0
    tilt = np.degrees(np.arccos(cos[0]))
    assert min(most, 30.0) - 5.0 < tilt < 45.0, "less than it believes in, since tilts cost"


def test_proposals_are_distinct_in_the_order_of_their_ranks_and_no_more_than_wanted():
    for count in (1, 3, 10):
        found = look(chain({"peaks": {"count": count, "threshold": 0.0}}, Likes(0.3)))
        assert len(found.candidates) == count
        ranks = [c.rank for c in found.candidates]
        assert ranks == sorted(ranks, reverse=True)
        assert [c.peak.quality for c in found.candidates] == [g.quality for g in found.grasps]
        assert all(0.0 <= grasp.quality <= 1.0 for grasp in found.grasps)
        R, peaks = orientations(found), [grasp.peak for grasp in found.grasps]
        for i, j in itertools.combinations(range(len(peaks)), 2):
            away = max(abs(peaks[i].row - peaks[j].row), abs(peaks[i].column - peaks[j].column))
            assert away > YAML["peaks"]["distance"] or turned(R[i], R[j]) >= ALIKE_RAD - 1e-6


def test_a_grasp_is_seen_where_it_is_and_keeps_its_number():
    of = chain(LOW, Likes(0.4))
    first = look(of).grasps
    for grasp in first:
        np.testing.assert_allclose(CAMERA.project(grasp.T_camera_grasp[:3, 3]), grasp.pixel, atol=1e-6)
        np.testing.assert_allclose(ABOVE @ grasp.T_camera_grasp, grasp.T_base_grasp, atol=1e-9)
    second = of.step(depth_picture(ABOVE, BOXES), CAMERA, ABOVE, 5 * DT).grasps
    assert {grasp.id for grasp in first} == {grasp.id for grasp in second}
    np.testing.assert_allclose(first[0].T_base_grasp, second[0].T_base_grasp, atol=1e-6)


def test_in_a_noisy_image_the_best_stays_where_it_is_and_a_removed_thing_is_left():
    of, rng, depth = chain(LOW, Likes(0.4)), np.random.default_rng(3), depth_picture(ABOVE, BOXES)
    seen = [
        of.step(depth + rng.normal(0.0, 1e-3, depth.shape).astype(np.float32), CAMERA, ABOVE, DT * i).grasps[0]
        for i in range(8)
    ]
    T = np.array([one.T_base_grasp for one in seen])
    assert len({one.id for one in seen}) == 1
    assert np.linalg.norm(T[:, :3, 3] - T[0, :3, 3], axis=1).max() < 2e-3
    assert turned(T[:, :3, :3], T[0, :3, :3]).max() < 0.02
    left = of.step(depth_picture(ABOVE, BOXES[1:]), CAMERA, ABOVE, 1.0)
    away = [one.grasp.T_camera_grasp for one in left.candidates]
    assert away and all(np.hypot(*((ABOVE @ left.view.T_camera_view @ T)[:2, 3] - BOX[:2])) > 0.05 for T in away)


def test_a_grasp_of_the_image_before_tilts_no_further_than_allowed_once_the_table_is_seen_otherwise():
    """The camera's pose is late for an image: the table seems to lean, and grasps lean with it."""
    of, tilts = chain({"view": "camera", "max_tilt": 5.0, **LOW}, AnyTilt()), []
    for place in (ABOVE, ASIDE):
        found = of.step(depth_picture(place, BOXES), CAMERA, ASIDE, 0.0)
        T = ASIDE @ np.array([one.grasp.T_camera_grasp for one in found.candidates])
        tilts.append(np.degrees(np.arccos(T[:, :3, 2] @ -UP)))
    assert tilts[0].min() > 20.0 and tilts[1].max() < 7.0


@pytest.mark.parametrize("taste", [None, nobody()._replace(weights=np.ones(len(nobody().weights)))])
def test_a_network_of_lifts_that_says_nonsense_has_no_grasps(taste):
    found = look(chain(LOW, Nonsense(), taste=taste))
    assert found.grasps == () and "no grasp lifts with a probability above 0.00" in found.reason


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"peaks": {"threshold": 1.0}}, "no grasp lifts with a probability above 1.00"),
        ({"limits": {"x": [0.5, 1.0]}}, "its x is .* m in the base frame, and 0.50 to 1.00 m are allowed"),
        ({"limits": {"z": [-0.2, 0.1]}, **LOW}, "where the hand would wait for it, its z is 0.* m in the base frame"),
    ],
)
def test_no_grasp_has_a_reason(changes, reason):
    found = look(chain(changes))
    assert found.grasps == () and re.search(reason, found.reason), found.reason


@pytest.mark.parametrize("place", [ABOVE, ASIDE], ids=["above", "aside"])
def test_an_empty_table_nonsense_and_no_table_have_reasons_or_grasps_but_no_faults(place):
    assert look(chain(), place, ()).reason == "nothing stands on the table"
    assert "no grasp lifts" in look(chain({"view": "camera", "peaks": {"threshold": 0.9999}}), place, ()).reason
    assert look(chain(network=Broken()), place).reason == "the network's maps are not finite"
    rough = np.random.default_rng(0).uniform(0.5, 1.5, (480, 640)).astype(np.float32)
    for view in ("table", "camera"):
        for grasp in chain({"view": view, **LOW}).step(rough, CAMERA, place).grasps:
            check_pose(grasp.T_camera_grasp)
    assert chain().step(np.full((480, 640), np.nan, np.float32), CAMERA, place).grasps == ()


def test_without_the_cameras_place_there_are_grasps_before_the_camera():
    found = look(chain({"limits": {"z": [-0.2, 0.1]}, **LOW}), known=False)
    assert found.grasps[0].T_base_grasp is None
    assert settings_from(YAML).steps(UP).max_tilt == MAX_TILT_RAD


def test_a_tilted_grasp_is_drawn_tilted():
    """The line of its approach ends where the camera sees a point of it, and a straight one has nearly none."""
    lengths = []
    for tilt in (0.0, 0.6):
        found = look(chain({"peaks": {"count": 1}, "max_tilt": np.degrees(tilt)}, Likes(tilt)), images=1)
        image = np.zeros((600, 600, 3), np.uint8)
        T, view = inverse(found.view.T_camera_view) @ found.grasps[0].T_camera_grasp, found.view
        drawing.gripper(image, view.camera, T, 0.0, "", drawing.BEST, 1, view.image.crop)
        rows, columns = np.nonzero(image.any(axis=-1))
        start, end = (2.0 * view.camera.project((T @ (0.0, 0.0, -back, 1.0))[:3]) + 0.5 for back in (0.0, 0.1))
        lengths.append(np.linalg.norm(end - start))
        assert min(np.hypot(columns - end[0], rows - end[1])) < 2.0
        assert (drawing.heat_map(found, set(), "") == drawing.BEST).all(axis=-1).any()
    assert lengths[1] > lengths[0] + 40.0
    near = T.copy()
    near[2, 3] = 0.05
    blank = np.zeros((600, 600, 3), np.uint8)
    drawing.gripper(blank, view.camera, near, 0.05, "1", drawing.BEST, 1)
    assert not blank.any()


@pytest.mark.parametrize("with_lifts", [False, True], ids=["peaks", "lifts"])
def test_what_is_outside_the_limits_takes_no_place_of_what_is_within(with_lifts):
    """The better box lies outside, and one grasp is wanted."""
    changes = {"peaks": {"count": 1, "threshold": 0.01}}
    lifts = Likes() if with_lifts else None

    def best(limits):
        s = settings_from(overlaid(YAML, {**changes, "limits": limits}))
        return look(GraspPipeline(s.views(), Nearest(), s.steps(UP), lifts=lifts))

    anywhere = best({})
    (first,) = anywhere.grasps
    assert len(anywhere.candidates) == 1
    x = first.T_base_grasp[0, 3]
    beyond = [x + 0.05, 2.0] if x < 0.0 else [-2.0, x - 0.05]
    (second,) = best({"x": beyond}).grasps
    assert beyond[0] <= second.T_base_grasp[0, 3] <= beyond[1]
