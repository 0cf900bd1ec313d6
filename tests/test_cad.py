"""The printed parts: their files against the numbers, the numbers against the rig. Needs no CadQuery."""

from __future__ import annotations

import functools
import itertools
import math
import re
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import yaml

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT))  # where cad is a package

from cad import dimensions as d  # noqa: E402
from cad import manifest  # noqa: E402

trimesh = pytest.importorskip("trimesh")

PARTS = sorted(d.PARTS)


@pytest.fixture(scope="module", params=PARTS)
def part(request):
    return request.param


@pytest.fixture(scope="module")
def meshes():
    """The STL file of each part, in mm."""
    return {name: trimesh.load(manifest.stl(name)) for name in PARTS}


class TestFiles:
    def test_every_folder_with_a_source_is_a_known_part(self):
        assert sorted(path.parent.name for path in manifest.FOLDER.glob("*/part.py")) == PARTS

    def test_nothing_is_stale(self, part):
        made_from = manifest.checksum(*manifest.sources(part))
        for file in manifest.exported(part):
            name = file.relative_to(manifest.FOLDER).as_posix()
            noted = manifest.read()[name]
            assert noted["sources"] == made_from, f"{name} is older than its sources: make cad"
            assert noted["file"] == manifest.checksum(file), f"{name} is not what was exported: make cad"

    def test_every_file_of_the_manifest_exists(self):
        for name, noted in manifest.read().items():
            assert manifest.checksum(manifest.FOLDER / name) == noted["file"], f"{name}: make cad"

    def test_the_picture_shows_the_part(self, part):
        noted = manifest.read()[f"{part}/{part}.png"]
        assert noted["sources"] == manifest.checksum(manifest.stl(part)), f"{part}.png shows an older part: make cad"

    def test_pictures_and_exports_are_small(self):
        files = [path for path in manifest.FOLDER.rglob("*") if ".venv" not in path.parts and path.is_file()]
        assert max(path.stat().st_size for path in files if path.suffix == ".png") < 80_000
        assert (
            sum(path.stat().st_size for path in files if path.suffix in (".stl", ".step", ".svg", ".png")) < 3_000_000
        )

    def test_the_step_file_holds_one_solid(self, part):
        text = manifest.exported(part)[0].read_text()
        assert text.startswith("ISO-10303-21;") and text.rstrip().endswith("END-ISO-10303-21;")
        assert text.count("MANIFOLD_SOLID_BREP(") == 1
        assert "SI_UNIT(.MILLI.,.METRE.)" in text

    def test_readme_names_the_part_and_its_files(self, part):
        text = (manifest.FOLDER / part / "README.md").read_text()
        for file in (f"{part}.png", f"{part}.stl", f"{part}.step", f"{part}.svg"):
            assert file in text
        assert f"({part}/README.md)" in (manifest.FOLDER / "README.md").read_text()


class TestShapes:
    def test_closed_and_the_right_way_out(self, part, meshes):
        mesh = meshes[part]
        assert mesh.is_watertight and mesh.is_winding_consistent
        assert mesh.volume > 0.0
        assert len(mesh.split(only_watertight=True)) == 1

    def test_bounding_box(self, part, meshes):
        np.testing.assert_allclose(meshes[part].bounds, [d.PARTS[part].low, d.PARTS[part].high], atol=0.02)

    def test_fits_the_printer(self, part, meshes):
        assert max(meshes[part].extents) <= d.PRINTER


def on_circle(diameter, angles):
    return [diameter / 2 * np.array([math.cos(math.radians(a)), math.sin(math.radians(a))]) for a in angles]


def section(mesh, height, axis=2):
    """Returns the segments of a section across an axis, shape (n, 2, 2), without the axis' coordinate."""
    normal, origin = np.eye(3)[axis], height * np.eye(3)[axis]
    lines = trimesh.intersections.mesh_plane(mesh, normal, origin)
    return np.delete(lines, axis, axis=2)


