"""The rig's hand lifts what it can reach, and the program that tries a file of grasps with it."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common import lift_trial
from common.poses import pose
from common.rotations import rotation_about
from grasping.lab.evaluation import lift_file
from grasping.lab.programs import make_attempts
from grasping.lab.programs.make_attempts import AttemptTask
from grasping.lab.synthetic import reflex_labels, samples
from grasping.lab.synthetic.pose_labels import REASONS
from grasping.lab.synthetic.scene import SceneCamera, height_map
from grasping.network import maps
from grasping.poses.gripper import GRIPPERS
from rig_simulation.world import lifting
from rig_simulation.world.lifting import GROUND_M, LOWEST, P_HAND_GRIP, TIPS_M, hand_pose, lift, main, reliability

SCENE = """<mujoco><compiler angle="radian"/><option timestep="0.004" integrator="implicitfast" cone="elliptic"/>
<default><geom condim="6" friction="0.5 0.005 0.002" solref="0.006 1"/></default>
<worldbody><geom name="table" type="plane" size="2 2 0.1"/><body name="object0"><freejoint/>
<geom type="box" size="0.02 0.04 0.03" density="350"/></body></worldbody></mujoco>"""
DOWN = np.diag([1.0, -1.0, -1.0])
PEAK = {"row": 1, "column": 2, "quality": 0.5, "angle": 0.1, "width": 40.0}


def grasp(x=0.0, y=0.0, angle=0.0):
    """A grasp at the top of the box, its fingers turned about the vertical."""
    return pose(rotation_about(2, angle) @ DOWN, (x, y, 0.06))


TRIED = {"method": "good", "T_world_grasp": grasp().tolist(), "width": 0.05, "target": 0, "peak": PEAK}


def lying(angle=0.0):
    return np.array([0.0, 0.0, 0.03, np.cos(0.5 * angle), 0.0, 0.0, np.sin(0.5 * angle)])


@pytest.mark.parametrize("angle", [0.0, 1.0, np.pi])
def test_lifts_a_box_across_however_both_are_turned(angle):
    found = lift(SCENE, lying(angle), grasp(angle=angle))
    assert found.reached and found.lifted and found.reason == lift_trial.LIFTED
    assert found.rise > 0.09


def test_a_grasp_beside_the_box_lifts_nothing():
    found = lift(SCENE, lying(), grasp(y=0.2))
    assert found.reached and not found.lifted and found.reason == lift_trial.MISSED
    assert abs(found.rise) < 0.01


def test_a_hand_that_meets_a_thing_on_its_way_stops():
    found = lift(SCENE.replace("0.02 0.04 0.03", "0.1 0.1 0.1"), np.array([0, 0, 0.1, 1, 0, 0, 0.0]), grasp())
    assert not found.reached and not found.lifted and found.reason == lift_trial.COLLISION


def test_another_object_that_rises_is_a_failure_and_a_smooth_one_slips():
    other = '<body name="object1" pos="0 0.4 0.03"><freejoint/><geom type="box" size="0.02 0.02 0.03"/></body>'
    two = SCENE.replace("</worldbody>", other + "</worldbody>")
    qpos = np.concatenate([lying(), [0.0, 0.4, 0.03, 1.0, 0.0, 0.0, 0.0]])
    assert lift(two, qpos, grasp(), 0).lifted
    assert lift(two, qpos, grasp(), 1).reason == lift_trial.OTHER_OBJECT
    heavy = SCENE.replace('density="350"', 'density="20000"')
    assert lift(heavy, lying(), grasp(), 0).reason == lift_trial.SLIPPED


def test_a_light_box_survives_the_shake():
    assert lift(SCENE, lying(), grasp(), 0, shake=True).lifted


ROD = SCENE.replace('type="box" size="0.02 0.04 0.03"', 'type="capsule" size="0.0095 0.06" euler="1.5708 0 0"')


def test_of_a_thin_rod_the_hand_lifts_what_the_height_of_its_tips_allows():
    """Pads that press too far above its axis slide over it."""
    T, qpos = grasp(), np.array([0.0, 0.0, 0.0095, 1.0, 0.0, 0.0, 0.0])
    T[2, 3] = 0.019
    assert lift(ROD, qpos, T).reason == lift_trial.MISSED
    assert lift(ROD, qpos, T, ground=0.0).lifted


@given(st.floats(-3.1, 3.1), st.floats(0.0, 0.2), st.floats(-0.15, 0.15), st.floats(0.0, 0.05))
def test_the_hand_points_down_with_the_grasp_between_its_fingers(angle, height, lean, ground):
    T = pose(rotation_about(2, angle) @ DOWN @ rotation_about(0, lean), (0.1, -0.2, height))
    T_world_hand = hand_pose(T, ground)
    np.testing.assert_allclose(T_world_hand[:3, 2], [0.0, 0.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(T_world_hand[:3, 0], T[:3, 0] * (1.0, 1.0, 0.0), atol=1e-12)
    grip = T_world_hand[:3, :3] @ P_HAND_GRIP + T_world_hand[:3, 3]
    np.testing.assert_allclose(grip[:2], T[:2, 3], atol=1e-12)
    assert grip[2] == pytest.approx(max(height, TIPS_M + ground - P_HAND_GRIP[2]))


def tilted(pitch=0.0, roll=0.0, **place):
    """A grasp as `grasp`, then turned about the line through the fingers and about the line across it."""
    T = grasp(**place)
    T[:3, :3] = T[:3, :3] @ rotation_about(1, roll) @ rotation_about(0, pitch)
    return T


def test_an_own_approach_straight_down_is_the_approach_from_above():
    leaning = tilted(pitch=0.15)
    above = lift(SCENE, lying(), grasp(), 0, shake=True)
    assert above == lift(SCENE, lying(), leaning, 0, shake=True)
    assert above == lift(SCENE, lying(), grasp(), 0, shake=True, own_approach=True)
    assert above != lift(SCENE, lying(), leaning, 0, shake=True, own_approach=True)
    slides = [lifting.RISE in lifting.with_hand(SCENE, hand_pose(leaning, own_approach=own)) for own in (False, True)]
    assert slides == [False, True], "one slide as ever where the hand points down"


@given(st.floats(-3.1, 3.1), st.floats(0.0, 0.2), st.floats(-0.6, 0.6), st.floats(-0.5, 0.5), st.floats(0.0, 0.05))
def test_a_tilted_hand_comes_along_its_approach_as_far_as_the_table_lets_it(angle, height, pitch, roll, ground):
    T = tilted(pitch, roll, angle=angle)
    T[2, 3] = height
    T_world_hand = hand_pose(T, ground, own_approach=True)
    np.testing.assert_allclose(T_world_hand[:3, :3], T[:3, :3], atol=1e-12)
    back = T[:3, 3] - (T_world_hand[:3, :3] @ P_HAND_GRIP + T_world_hand[:3, 3])
    along = back @ T[:3, 2]
    np.testing.assert_allclose(back, along * T[:3, 2], atol=1e-12)
    lowest = (T_world_hand[:3, :3] @ LOWEST.T).min(axis=1)[2] + T_world_hand[2, 3]
    assert along >= -1e-12 and lowest >= ground - 1e-12
    assert along < 1e-9 or lowest == pytest.approx(ground), "no farther than it must"


@pytest.mark.parametrize(("pitch", "roll"), [(0.0, 0.0), (0.8, 0.0), (-0.8, 0.0), (0.0, 0.8), (0.0, -0.8), (0.5, -0.5)])
def test_a_closing_hand_just_above_the_table_does_not_touch_it(pitch, roll):
    """Its lowest corners are those of the model, whichever way it leans."""
    touched = []
    for ground in (0.002, -0.02):
        T = tilted(pitch, roll, x=0.3)
        T[2, 3] = 0.0
        model = mujoco.MjModel.from_xml_string(lifting.with_hand(SCENE, hand_pose(T, ground, own_approach=True)))
        hand = lifting.SlidingReflex(model, lying())
        touched.append(False)
        for i in range(2200):
            hand.step(min(1.0, i / 800), 0.0, i > 800, np.array([0.0, 0.0, -9.81]))
            pairs = model.geom_bodyid[hand._data.contact.geom]
            touched[-1] |= bool(((pairs == 0).any(axis=1) & ~(pairs == 1).any(axis=1)).any())
    assert touched == [False, True]


@pytest.mark.parametrize(("pitch", "roll"), [(0.7, 0.0), (0.0, 0.4), (-0.5, -0.3)])
def test_a_tilted_hand_lifts_the_box_straight_up(pitch, roll):
    T = tilted(pitch, roll)
    model = mujoco.MjModel.from_xml_string(lifting.with_hand(SCENE, hand_pose(T, own_approach=True)))
    start = model.body("carriage").pos.copy()
    hand = lifting.SlidingReflex(model, lying())
    record = lift_trial.lift(hand, lifting.PHASES_S, lifting.TIMESTEP_S, shake=False)
    assert record.reached and record.kept[0] > 0.06
    mujoco.mj_kinematics(model, hand._data)
    carriage = hand._data.body("carriage").xpos - start - lifting.START_M * T[:3, 2]
    np.testing.assert_allclose(carriage, (0.0, 0.0, 0.1), atol=0.004)
    assert lift(SCENE, lying(), T, 0, shake=True, own_approach=True).lifted


def test_beside_a_high_wall_only_a_hand_that_leans_away_from_it_lifts():
    wall = '<geom type="box" size="0.2 0.005 0.2" pos="0 0.046 0.2"/></worldbody>'
    walled = SCENE.replace("</worldbody>", wall)
    towards, away = ({**TRIED, "T_world_grasp": tilted(pitch=pitch).tolist()} for pitch in (-0.3, 0.3))
    tried = [away, {**towards, "own_approach": True}, {**away, "own_approach": True}]
    (scene,) = content(mjcf=walled, grasps=tried)["scenes"]
    found = lifting.try_scene(lifting.SceneTask(scene, {"shake": True, "ground": 0.0}))
    assert [row["reason"] for row in found] == [lift_trial.COLLISION, lift_trial.COLLISION, lift_trial.LIFTED]


def test_a_grasp_that_several_methods_chose_is_tried_once(monkeypatch):
    of_another, elsewhere = {**TRIED, "target": 1}, {**TRIED, "T_world_grasp": grasp(y=0.2).tolist()}
    grasps = [TRIED, {**TRIED, "method": "same"}, {**TRIED, "own_approach": True}, {**TRIED, "T_world_grasp": None}]
    (scene,) = content(grasps=[*grasps, of_another, elsewhere])["scenes"]
    tried = []

    def lifted(_scene, _qpos, T, target, own_approach, **_conditions):
        tried.append((T[1, 3], target, own_approach))
        return lift_trial.LiftResult(True, 0.1 * len(tried), True, lift_trial.LIFTED)

    monkeypatch.setattr(lifting, "lift", lifted)
    rows = lifting.try_scene(lifting.SceneTask(scene, {"shake": True, "ground": 0.0}))
    assert tried == [(0.0, 0, False), (0.0, 0, True), (0.0, 1, False), (0.2, 0, False)]
    assert [row["rise"] for row in rows] == pytest.approx([0.1, 0.1, 0.2, 0.0, 0.3, 0.4])
    assert [row["method"] for row in rows] == [one["method"] for one in scene["grasps"]]


@pytest.mark.parametrize("T", [tilted(pitch=0.9), tilted(pitch=np.pi), tilted(roll=-1.0)])
def test_an_approach_from_the_side_or_from_below_is_refused(T):
    with pytest.raises(ValueError, match="50 are possible"):
        hand_pose(T, own_approach=True)


def test_fingers_on_a_vertical_line_are_refused():
    with pytest.raises(ValueError):
        hand_pose(pose(rotation_about(1, 0.5 * np.pi)))


def test_positions_of_another_scene_are_refused():
    with pytest.raises(ValueError):
        lift(SCENE, np.zeros(14), grasp())


def test_the_labels_know_the_hand_that_lifts():
    hand = reflex_labels.Hand()
    assert (hand.above, hand.ground) == (P_HAND_GRIP[2], pytest.approx(TIPS_M + GROUND_M))


@pytest.mark.parametrize(("size", "angle"), [("0.02 0.045 0.03", 0.0), ("0.06 0.08 0.03", np.pi / 2)])
def test_the_physics_agrees_with_the_labels(size, angle):
    """A bar across its narrow side, and a block on whose wide side all fingers come down."""
    scene, cell = SCENE.replace("0.02 0.04 0.03", size), samples.CELL_M
    R = rotation_about(2, angle) @ DOWN
    model = mujoco.MjModel.from_xml_string(scene)
    data = mujoco.MjData(model)
    data.qpos[:] = lying()
    surface = height_map(model, data, SceneCamera(np.array([0.0, 0.0, 0.7]), R, 570.0, 400), cell, 101)
    score, _ = reflex_labels.along_rows(surface, np.full_like(surface, 0.7), cell, reflex_labels.Hand())
    assert lift(scene, lying(), grasp(angle=angle)).lifted == (score[50, 50] > 0.3) == (angle == 0.0)


def content(**more):
    tried = [TRIED]
    tried.append({"method": "none", "T_world_grasp": None, "width": None, "target": None, "peak": None})
    scene = {"split": "test", "scene": 3, "objects": 1, "mjcf": SCENE, "qpos": lying().tolist(), "grasps": tried}
    return {"schema": 2, "scenes": [{**scene, **more}]}


def test_attempts_to_train_on_are_lifted_each_along_its_own_approach(tmp_path):
    weights = Path(__file__).parents[3] / "grasping" / "weights" / "ggcnn2_reflex.pt"
    hand = maps.REFLEX, GRIPPERS[maps.REFLEX], tmp_path / "results"
    task = AttemptTask(tmp_path / "shard.npz", "train", range(1, 2), weights, 8, None, *hand)
    file = tmp_path / "grasps.json"
    file.write_text(json.dumps({"schema": lift_file.SCHEMA, "scenes": [make_attempts.exported((task, 1))]}))
    (scene,) = lifting.read(file)
    assert len(scene["grasps"]) == 8 and all(one["own_approach"] for one in scene["grasps"])
    scene["grasps"][3]["T_world_grasp"][2][3] += 0.3
    rows = lifting.try_scene(lifting.SceneTask(scene, {"shake": True, "ground": 0.0}))
    task.results.write_text(json.dumps(rows))
    make_attempts.make_shard(task)
    with np.load(task.path) as arrays:
        assert [REASONS[reason] for reason in arrays["reason"]] == [row["reason"] for row in rows]
        assert (arrays["reason"] == 0).any() and REASONS[arrays["reason"][3]] == lift_trial.MISSED


@pytest.mark.real
def test_a_run_that_is_interrupted_leaves_the_trials_until_then(tmp_path, monkeypatch, capsys):
    class Interrupted:
        """A bar of progress at whose second scene Ctrl-C comes."""

        def __init__(self, scenes, **_options):
            self.scenes = scenes

        def __iter__(self):
            yield next(self.scenes)
            raise KeyboardInterrupt

    file, results = tmp_path / "grasps.json", tmp_path / "results.json"
    (scene,) = content()["scenes"]
    file.write_text(json.dumps({"schema": 2, "scenes": [scene, {**scene, "scene": 4}]}))
    monkeypatch.setattr(lifting, "tqdm", Interrupted)
    with pytest.raises(KeyboardInterrupt):
        main([str(file), "--results", str(results)])
    assert [row["scene"] for row in json.loads(results.read_text())] == [3, 3]
    assert str(results) in capsys.readouterr().err


@pytest.mark.real
@pytest.mark.parametrize(
    ("options", "reason", "ground"), [(["--tips", "0"], lift_trial.LIFTED, 0.0), ([], lift_trial.MISSED, GROUND_M)]
)
def test_the_program_tries_each_grasp_once_with_the_hand_as_low_as_asked(tmp_path, capsys, options, reason, ground):
    file, results, T = tmp_path / "grasps.json", tmp_path / "results.json", grasp()
    T[2, 3] = 0.019
    good, none = content()["scenes"][0]["grasps"]
    tried = [{**good, "T_world_grasp": T.tolist()}, none]
    file.write_text(json.dumps(content(mjcf=ROD, qpos=[0.0, 0.0, 0.0095, 1.0, 0.0, 0.0, 0.0], grasps=tried)))
    assert main([str(file), "--results", str(results), *options]) == 0
    text, (first, second) = capsys.readouterr().out, json.loads(results.read_text())
    assert f"| good | {'100 (21 to 100)' if ground == 0.0 else '0 (0 to 79)'}, n = 1 | - | - |" in text
    assert "| none | 0 (0 to 79), n = 1 | - | 0 (0 to 79), n = 1 | - |" in text
    assert (first["split"], first["reason"], second["reason"]) == ("test", reason, "no grasp")
    assert first["ground"] == pytest.approx(ground) and first["peak"]["column"] == 2
    with pytest.raises(SystemExit):
        main([str(file), "--results", str(results)])
    assert "results.json is there already: name another file." in capsys.readouterr().err


@pytest.mark.parametrize("tips", ["nan", "-1", "101"])
def test_tips_out_of_range_are_refused(tmp_path, capsys, tips):
    with pytest.raises(SystemExit):
        main([str(tmp_path / "grasps.json"), "--tips", tips])
    assert "must be between 0 and 100" in capsys.readouterr().err


def test_qualities_are_judged_by_what_was_lifted():
    judged = ((0.0, True), (0.4, True), (0.9, False))
    rows = [{"method": "a", "peak": {"quality": quality}, "lifted": up} for quality, up in judged]
    lines = reliability([*rows, {"method": "b", "peak": None, "lifted": False}]).splitlines()
    cells = [[cell.strip().split(" (")[0] for cell in line.split("|")[1:-1]] for line in lines]
    assert ["a", "100", "-", "100", "-", "0"] in cells
    assert ["a", "50", "50"] in cells and ["b"] not in [row[:1] for row in cells]
    assert reliability(rows[:0]) == ""


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (None, "No such file"),
        ("{", "not a file of grasps"),
        (json.dumps({"schema": 1, "scenes": []}), "has the schema 1"),
        (json.dumps(content(qpos=[float("nan")] * 7)), "not finite"),
        (json.dumps(content(mjcf="<mujoco>")), "XML"),
        (json.dumps(content(grasps=[{"method": "a", "T_world_grasp": [[1.0]]}])), "a pose needs 4 x 4"),
        (
            json.dumps(content(grasps=[{"T_world_grasp": tilted(pitch=1.5).tolist(), "own_approach": True}])),
            "by 86 deg",
        ),
        (json.dumps(content(qpos=[])), "no object of scene 3"),
    ],
)
def test_bad_files_are_refused(tmp_path, capsys, text, sentence):
    file = tmp_path / "grasps.json"
    if text is not None:
        file.write_text(text)
    with pytest.raises(SystemExit) as end:
        main([str(file)])
    assert end.value.code == 2
    assert sentence in capsys.readouterr().err
