"""The checked-in URDF files against the toolbox's check values, the data sheets and the laws of rigid bodies."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest

PACKAGE = Path(__file__).parents[1]
FILES = sorted((PACKAGE / "urdf").glob("*.urdf"))
ARM_JOINTS = [f"kuka/joint_{i}" for i in range(1, 8)]
FLANGE_HEIGHT = {
    "MF_elektrisch": 0.035,
    "MF_pneumatisch": 0.035,
    "MF_IO_pneumatisch": 0.035,
    "MF_touch_pneumatisch": 0.061,
}

every_file = pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)


def path_of(robot: str, flange: str = "MF_elektrisch") -> Path:
    return PACKAGE / "urdf" / f"{robot.lower()}_{flange}.urdf"


def place(path: Path, frame: str, **angles) -> pin.SE3:
    """Returns the pose of a frame in kuka/base_frame at joint angles [rad] given by name, `kuka=` or `reflex=`."""
    model = pin.buildModelFromUrdf(str(path))
    data, q = model.createData(), pin.neutral(model)
    for joint, angle in {**dict(zip(ARM_JOINTS, angles.get("kuka", ()))), **angles.get("reflex", {})}.items():
        q[model.joints[model.getJointId(joint)].idx_q] = angle
    pin.framesForwardKinematics(model, data, q)
    frames = [model.getFrameId("kuka/base_frame"), model.getFrameId(frame)]
    assert max(frames) < model.nframes, frame
    return data.oMf[frames[0]].actInv(data.oMf[frames[1]])


DEG = np.pi / 180.0
BENT = np.array([10, 20, 30, -40, 50, 60, 70]) * DEG
# Robot, flange (None: the bare arm), joints [rad], position [mm], A, B, C [rad] as the toolbox's client computes them.
CHECK_VALUES = [
    ("LBR7R800", "MF_elektrisch", np.zeros(7), (0, 0, 1301), (0, 0, 0)),
    ("LBR14R820", "MF_elektrisch", np.zeros(7), (0, 0, 1341), (0, 0, 0)),
    ("LBR7R800", "MF_pneumatisch", np.array([0, 30, 0, -60, 0, 90, 0]) * DEG, (600, 0, 525.4102), (np.pi, 0, np.pi)),
    ("LBR7R800", "MF_elektrisch", BENT, (443.5973, 363.8146, 914.0745), (2.958711, -0.495729, 1.666864)),
    ("LBR7R800", "MF_touch_pneumatisch", BENT, (447.1375, 389.4789, 911.8808), (2.958711, -0.495729, 1.666864)),
    ("LBR14R820", "MF_IO_pneumatisch", BENT, (450.3338, 365.0024, 952.8683), (2.958711, -0.495729, 1.666864)),
    (
        "LBR7R800", None, (0.1, 0.5, -0.2, -1.2, 0.3, 0.8, 0.4),
        (664.2448, -4.0660, 544.6541), (2.437709, 0.485152, 2.652720),
    ),
]  # fmt: skip


@pytest.mark.parametrize(("robot", "flange", "joints", "position", "abc"), CHECK_VALUES)
def test_flange_stands_where_the_toolbox_says(robot, flange, joints, position, abc):
    pose = place(path_of(robot, flange or "MF_elektrisch"), "kuka/flange", kuka=joints)
    height = 0.0 if flange else FLANGE_HEIGHT["MF_elektrisch"]
    np.testing.assert_allclose(1e3 * pose.act(np.array([0, 0, -height])), position, atol=2e-4)
    np.testing.assert_allclose(pose.rotation, pin.rpy.rpyToMatrix(*abc[::-1]), atol=1e-6)


@every_file
def test_limits_are_those_of_the_data_sheet(path):
    model = pin.buildModelFromUrdf(str(path))
    speeds, torques = {
        "lbr7r800": ([98, 98, 100, 130, 140, 180, 180], [176, 176, 110, 110, 110, 40, 40]),
        "lbr14r820": ([85, 85, 100, 75, 130, 135, 135], [320, 320, 176, 176, 110, 40, 40]),
    }[path.stem.split("_")[0]]
    index = [model.joints[model.getJointId(name)].idx_v for name in ARM_JOINTS]
    ranges = np.radians([170, 120, 170, 120, 170, 120, 175])
    np.testing.assert_allclose(model.upperPositionLimit[index], ranges, atol=1e-12)
    np.testing.assert_allclose(model.lowerPositionLimit[index], -ranges, atol=1e-12)
    np.testing.assert_allclose(model.velocityLimit[index], np.radians(speeds), atol=1e-12)
    np.testing.assert_array_equal(model.effortLimit[index], torques)


@every_file
def test_tree_has_the_agreed_names_and_one_root(path):
    tree = ET.parse(path).getroot()
    links = [link.get("name") for link in tree.findall("link")]
    fingers = [f"reflex/{part}_{i}" for part in ("proximal", "distal") for i in (1, 2, 3)]
    assert len(links) == len(set(links))
    assert set(links) == {
        "kuka/base_frame", *(f"kuka/link_{i}" for i in range(8)), "kuka/flange",
        "reflex/base_link", "reflex/swivel_1", "reflex/swivel_2", *fingers,
    }  # fmt: skip
    children = [joint.find("child").get("link") for joint in tree.findall("joint")]
    assert set(links) - set(children) == {"kuka/base_frame"}
    assert len(children) == len(set(children))
    movable = {joint.get("name") for joint in tree.findall("joint") if joint.get("type") == "revolute"}
    assert movable == {
        *ARM_JOINTS, "reflex/preshape_1", "reflex/preshape_2",
        *(f"reflex/{part}_joint_{i}" for part in ("proximal", "distal") for i in (1, 2, 3)),
    }  # fmt: skip


@every_file
def test_hand_stands_on_the_connector_with_its_two_fingers_away_from_the_flange_x_axis(path):
    flange, hand = place(path, "kuka/flange", kuka=BENT), place(path, "reflex/base_link", kuka=BENT)
    expected = pin.SE3(np.diag([-1.0, -1.0, 1.0]), np.array([0, 0, 0.026]))
    np.testing.assert_allclose(flange.actInv(hand).homogeneous, expected.homogeneous, atol=1e-9)


@every_file
def test_with_the_ring_the_hand_stands_10_mm_farther_and_nothing_else_changes(path):
    ring = path.parent / "with_ring" / path.name
    mount = place(ring, "kuka/flange").actInv(place(ring, "reflex/base_link"))
    expected = pin.SE3(np.diag([-1.0, -1.0, 1.0]), np.array([0, 0, 0.036]))
    np.testing.assert_allclose(mount.homogeneous, expected.homogeneous, atol=1e-9)

    def links(file):
        return {link.get("name"): ET.tostring(link) for link in ET.parse(file).getroot().findall("link")}

    with_ring = links(ring)
    marker = ET.fromstring(with_ring.pop("kuka/marker_connector"))
    assert with_ring == links(path)
    assert float(marker.find("inertial/mass").get("value")) == pytest.approx(0.15)


@every_file
def test_centres_of_mass_lie_in_the_links(path):
    """Catches masses that were written down in another frame than the link's."""
    for link in ET.parse(path).getroot().findall("link"):
        cylinder = link.find("collision/geometry/cylinder")
        if cylinder is None or link.get("name") == "kuka/flange":
            continue
        centre, angles = (
            np.array(link.find("collision/origin").get(key).split(), dtype=float) for key in ("xyz", "rpy")
        )
        com = np.array(link.find("inertial/origin").get("xyz").split(), dtype=float)
        x, y, z = pin.rpy.rpyToMatrix(*angles).T @ (com - centre)
        assert abs(z) < float(cylinder.get("length")) / 2.0, link.get("name")
        assert np.hypot(x, y) < float(cylinder.get("radius")), link.get("name")