def clearance(segments, place):
    """Returns the distance of a place from the nearest segment: the radius of the hole round it."""
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    t = np.clip(((place - start) * along).sum(1) / np.maximum((along**2).sum(1), 1e-12), 0.0, 1.0)
    return np.linalg.norm(start + t[:, None] * along - place, axis=1).min()


def assert_holes(segments, places, diameter):
    for place in places:
        assert clearance(segments, np.array(place)) == pytest.approx(diameter / 2, abs=0.06), place


class TestHoles:
    def test_of_the_connector_on_the_flange(self, meshes):
        low, high = section(meshes["kuka_connector"], 2.0), section(meshes["kuka_connector"], 10.0)
        screws = on_circle(d.FLANGE_CIRCLE, d.FLANGE_SCREWS)
        every = on_circle(d.JOINT_CIRCLE, np.arange(0.0, 360.0, d.JOINT_STEP))
        assert_holes(low, screws, d.M6_HOLE)
        assert_holes(high, screws, d.SCREW_POCKET)
        assert_holes(low, on_circle(d.FLANGE_CIRCLE, d.DOWELS), d.DOWEL_PILOT)
        assert_holes(low, every, d.M5_NUT_WIDTH + d.NUT_PLAY)
        assert_holes(high, every, d.M5_HOLE)
        assert_holes(high, [(0.0, 0.0)], d.BORE)
        spigot = section(meshes["kuka_connector"], -2.0)
        assert np.linalg.norm(spigot, axis=2).max() * 2 == pytest.approx(d.FLANGE_CENTRING - d.FIT, abs=0.01)

    def test_of_the_connector_on_the_hand(self, meshes):
        low, high = section(meshes["hand_connector"], 2.0), section(meshes["hand_connector"], 9.0)
        bolts = on_circle(d.HAND_CIRCLE, d.HAND_BOLTS)
        assert_holes(low, bolts, d.M6_NUT_WIDTH + d.NUT_PLAY)
        assert_holes(high, bolts, d.M6_HOLE)
        assert_holes(low, on_circle(d.JOINT_CIRCLE, d.JOINT_SCREWS), d.M5_HOLE)

    def test_of_the_ring(self, meshes):
        ring = section(meshes["marker_connector"], d.RING / 2)
        assert_holes(ring, on_circle(d.FLANGE_CIRCLE, d.FLANGE_SCREWS), d.M6_HOLE)
        assert_holes(ring, on_circle(d.FLANGE_CIRCLE, d.DOWELS), d.DOWEL_PILOT)
        assert_holes(ring, [(0.0, 0.0)], d.FLANGE_CENTRING + d.FIT)
        pad = section(meshes["marker_connector"], d.PAD_FACE - 1.0, axis=1)
        assert_holes(pad, d.PAD_SCREWS, d.M4_HOLE)

    @pytest.mark.parametrize(
        ("plate", "beyond"), [("marker_plate", d.SINGLE_BEYOND), ("panel_bracket", d.PANEL_BEYOND)]
    )
    def test_what_carries_a_tag_fits_the_pad(self, meshes, plate, beyond):
        back = section(meshes[plate], d.PARTS[plate].low[2] + 1.0)
        assert_holes(back, [(-x, z - beyond) for x, z in d.PAD_SCREWS], d.M4_INSERT_HOLE)

    def test_of_the_bracket_for_the_plate(self, meshes):
        assert_holes(section(meshes["panel_bracket"], -1.0), d.PANEL_SCREWS, d.M4_INSERT_HOLE)

    def test_of_the_holders(self, meshes):
        assert_holes(section(meshes["camera_holder"], -d.CRADLE_FLOOR + 1.0), [(0.0, 0.0)], d.QUARTER_INSERT_HOLE)
        assert_holes(section(meshes["leap_holder"], 1.0), d.LEAP_FEET, d.M5_NUT_WIDTH + d.NUT_PLAY)
        pocket = section(meshes["leap_holder"], d.LEAP_BASE[2] + 1.0)
        assert clearance(pocket, np.array([10.0, 0.0])) * 2 == pytest.approx(d.LEAP[1] + d.LEAP_PLAY, abs=0.01)


