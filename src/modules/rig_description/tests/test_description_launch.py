"""description.launch: the file that it reads, and what it tells the publisher of the base's orientation."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rig_msgs.srv")
from tools import launched

pytestmark = pytest.mark.ros


def test_unknown_arm_ends_the_launch_with_the_name_of_the_missing_file():
    with pytest.raises(FileNotFoundError, match="lbr9_MF_elektrisch.urdf"):
        launched.parameters("rig_description", "description.launch", "robot:=LBR9")


def test_only_a_mounting_makes_a_world():
    assert launched.nodes("rig_description", "description.launch") == {"/robot_state_publisher"}
    words = launched.command_line("rig_description", "description.launch", "mounting", "mounting:=20 30 -40")
    np.testing.assert_allclose(np.degrees([float(word) for word in words[:6]]), [0, 0, 0, -40, 30, 20], atol=1e-6)
    assert words[6:] == ["world", "kuka/base_frame"]
