"""The bodies of the collision guard: they enclose the meshes; the file of obstacles."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import yaml
from loop_world import CONFIG

from common.errors import ConfigError, RigError
from common.poses import pose
from common.rotations import rotation_about
from iiwa_kinematics import ROBOTS, robot_model
from kuka_control.model.obstacles import BUILT_IN, ConvexShape, obstacles_from
from kuka_control.model.robot_shape import Opening, arm_bodies, hand_bodies, table
from rig_description import arms, hand, shapes

MESHES = Path(arms.__file__).parents[2] / "meshes"
BOX = {"kind": "box", "position": [0.5, 0.0, 0.1], "size": [0.1, 0.2, 0.3]}


def vertices(mesh):
    """Of a mesh, shape (n, 3) [m]."""
    text = next(e for e in ET.parse(MESHES / f"{mesh}.dae").iter() if e.tag.endswith("float_array")).text
    return 1e-3 * np.array(text.split(), dtype=float).reshape(-1, 3)


def rims(discs):
    """Points on the edges of cylinders, shape (n, 3) [m]."""
    points = [np.zeros((0, 3))]
    for disc in discs:
        ends = np.array([disc.bottom, disc.top], dtype=float)
        axis = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        u = np.cross(axis, (0.6, 0.64, 0.48))
        u /= np.linalg.norm(u)
        angles = np.linspace(0.0, 2.0 * np.pi, 40)[:, None]
        circle = disc.radius * (np.cos(angles) * u + np.sin(angles) * np.cross(axis, u))
        points += [end + circle for end in ends]
    return 1e-3 * np.concatenate(points)


def outside(points, bodies):
    """How far the farthest point is outside of the union of bodies [m]; negative: inside."""
    return float(np.max(np.min([signed_distances(points, body) for body in bodies], axis=0)))


def signed_distances(points, body):
    p = (points - body.T_link_body[:3, 3]) @ body.T_link_body[:3, :3]
    size = body.shape.size
    if body.shape.kind == "sphere":
        return np.linalg.norm(p, axis=1) - size[0]
    if body.shape.kind == "capsule":
        p[:, 2] -= np.clip(p[:, 2], -size[1] / 2.0, size[1] / 2.0)
        return np.linalg.norm(p, axis=1) - size[0]
    if body.shape.kind == "cylinder":
        return np.maximum(np.hypot(p[:, 0], p[:, 1]) - size[0], np.abs(p[:, 2]) - size[1] / 2.0)
    return np.max(np.abs(p) - np.array(size) / 2.0, axis=1)


def moved(T, points):
    return points @ T[:3, :3].T + T[:3, 3]


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("link", range(8))
def test_a_link_is_inside_its_bodies_by_a_little_at_most(robot, link):
    arm, model = arms.ARMS[robot], robot_model(robot, "MF_touch_pneumatisch")
    bodies = [body for body in arm_bodies(model, False) if body.link == link]
    points = rims(shapes.arm_trim(arm, link))
    if link < 7:
        points = np.concatenate([points, vertices(f"{robot.lower()}/link_{link}")])
    assert outside(points, bodies) <= 0.0
    assert outside(points, bodies) > -0.025, "no larger than it has to be"


def test_media_flange_connector_and_ring_are_inside():
    model = robot_model("LBR7R800", "MF_touch_pneumatisch")
    T = pose(p=(0.0, 0.0, model.wrist_flange))
    for ring in (False, True):
        bodies = [body for body in arm_bodies(model, ring) if body.link == 7]
        flange = rims(shapes.media_flange("MF_touch_pneumatisch", 61.0))
        top = hand.CONNECTOR_LENGTH + ring * hand.RING_LENGTH
        connector = rims([shapes.Disc("grey", 1e3 * hand.CONNECTOR_RADIUS, (0.0, 0.0, 0.0), (0.0, 0.0, 1e3 * top))])
        points = [flange, connector]
        if ring:
            points += [np.array(corners) for corners in (hand.RING_PAD, hand.RING_ARM)]
        assert outside(moved(T, np.concatenate(points)), bodies) <= 1e-9


def test_the_hand_is_inside_its_bodies_at_any_opening_and_unknown():
    model = robot_model("LBR7R800", "MF_elektrisch")
    parts = {
        part: np.concatenate([vertices(f"reflex/{mesh}") for mesh in meshes]) for part, meshes in shapes.LOOK.items()
    }
    parts["proximal"] = np.concatenate([parts["proximal"], rims(shapes.hand_trim("proximal"))])
    random = np.random.default_rng(1)
    unknown = hand_bodies(model, False, None)
    for _ in range(40):
        opening = Opening(
            tuple(random.uniform(0.0, hand.PROXIMAL_MAX, 3)),
            tuple(random.uniform(0.0, hand.DISTAL_MAX, 3)),
            float(random.uniform(0.0, hand.PRESHAPE_MAX)),
        )
        bodies = hand_bodies(model, False, opening)
        frames = {
            "base_link": pose(
                rotation_about(2, hand.CONNECTOR_YAW), (0.0, 0.0, model.wrist_flange + hand.CONNECTOR_LENGTH)
            )
        }
        for joint in hand.JOINTS:
            kind, finger = joint.name.split("_")[0], int(joint.name[-1])
            angle = {
                "preshape": opening.preshape * (1.0 if finger == 1 else -1.0),
                "proximal": opening.proximal[finger - 1],
                "distal": opening.distal[finger - 1],
            }[kind]
            turn = rotation_about(2 if kind == "preshape" else 1, -angle)
            frames[joint.child] = frames[joint.parent] @ pose(rotation_about(2, joint.yaw) @ turn, joint.xyz)
        for link, T in frames.items():
            points = moved(T, parts[hand.part(link)])
            assert outside(points, bodies) <= 1e-9, link
            assert outside(points, unknown) <= 1e-9, link


@pytest.mark.parametrize("arm", ROBOTS)
def test_an_obstacle_may_not_have_the_name_of_a_body_of_the_robot(arm):
    model = robot_model(arm, "MF_elektrisch")
    known = {body.name for body in (*arm_bodies(model, True), *hand_bodies(model, True, None), table())}
    assert known == BUILT_IN
    with pytest.raises(ConfigError, match="palm is the name of a body"):
        obstacles_from({"palm": BOX}, 0.161)


@pytest.mark.ros
def test_an_obstacle_that_stands_twice_in_a_file_is_refused(tmp_path):
    from common.ros.files import read_yaml

    path = tmp_path / "obstacles.yaml"
    path.write_text("post: {kind: sphere}\npost: {kind: box}\n")
    with pytest.raises(RigError, match="'post' stands twice"):
        read_yaml(path)
    path.write_text("a: &a {kind: sphere, radius: 1}\nb: {<<: *a, radius: 2}\n")
    assert read_yaml(path)["b"] == {"kind": "sphere", "radius": 2}


def test_the_shipped_example_of_obstacles_is_valid():
    bodies = obstacles_from(yaml.safe_load((CONFIG / "guard_obstacles_example.yaml").read_text()), 0.161)
    assert [body.name for body in bodies] == ["camera", "monitor_arm", "marker_board"]
    assert [body.link for body in bodies] == [0, 0, 7]
    np.testing.assert_allclose(bodies[2].T_link_body[:3, 3], [0.0, 0.0611, 0.2045])
    camera = rotation_about(2, np.radians(150.0)) @ rotation_about(1, np.radians(35.0))
    np.testing.assert_allclose(bodies[0].T_link_body, pose(camera, (1.1, -0.1, 0.75)), atol=1e-12)
    assert bodies[1].shape == ConvexShape("capsule", (0.04, 0.5))
    np.testing.assert_allclose(bodies[1].T_link_body[:3, 2], [0.0, -1.0, 0.0], atol=1e-12)


def test_the_table_ends_at_the_base():
    top = table().T_link_body[2, 3] + 0.5 * table().shape.size[2]
    assert top == pytest.approx(0.0, abs=1e-12)


def test_a_joint_of_the_hand_that_reports_more_than_it_can_counts_as_at_its_end():
    model = robot_model("LBR7R800", "MF_elektrisch")
    for beyond, end in (((-0.3, -0.2), (0.0, 0.0)), ((4.0, 4.0), (np.pi, hand.DISTAL_MAX))):
        for body, expected in zip(
            *(hand_bodies(model, False, Opening((p,) * 3, (d,) * 3, 0.3)) for p, d in (beyond, end))
        ):
            np.testing.assert_allclose(body.T_link_body, expected.T_link_body, atol=1e-12)


@pytest.mark.parametrize(
    "change, key",
    [({"kind": "cone"}, "kind"), ({"size": [0.1, 0.2]}, "size"), ({"size": [0.1, 0.2, -1.0]}, "size"),
     ({"position": [float("nan"), 0.0, 0.0]}, "position"), ({"frame": "world"}, "frame"), ({"colour": 1}, "colour")],
)  # fmt: skip
def test_a_bad_obstacle_is_refused_with_its_key(change, key):
    with pytest.raises(ConfigError) as caught:
        obstacles_from({"good": BOX, "bad": {**BOX, **change}}, 0.161, "file: ")
    assert len(caught.value.faults) == 1 and caught.value.faults[0].startswith(f"file: bad/{key}")