class TestScrews:
    def test_reach_into_the_flange(self):
        through = d.SCREW_FLOOR + d.M6_WASHER_THICKNESS
        least, greatest = d.FLANGE_THREAD
        assert least <= d.FLANGE_SCREW - through <= greatest
        assert least <= d.FLANGE_SCREW_WITH_RING - through - d.RING <= greatest

    def test_heads_and_nuts_stay_inside(self):
        assert d.SCREW_FLOOR + d.M6_WASHER_THICKNESS + d.M6_HEAD_HEIGHT <= d.KUKA_CONNECTOR
        assert d.M6_WASHER < d.SCREW_POCKET
        assert d.CONNECTOR_LENGTH - d.JOINT_NUT_POCKET <= d.JOINT_SCREW < d.CONNECTOR_LENGTH
        assert d.M5_NUT_HEIGHT < d.JOINT_NUT_POCKET and d.M6_NUT_HEIGHT < d.HAND_NUT_POCKET

    def test_the_hand_can_stand_at_every_step(self):
        assert all(angle % d.JOINT_STEP == 0.0 for angle in d.JOINT_SCREWS)

    def test_walls_between_holes(self):
        """Neighbours in one plane, as place and greatest radius, are 1.5 mm apart."""

        def circles(diameter, angles, radius):
            return [(place, radius) for place in on_circle(diameter, angles)]

        corner = 1.0 / math.cos(math.radians(30.0))
        steps = np.arange(0.0, 360.0, d.JOINT_STEP)
        nut_m5, nut_m6 = (corner * (width + d.NUT_PLAY) / 2 for width in (d.M5_NUT_WIDTH, d.M6_NUT_WIDTH))
        flange = circles(d.FLANGE_CIRCLE, d.FLANGE_SCREWS, d.M6_HOLE / 2) + circles(d.FLANGE_CIRCLE, d.DOWELS, 3.0)
        planes = (
            flange + circles(d.JOINT_CIRCLE, steps, nut_m5) + [(np.zeros(2), d.FLANGE_CENTRING / 2)],
            circles(d.FLANGE_CIRCLE, d.FLANGE_SCREWS, d.SCREW_POCKET / 2)
            + circles(d.JOINT_CIRCLE, steps, d.M5_HOLE / 2)
            + [(np.zeros(2), d.BORE / 2)],
            circles(d.HAND_CIRCLE, d.HAND_BOLTS, nut_m6)
            + circles(d.JOINT_CIRCLE, d.JOINT_SCREWS, d.M5_COUNTERSINK / 2)
            + [(np.zeros(2), d.HAND_BORE / 2)],
        )
        for plane in planes:
            for (a, r), (b, s) in itertools.combinations(plane, 2):
                assert np.linalg.norm(a - b) - r - s >= 1.5
            for place, radius in plane:
                assert np.linalg.norm(place) + radius <= d.CONNECTOR_OUTER / 2 - 1.4

    def test_screws_of_the_plate_stand_in_the_white(self):
        for (x, y), (_, size, u, v) in itertools.product(d.PANEL_SCREWS, d.PANEL_TAGS):
            free = max(abs(x - u), abs(y - v)) - size / 2
            assert free >= size / 8 + 4.5, "the head covers the white margin of a tag"


def matrix(text):
    return [float(value) for value in text.split()]


