"""The model of the physics against the other model of the same robot, and the marker panel against its measures."""

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.poses import pose
from common.rotations import rotation_from_zyx
from common.tag36h11 import CODES, black_cells
from rig_simulation.devices.sunrise.robot import JOINTS, Robot
from rig_simulation.files import FLANGES, ROBOTS, read_board, read_scene, read_urdf
from rig_simulation.world.model import R_FLANGE_BOARD, WorldDescription, build_model, camera_link_pose
from rig_simulation.world.scene import scene_from, tag_mesh

joints = st.lists(st.floats(-2.0, 2.0), min_size=7, max_size=7).map(np.array)
MOUNTINGS = [(0.0, 0.0, 0.0), (180.0, 0.0, 0.0), (10.0, 90.0, -30.0)]


class Pair:
    """One robot in both models."""

    def __init__(self, robot, flange, mounting):
        roll, pitch, yaw = np.radians(mounting)
        self.R_world_base = rotation_from_zyx(yaw, pitch, roll)
        self.robot = Robot(read_urdf(robot, flange), mounting)
        self.model = build_model(WorldDescription(robot, flange, mounting, read_scene("empty")), visuals=False)
        self.data = mujoco.MjData(self.model)
        self.dofs = [self.model.joint(name).dofadr[0] for name in JOINTS]

    def take(self, q):
        self.data.qpos[[self.model.joint(name).qposadr[0] for name in JOINTS]] = q
        mujoco.mj_forward(self.model, self.data)


PAIRS = [
    Pair(robot, flange, mounting)
    for robot, flange, mounting in zip(ROBOTS, (FLANGES[0], FLANGES[3]), MOUNTINGS[1:])
]  # fmt: skip
PAIRS.append(Pair(ROBOTS[0], FLANGES[0], MOUNTINGS[0]))


@pytest.mark.parametrize("pair", PAIRS)
@settings(max_examples=40)
@given(q=joints)
def test_flange_and_gravity_are_those_of_the_controllers_model(pair, q):
    pair.take(q)
    body = pair.data.body("kuka/flange")
    T_base_flange = pose(pair.R_world_base.T @ body.xmat.reshape(3, 3), pair.R_world_base.T @ body.xpos)
    np.testing.assert_allclose(T_base_flange, pair.robot.flange(q), atol=1e-6)
    gravity = pair.robot.torques(q, np.zeros(7), np.zeros(7))
    np.testing.assert_allclose(pair.data.qfrc_bias[pair.dofs], gravity, atol=1e-3)


@pytest.mark.parametrize(("panel", "beyond"), [("single", 0.0435), ("bundle", 0.1035)])
def test_the_panel_stands_as_the_rigs_part_does(panel, beyond):
    # Seen from the tag: the flange's attitude about Z, Y, X is 180, 0, 90 deg; the tag is 71.1 mm beside the flange's
    # axis; the single one is 43.5 mm beyond its face, the larger plate farther, to clear the forearm.
    T_flange_tag = pose(R_FLANGE_BOARD, read_board(panel)["centre"])
    np.testing.assert_allclose(T_flange_tag[:3, :3].T, rotation_from_zyx(np.pi, 0.0, np.pi / 2.0), atol=1e-12)
    np.testing.assert_allclose(T_flange_tag[2, 3], beyond, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(T_flange_tag[:2, 3]), 0.0711, atol=1e-12)
    assert T_flange_tag[:3, 2] @ [0, 0, 1] == 0.0, "its face is parallel to the flange's axis"
    assert T_flange_tag[:3, 2] @ T_flange_tag[:3, 3] > 0.0, "it looks away from the flange"


@pytest.mark.parametrize("tag", range(len(CODES)))
def test_tags_are_those_of_another_library(tag):
    cv2 = pytest.importorskip("cv2")
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    upside_down = cv2.aruco.generateImageMarker(family, tag, 8, borderBits=1)
    np.testing.assert_array_equal(black_cells(tag), np.rot90(upside_down, 2) == 0)


@pytest.mark.parametrize("tag", range(len(CODES)))
def test_the_triangles_of_a_tag_cover_its_black_cells_and_face_outwards(tag):
    vertices, triangles = tag_mesh(tag, 0.08)
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2.0
    front = normals[normals[:, 2] > 1e-12]
    assert front[:, 2].sum() == pytest.approx(black_cells(tag).sum() * 0.01**2)
    volume = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    assert volume == pytest.approx(black_cells(tag).sum() * 0.01**2 * 0.0002)
    np.testing.assert_allclose(np.abs(vertices[:, :2]).max(), 0.04)


def test_the_camera_looks_at_its_target_with_its_picture_upright():
    camera = scene_from(read_scene("cup")).camera
    T = camera_link_pose(camera)
    ahead = (camera.target - camera.position) / np.linalg.norm(camera.target - camera.position)
    np.testing.assert_allclose(T[:3, 0], ahead, atol=1e-12)
    assert T[2, 2] > 0.0 and T[2, 1] == 0.0
    pair = PAIRS[-1]
    pair.take(np.zeros(7))
    for name, beside in (("rgb", 0.045), ("depth", 0.018)):
        seen = pair.data.camera(f"camera_{name}_optical_frame")
        R_world_camera = seen.xmat.reshape(3, 3)
        np.testing.assert_allclose(-R_world_camera[:, 2], ahead, atol=1e-9)
        np.testing.assert_allclose(R_world_camera[:, 1], T[:3, 2], atol=1e-9)
        np.testing.assert_allclose(T[:3, :3].T @ (seen.xpos - T[:3, 3]), [0.0, -beside, 0.0], atol=1e-9)
