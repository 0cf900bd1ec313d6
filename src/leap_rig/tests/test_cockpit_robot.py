"""The robot of a description as the cockpit draws it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.poses import pose
from common.rotations import rotation_from_quaternion
from leap_rig.cockpit.robot_tree import DescriptionFault, links_of, surfaces_of
from rig_description.urdf import all_files, urdf
from rig_simulation.files import read_mesh

URDF = urdf("LBR7R800", "MF_elektrisch")


def test_every_description_of_the_rig_is_a_tree_with_its_meshes():
    for text in all_files().values():
        links = links_of(text)
        names = [link.name for link in links]
        assert links[0].parent == "" and all(link.parent in names[:n] for n, link in enumerate(links) if n)
        assert [link.joint for link in links if link.moves][:7] == [f"kuka/joint_{n}" for n in range(1, 8)]


def test_surfaces_are_in_metres_and_one_for_each_colour():
    for link in links_of(URDF):
        surfaces = surfaces_of(link, read_mesh)
        looks = [(surface.colour, surface.smooth) for surface in surfaces]
        assert bool(surfaces) == bool(link.shapes) and len(set(looks)) == len(looks)
        for surface in surfaces:
            assert np.abs(surface.vertices).max() < 0.7 and surface.triangles.max() < len(surface.vertices)
            assert all(0 <= part <= 255 for part in surface.colour)


@given(st.floats(-3.0, 3.0))
def test_a_joint_turns_its_link_about_its_axis(angle):
    link = next(link for link in links_of(URDF) if link.joint == "kuka/joint_2")
    c, s = np.cos(angle), np.sin(angle)
    about_z = pose(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))
    seven = link.at(angle)
    assert pose(rotation_from_quaternion(seven[3:]), seven[:3]) == pytest.approx(link.T_parent_link @ about_z, abs=1e-9)


LINK = '<link name="a"><visual><geometry>{}</geometry></visual></link>'


@pytest.mark.parametrize(
    "text",
    [
        "", "no xml", "<robot/>", '<robot><link/></robot>', "<robot>" + LINK.format("<cone/>") + "</robot>",
        "<robot>" + LINK.format('<box size="1 nan 1"/>') + "</robot>",
        "<robot>" + LINK.format('<box size="1 1"/>') + "</robot>",
        "<robot>" + LINK.format('<cylinder radius="a" length="1"/>') + "</robot>",
        '<robot><link name="a"/><joint name="j" type="revolute"><parent link="a"/><child link="a"/></joint></robot>',
        '<robot><link name="a"/><link name="b"/><joint name="j" type="revolute"><parent link="a"/><child link="b"/>'
        '<axis xyz="0 0 0"/></joint></robot>',
        "<robot>" + "".join(f'<link name="{n}"/>' for n in range(500)) + "</robot>",
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_a_bad_description_is_refused(text):
    with pytest.raises(DescriptionFault):
        links_of(text)


def test_an_unknown_mesh_is_refused():
    mesh = '<mesh filename="package://rig_description/meshes/none.dae"/>'
    (link,) = links_of("<robot>" + LINK.format(mesh) + "</robot>")
    with pytest.raises(OSError):
        surfaces_of(link, read_mesh)
    with pytest.raises(DescriptionFault):
        surfaces_of(link, lambda _: "<COLLADA/>")