class TestNumbersOfTheRig:
    @pytest.mark.parametrize("urdf", sorted(ROOT.glob("src/modules/rig_description/urdf/*.urdf")), ids=lambda p: p.stem)
    def test_connectors_are_as_long_as_in_the_description(self, urdf):
        joint = ET.parse(urdf).find(".//joint/child[@link='reflex/base_link']/..")
        assert joint.find("parent").get("link") == "kuka/flange"
        assert matrix(joint.find("origin").get("xyz")) == pytest.approx([0.0, 0.0, d.CONNECTOR_LENGTH / 1000])
        assert d.KUKA_CONNECTOR + d.HAND_CONNECTOR == d.CONNECTOR_LENGTH

    @pytest.mark.parametrize("kind", ["visual", "collision"])
    @pytest.mark.parametrize("urdf", sorted(ROOT.glob("src/modules/rig_description/urdf/*.urdf")), ids=lambda p: p.stem)
    def test_connectors_are_as_wide_as_in_the_description(self, urdf, kind):
        shapes = [
            shape.find("geometry/cylinder")
            for shape in ET.parse(urdf).findall(f"link[@name='reflex/base_link']/{kind}")
        ]
        sizes = [(float(c.get("radius")), float(c.get("length"))) for c in shapes if c is not None]
        assert sizes == [pytest.approx((d.CONNECTOR_OUTER / 2000, d.CONNECTOR_LENGTH / 1000))]

    @pytest.mark.parametrize("kind", ["visual", "collision"])
    @pytest.mark.parametrize(
        "urdf", sorted(ROOT.glob("src/modules/rig_description/urdf/with_ring/*.urdf")), ids=lambda p: p.stem
    )
    def test_ring_is_as_large_as_in_the_description(self, urdf, kind, meshes):
        tree = ET.parse(urdf)
        joint = tree.find(".//joint/child[@link='reflex/base_link']/..")
        assert matrix(joint.find("origin").get("xyz")) == pytest.approx(
            [0.0, 0.0, (d.RING + d.CONNECTOR_LENGTH) / 1000]
        )
        mount = tree.find(".//joint/child[@link='kuka/marker_connector']/..")
        assert mount.find("parent").get("link") == "kuka/flange"
        assert matrix(mount.find("origin").get("xyz")) + matrix(mount.find("origin").get("rpy")) == [0.0] * 6

        corners = []
        for shape in tree.findall(f"link[@name='kuka/marker_connector']/{kind}"):
            centre = np.array(matrix(shape.find("origin").get("xyz")))
            (solid,) = shape.find("geometry")
            if solid.tag == "cylinder":
                radius, length = float(solid.get("radius")), float(solid.get("length"))
                half = np.array([radius, radius, length / 2])
            else:
                half = np.array(matrix(solid.get("size"))) / 2
            corners += [centre - half, centre + half]
        bounds = 1000 * np.array([np.min(corners, axis=0), np.max(corners, axis=0)])
        np.testing.assert_allclose(bounds, meshes["marker_connector"].bounds, atol=0.02)

    @pytest.mark.parametrize("mode", ["rt", "ptp"])
    def test_tool_length(self, mode):
        values = yaml.safe_load((ROOT / f"src/kuka_control/config/kuka_params_{mode}.yaml").read_text())
        assert values["tool_length"] == pytest.approx(d.TOOL_LENGTH / 1000)
        assert d.TOOL_LENGTH_WITH_RING - d.TOOL_LENGTH == d.RING
        values = yaml.safe_load((ROOT / "src/kuka_control/config/marker_ring.yaml").read_text())
        assert values["tool_length"] == pytest.approx(d.TOOL_LENGTH_WITH_RING / 1000)

    def test_readme_says_the_numbers_that_others_copy(self):
        text = (manifest.FOLDER / "README.md").read_text()
        assert f"**{d.TOOL_LENGTH_WITH_RING / 1000:g} m**" in text
        for beyond in (d.SINGLE_BEYOND, d.PANEL_BEYOND):
            assert f"`[0, {d.TAG_DISTANCE / 1000:g}, {beyond / 1000:g}]` m in the flange" in text

    def test_tags_are_those_of_the_simulation_and_of_the_detector(self):
        single, large = (
            yaml.safe_load((ROOT / f"src/modules/rig_simulation/config/panels/{name}.yaml").read_text())
            for name in ("single", "bundle")
        )
        assert single["size"] == pytest.approx([d.SINGLE_PLATE / 1000] * 2)
        assert [(tag["id"], tag["size"]) for tag in single["tags"]] == [(0, d.SINGLE_TAG / 1000)]
        assert large["size"] == pytest.approx([d.PANEL_PLATE / 1000] * 2)
        expected = [(tag, size / 1000, x / 1000, y / 1000) for tag, size, x, y in d.PANEL_TAGS]
        assert [(tag["id"], tag["size"], *tag["position"]) for tag in large["tags"]] == expected

        tags = yaml.safe_load((ROOT / "src/vision/config/tags.yaml").read_text())
        layout = tags["tag_bundles"][0]["layout"]
        assert [(tag["id"], tag["size"], tag["x"], tag["y"]) for tag in layout] == expected
        tags = yaml.safe_load((ROOT / "src/vision/config/tags_single.yaml").read_text())
        assert [(tag["id"], tag["size"]) for tag in tags["standalone_tags"]] == [(0, d.SINGLE_TAG / 1000)]

    @pytest.mark.parametrize(("panel", "beyond"), [("single", d.SINGLE_BEYOND), ("bundle", d.PANEL_BEYOND)])
    def test_places_of_the_tags(self, panel, beyond):
        model = pytest.importorskip("rig_simulation.world.model")
        expected = [0.0, d.TAG_DISTANCE / 1000, beyond / 1000]
        np.testing.assert_allclose(simulated_panel(model, panel), expected, atol=1e-9)

    def test_the_simulated_hand_stands_on_the_ring_where_there_is_a_panel(self):
        model = pytest.importorskip("rig_simulation.world.model")
        for panel, beyond in ((None, d.CONNECTOR_LENGTH), ("single", d.RING + d.CONNECTOR_LENGTH)):
            built = world(model, panel)
            assert built.body("reflex/base_link").pos[2] == pytest.approx(beyond / 1000)