@every_file
def test_masses_are_those_of_the_data_sheets(path):
    model = pin.buildModelFromUrdf(str(path))
    tree = ET.parse(path).getroot()
    mass = {
        link.get("name"): float(link.find("inertial/mass").get("value"))
        for link in tree.findall("link")
        if link.find("inertial") is not None
    }
    arm = sum(mass[f"kuka/link_{i}"] for i in range(8))
    assert arm == pytest.approx({"lbr7r800": 23.9, "lbr14r820": 29.9}[path.stem.split("_")[0]], abs=1e-6)
    connector = 0.18
    assert sum(m for name, m in mass.items() if name.startswith("reflex/")) - connector == pytest.approx(0.9, abs=0.05)
    assert sum(inertia.mass for inertia in model.inertias) == pytest.approx(sum(mass.values()))


class TestHand:
    """Where fingers point, in the frame of the hand."""

    TIP = pin.SE3(np.eye(3), np.array([0.048, 0.0, 0.0]))

    def tip(self, finger: int, **angles) -> np.ndarray:
        path = path_of("LBR7R800")
        joints = {f"reflex/{name}": angle for name, angle in angles.items()}
        base, distal = place(path, "reflex/base_link"), place(path, f"reflex/distal_{finger}", reflex=joints)
        return base.actInv(distal).act(self.TIP).translation

    def test_flat_fingers_span_the_vendors_length(self):
        np.testing.assert_allclose(self.tip(1)[:2], [0.174, -0.026], atol=5e-4)
        np.testing.assert_allclose(self.tip(2)[:2], [0.174, 0.026], atol=5e-4)
        np.testing.assert_allclose(self.tip(3)[:2], [-0.144, 0.0], atol=5e-4)

    @pytest.mark.parametrize("finger", [1, 2, 3])
    def test_proximal_joint_lifts_the_finger_and_folds_it_over_the_palm(self, finger):
        flat, up, folded = (
            self.tip(finger, **{f"proximal_joint_{finger}": angle}) for angle in (0.0, np.pi / 2, np.pi)
        )
        outwards = np.sign(flat[0])
        assert up[2] == pytest.approx(0.0816 + 0.114, abs=1e-3)
        assert outwards * flat[0] > outwards * up[0] > outwards * folded[0]

    @pytest.mark.parametrize("finger", [1, 2, 3])
    def test_distal_joint_bends_the_same_way(self, finger):
        straight = self.tip(finger, **{f"proximal_joint_{finger}": np.pi / 2})
        bent = self.tip(finger, **{f"proximal_joint_{finger}": np.pi / 2, f"distal_joint_{finger}": 0.5})
        assert np.sign(straight[0]) * (straight[0] - bent[0]) > 0.01

    def test_preshape_turns_the_first_two_fingers_away_from_each_other(self):
        first, second = self.tip(1, preshape_1=np.pi / 2), self.tip(2, preshape_2=-np.pi / 2)
        np.testing.assert_allclose(first * [1, -1, 1], second, atol=1e-9)
        assert first[1] < -0.14

    def test_fingers_of_the_pinch_close_towards_each_other(self):
        first = self.tip(1, preshape_1=np.pi / 2, proximal_joint_1=2.0)
        assert first[1] > self.tip(1, preshape_1=np.pi / 2, proximal_joint_1=np.pi / 2)[1] > -0.05
