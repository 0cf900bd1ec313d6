"""Episodes as attempts that a network of lifts learns from."""

from __future__ import annotations

import numpy as np
import pytest
from episodes import DOWN, episode, metadata

from common.errors import RigError
from common.poses import translation
from common.rotations import rotation_about
from grasping.lab.dataset.episode import SHOWN, angles_of_opening
from grasping.lab.dataset.store import encode, file_name
from grasping.lab.programs.train_lifts import LiftData, with_episodes
from grasping.lab.training.lift_examples import attempt
from grasping.network.maps import REFLEX
from grasping.poses.gripper import GRIPPER
from grasping.poses.hand_view import FEATURES, SCALARS

GGCNN = "ab" * 32
OURS = metadata(configuration={"weights": GGCNN})


def tried(tilt=0.0, **changes):
    """An episode of a hand that came down before the camera with a tilt about its own y axis [rad]."""
    T = DOWN @ translation(0.03, 0.02, 0.81)
    T[:3, :3] = T[:3, :3] @ rotation_about(1, tilt)
    return episode(**{"metadata": OURS, "T_base_tool_closed": T, **changes})


@pytest.mark.parametrize("tilt", [-0.5, 0.0, 0.4])
@pytest.mark.parametrize("held", [True, False])
def test_a_grasp_is_seen_with_its_tilt_and_its_outcome(tilt, held):
    values, lifted = attempt(tried(tilt, held=held), GGCNN, GRIPPER)
    assert values.shape == (FEATURES,) and values.dtype == np.float32 and np.isfinite(values).all()
    assert lifted is held
    np.testing.assert_allclose(values[-SCALARS + 3 : -SCALARS + 6], (-np.sin(tilt), 0.0, np.cos(tilt)), atol=5e-3)


def test_the_opening_is_the_hands_and_where_that_is_unknown_ggcnns():
    angles = np.tile(angles_of_opening(0.11).astype(np.float32), (3, 1))
    known, _ = attempt(tried(finger_angles=angles), GGCNN, GRIPPER)
    assert known[-SCALARS + 6] == pytest.approx((0.11 - 0.05) / 0.05, abs=1e-4)
    unknown, _ = attempt(tried(), GGCNN, GRIPPER)
    assert unknown[-SCALARS + 2] == pytest.approx(0.0, abs=1e-5), "no wider than GG-CNN says"


@pytest.mark.parametrize(
    "changes",
    [
        {"metadata": metadata(configuration={"weights": "cd" * 32})},
        {"metadata": metadata(configuration={"weights": GGCNN}, source=SHOWN)},
        {"depth": np.zeros((3, 400, 400), np.uint16)},
        {"T_base_tool_closed": DOWN @ translation(0.0, 0.0, -0.5)},
    ],
)
def test_what_was_not_tried_or_seen_or_with_another_ggcnn_teaches_nothing(changes):
    assert attempt(tried(**changes), GGCNN, GRIPPER) is None


def test_episodes_are_further_attempts(tmp_path):
    few = LiftData(np.zeros((2, FEATURES), np.float32), np.ones(2, np.float32), REFLEX, GGCNN, GRIPPER)
    for i, held in enumerate((True, False, False)):
        one = tried(0.1 * i, held=held, t_grasp=110.0 + 10.0 * i)
        (tmp_path / file_name(one)).write_bytes(encode(one))
    more = with_episodes(few, [tmp_path])
    np.testing.assert_array_equal(more.lifted, [1.0, 1.0, 1.0, 0.0, 0.0])
    assert more.features.shape == (5, FEATURES) and more.features.dtype == np.float32
    assert more[2:] == few[2:]
    with pytest.raises(RigError, match="holds no grasp that was tried with the GG-CNN cdcdcdcdcdcd"):
        with_episodes(few._replace(ggcnn="cd" * 32), [tmp_path])