@functools.lru_cache(maxsize=None)
def world(model, panel=None, arm="LBR7R800"):
    config = ROOT / "src/modules/rig_simulation/config"
    scene = {**yaml.safe_load((config / "scenes/cup.yaml").read_text()), "objects": {}}
    values = panel and yaml.safe_load((config / f"panels/{panel}.yaml").read_text())
    return model.build_model(model.WorldDescription(arm, "MF_elektrisch", (0.0, 0.0, 0.0), scene, values))


def simulated_panel(model, name):
    built = world(model, name)
    assert built.body(built.body("panel").parentid[0]).name == "kuka/flange"
    return built.body("panel").pos


class Robot:
    """The simulated arm and hand as points on their surfaces, in mm in the flange's frame."""

    def __init__(self, model, arm):
        self._mujoco = pytest.importorskip("mujoco")
        self._model = world(model, arm=arm)
        self._data = self._mujoco.MjData(self._model)

    def points(self, bodies, **degrees):
        """Returns the points of all bodies whose names begin so, joints by name without prefix."""
        names = {"kuka": "kuka/joint_", "swivel": "reflex/preshape_", "proximal": "reflex/proximal_joint_"}
        self._data.qpos[:] = 0.0
        for joint, angle in degrees.items():
            kind, number = joint.rsplit("_", 1)
            self._data.joint(names[kind] + number).qpos[0] = math.radians(angle)
        self._mujoco.mj_kinematics(self._model, self._data)
        clouds = []
        for i in range(self._model.ngeom):
            geom = self._model.geom(i)
            if geom.type[0] == self._mujoco.mjtGeom.mjGEOM_MESH and self._model.body(geom.bodyid[0]).name in bodies:
                mesh = self._model.mesh(geom.dataid[0])
                vertices = self._model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]]
                faces = self._model.mesh_face[mesh.faceadr[0] : mesh.faceadr[0] + mesh.facenum[0]]
                surface = np.concatenate([vertices, vertices[faces].mean(1)])
                clouds.append(surface @ self._data.geom_xmat[i].reshape(3, 3).T + self._data.geom_xpos[i])
        flange = self._data.body("kuka/flange")
        return 1000.0 * (np.concatenate(clouds) - flange.xpos) @ flange.xmat.reshape(3, 3)

    def hand(self, spread, proximal):
        """Returns the points of the hand as it stands with the ring behind it."""
        angles = {f"proximal_{i}": proximal for i in (1, 2, 3)}
        bodies = {self._model.body(i).name for i in range(self._model.nbody)}
        hand = {name for name in bodies if name.startswith("reflex/")}
        return self.points(hand, swivel_1=spread, swivel_2=-spread, **angles) + np.array([0.0, 0.0, d.RING])


