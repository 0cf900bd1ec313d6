"""Scenes and panels of the simulated world: what their yaml says, and what a faulty one is told."""

import dataclasses
import json

import mujoco
import numpy as np
import pytest

from common.errors import ConfigError
from rig_simulation.files import SOURCE_TREE, read_board, read_scene
from rig_simulation.world.model import WorldDescription, build_model, mjcf
from rig_simulation.world.scene import KINDS, board_from, scene_from

SCENES = sorted(path.stem for path in (SOURCE_TREE / "config" / "scenes").glob("*.yaml"))
PANELS = sorted(path.stem for path in (SOURCE_TREE / "config" / "panels").glob("*.yaml"))


def description(scene="objects", panel=None, robot="LBR7R800"):
    """A world as the program describes it."""
    panel = None if panel is None else read_board(panel)
    return WorldDescription(robot, "MF_elektrisch", (0.0, 0.0, 0.0), read_scene(scene), panel)


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_of_the_package_can_be_built(name):
    model = build_model(description(name), visuals=False)
    for thing, shape in scene_from(read_scene(name)).objects.items():
        assert model.body(f"object/{thing}").subtreemass[0] == pytest.approx(shape.mass, rel=1e-3)
        assert model.joint(f"object/{thing}").type == mujoco.mjtJoint.mjJNT_FREE


@pytest.mark.parametrize("name", PANELS)
def test_every_panel_of_the_package_has_its_tags_on_the_plate(name):
    panel = board_from(read_board(name))
    for tag in panel.tags:
        white_border = tag.size / 8.0
        assert np.all(np.abs(tag.position) + tag.size / 2.0 + white_border <= panel.size / 2.0 + 1e-9)
    model = build_model(description(panel=name))
    assert {f"panel/tag_{tag.id}" for tag in panel.tags} <= {model.geom(i).name for i in range(model.ngeom)}


def test_there_is_a_scene_with_one_of_each_kind():
    shapes = scene_from(read_scene("objects")).objects.values()
    assert {type(shape) for shape in shapes} == set(KINDS.values())


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda s: s.pop("table"), "table is missing"),
        (lambda s: s.update(colour=1), "colour is not a known key"),
        (lambda s: s["table"].update(size=[0.7, -1.0]), "table/size is [0.7, -1.0]"),
        (lambda s: s["camera"].update(target=s["camera"]["position"]), "camera/target must not lie straight above"),
        (lambda s: s["objects"]["cup"].update(wall=0.5), "objects/cup/wall is 0.5"),
        (lambda s: s["objects"]["cup"].update(kind="mug"), "objects/cup/kind is 'mug', but must be one of cup, box"),
        (lambda s: s["objects"]["bottle"].update(neck_height=0.2), "objects/bottle/the neck must be lower"),
        (lambda s: s["objects"].update({"My Cup": s["objects"]["cup"]}), "objects/My Cup"),
        (lambda s: s.update(objects=[1]), "objects is [1]"),
    ],
)
def test_the_faults_of_a_scene_are_named(change, sentence):
    values = read_scene("objects")
    change(values)
    with pytest.raises(ConfigError) as error:
        scene_from(values)
    assert [fault for fault in error.value.faults if fault.startswith(sentence)], error.value.faults


def test_all_faults_are_reported_at_once():
    values = read_scene("cup")
    values["table"]["yaw"] = 500.0
    values["objects"]["cup"]["radius"] = -1.0
    with pytest.raises(ConfigError) as error:
        scene_from(values)
    assert len(error.value.faults) == 2


@pytest.mark.parametrize(
    "values",
    [
        None,
        3,
        [],
        {"size": [0.1, 0.1], "tags": []},
        {"size": [0.1], "tags": [{"id": 9}]},
        {"size": [0.1, 0.1], "tags": [None]},
    ],
)
def test_what_is_no_panel_is_refused(values):
    with pytest.raises(ConfigError):
        board_from(values)


def test_an_unknown_scene_is_refused_with_those_that_there_are(tmp_path):
    with pytest.raises(ConfigError):
        read_scene("kitchen")
    broken = tmp_path / "broken.yaml"
    broken.write_text("table: [", encoding="utf-8")
    with pytest.raises(ConfigError):
        read_scene(str(broken))


def test_another_process_builds_the_very_same_model_from_what_the_control_port_tells():
    fields = json.loads(json.dumps(dataclasses.asdict(description(panel="single"))))
    assert mjcf(WorldDescription(**fields)) == mjcf(description(panel="single"))


def test_what_is_only_seen_changes_neither_joints_nor_bodies():
    seen, bare = build_model(description(panel="single")), build_model(description(panel="single"), visuals=False)
    assert seen.ngeom > bare.ngeom
    assert [seen.joint(i).name for i in range(seen.njnt)] == [bare.joint(i).name for i in range(bare.njnt)]
    np.testing.assert_array_equal(seen.body_mass, bare.body_mass)
    np.testing.assert_array_equal(seen.jnt_qposadr, bare.jnt_qposadr)