@pytest.fixture(scope="module", params=["LBR7R800", "LBR14R820"])
def robot(request):
    return Robot(pytest.importorskip("rig_simulation.world.model"), request.param)


def box_of(edge, beyond, behind):
    """Opposite corners of a plate with all that stands behind it, in the flange's frame."""
    low = [-edge / 2, behind, beyond - edge / 2]
    return np.array(low), np.array([edge / 2, d.TAG_DISTANCE, beyond + edge / 2])


SINGLE = box_of(d.SINGLE_PLATE, d.SINGLE_BEYOND, d.PAD_FACE)
LARGE = box_of(d.PANEL_PLATE, d.PANEL_BEYOND, d.PAD_FACE)
LARGE_AS_THE_SINGLE = box_of(d.PANEL_PLATE, d.SINGLE_BEYOND, d.PAD_FACE)


def gap(points, box):
    low, high = box
    return np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=1).min()


def gap_to_arm(robot, box, bends):
    arm = {"kuka/link_4", "kuka/link_5", "kuka/link_6"}
    turns = range(-175, 176, 25)
    return min(gap(robot.points(arm, kuka_6=bend, kuka_7=turn), box) for bend in bends for turn in turns)


class TestRoom:
    """Distances by the simulated robot's surfaces, whose shapes are approximate: some millimetres must be left."""

    def test_of_the_single_plate_before_the_arm(self, robot):
        assert gap_to_arm(robot, SINGLE, range(-120, 121, 20)) > 5.0

    def test_of_the_large_plate_before_the_arm(self, robot):
        limit = int(d.PANEL_MAX_JOINT_6)
        assert gap_to_arm(robot, LARGE, range(-limit, limit + 1, 20)) > 10.0

    def test_the_large_plate_cannot_stand_where_the_single_one_does(self, robot):
        assert gap_to_arm(robot, LARGE_AS_THE_SINGLE, [90]) == 0.0

    @pytest.mark.parametrize(("box", "spread"), [(SINGLE, 40.0), (LARGE, d.PANEL_MAX_SPREAD)])
    def test_before_the_hand(self, robot, box, spread):
        for proximal in (0.0, 45.0, 90.0, 135.0, 180.0):
            for angle in (0.0, spread):
                assert gap(robot.hand(angle, proximal), box) > 5.0

    def test_of_the_ring_before_hand_and_connectors(self, robot, meshes):
        for height in (d.RING + 0.1, d.RING + d.CONNECTOR_LENGTH):
            free = clearance(section(meshes["marker_connector"], height), np.zeros(2))
            assert free > d.CONNECTOR_OUTER / 2 + 2.0
        back = d.PAD_FACE - d.PAD_THICKNESS
        pad = np.array([-d.PAD_WIDTH / 2, back, d.RING]), np.array([d.PAD_WIDTH / 2, d.PAD_FACE, d.PAD_HEIGHT])
        assert gap(robot.hand(0.0, 0.0), pad) > 5.0

    def test_the_screws_of_the_plate_are_reached_while_the_hand_is_on(self, robot):
        hand = robot.hand(0.0, 0.0)
        behind = hand[np.abs(hand[:, 1]) < d.PAD_FACE]
        for x, z in d.PAD_SCREWS:
            assert np.hypot(behind[:, 0] - x, behind[:, 2] - z).min() > d.KEY / 2
            assert abs(x) - d.KEY / 2 > d.CONNECTOR_OUTER / 2

    def test_screws_of_the_plate_end_in_its_inserts(self):
        assert 3.0 <= d.PAD_SCREW - d.PAD_THICKNESS <= d.M4_INSERT_DEPTH


class TestTagSheets:
    @pytest.fixture(params=["single_a4.pdf", "panel_a3.pdf"])
    def name(self, request):
        return request.param

    @pytest.fixture
    def text(self, name):
        return (manifest.FOLDER / "tag_sheets" / name).read_bytes().decode("cp1252")

    def test_are_those_of_the_source(self, name):
        from cad.tag_sheets import sheets

        assert (manifest.FOLDER / "tag_sheets" / name).read_bytes() == sheets.FILES[name](), "make cad"

    def test_scale(self, name, text):
        width, height = matrix(re.search(r"/MediaBox \[0 0 ([\d. ]+)\]", text)[1])
        paper = {"single_a4.pdf": (210.0, 297.0), "panel_a3.pdf": (420.0, 297.0)}[name]
        assert (width / 72 * 25.4, height / 72 * 25.4) == pytest.approx(paper, abs=1e-3)
        assert matrix(re.search(r"([\d. ]+) cm\n", text)[1]) == pytest.approx([72 / 25.4, 0, 0, 72 / 25.4, 0, 0])
        assert "/PrintScaling /None" in text

    def test_rulers_measure_100_mm_along_and_across(self, text):
        number = r"([\d.]+) ([\d.]+)"
        lines = np.array([matrix(" ".join(m)) for m in re.findall(rf"{number} m\n{number} l\nS", text)])
        shifts = np.abs(lines[:, 2:] - lines[:, :2])
        assert [100.0, 0.0] in shifts.tolist() and [0.0, 100.0] in shifts.tolist()

    def test_every_offset_of_the_file_is_right(self, name):
        data = (manifest.FOLDER / "tag_sheets" / name).read_bytes()
        table = int(re.search(rb"startxref\n(\d+)", data)[1])
        assert data[table : table + 4] == b"xref"
        for i, offset in enumerate(re.findall(rb"(\d{10}) 00000 n", data), 1):
            assert data[int(offset) :].startswith(b"%d 0 obj" % i)

    def test_a_detector_finds_the_tags_in_their_sizes(self, name, text):
        apriltag = pytest.importorskip("apriltag")
        pixels = 4  # a millimetre
        width, height = {"single_a4.pdf": d.A4, "panel_a3.pdf": d.A3}[name]
        picture = np.full((round(height) * pixels, round(width) * pixels), 255, dtype=np.uint8)
        for box in re.findall(r"([\d.]+) ([\d.]+) ([\d.]+) ([\d.]+) re", text):
            x, y, w, h = (float(value) * pixels for value in box)
            picture[round(len(picture) - y - h) : round(len(picture) - y), round(x) : round(x + w)] = 0
        found = {tag.tag_id: tag for tag in apriltag.Detector(apriltag.DetectorOptions("tag36h11")).detect(picture)}
        tags = ((0, d.SINGLE_TAG, 0.0, 0.0),) if name == "single_a4.pdf" else d.PANEL_TAGS
        assert sorted(found) == [tag for tag, *_ in tags]
        middle = found[0].center / pixels
        for tag, size, x, y in tags:
            corners = found[tag].corners / pixels
            assert found[tag].hamming == 0
            assert np.linalg.norm(corners[1] - corners[0]) == pytest.approx(size, rel=0.01)
            assert corners[1, 0] - corners[0, 0] > 0.9 * size, "it stands upright"
            np.testing.assert_allclose(found[tag].center / pixels - middle, [x, -y], atol=0.5)
