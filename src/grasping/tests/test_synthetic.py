"""Synthetic scenes: exact depth, honest labels, a camera with the faults of a real one; the same for the same seed."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from height_maps import boxes_on_table

from common.errors import RigError
from grasping.lab.synthetic import labels, random_urdfs, samples, scene, shapes, surroundings
from grasping.poses.gripper import GRIPPER

CELL = samples.CELL_M
N = 120
TABLE = np.full((N, N), 0.7)


def heights(*boxes):
    return boxes_on_table(N, boxes)


def found(surface):
    return labels.grasps(surface, TABLE, CELL, GRIPPER)


def test_the_same_seed_is_the_same_sample():
    first, second = (samples.sample(samples.view("train", 5)) for _ in range(2))
    for a, b in zip(first, second):
        np.testing.assert_array_equal(a, b)
    assert first.depth.shape == (300, 300)
    assert not np.array_equal(first.depth, samples.sample(samples.view("train", 6)).depth)


def test_test_objects_are_not_trained_on():
    families = shapes.TRAINING + shapes.HELD_OUT + shapes.UNSEEN
    assert len({family.__name__ for family in families}) == len(set(families)) == len(families)
    trained = {family for name, split in samples.SPLITS.items() if "train" in name for family in split.families}
    assert trained == {*shapes.TRAINING, random_urdfs.seen_blob}
    assert samples.SPLITS["train"].families == samples.SPLITS["validation"].families == shapes.TRAINING
    assert samples.SPLITS["test"].families == shapes.HELD_OUT
    assert samples.SPLITS["unseen"].families == shapes.UNSEEN
    for kind in surroundings.KINDS:
        assert not trained & set(samples.SPLITS[kind].families)
        assert not {random_urdfs.seen_blob, random_urdfs.kept_blob} & set(samples.SPLITS[f"validation_{kind}"].families)
    assert len({split.number for split in samples.SPLITS.values()}) == len(samples.SPLITS)


@pytest.mark.parametrize("family", shapes.TRAINING + shapes.HELD_OUT + shapes.UNSEEN)
def test_every_family_compiles_and_fits_the_gripper(family):
    for seed in range(5):
        model = mujoco.MjModel.from_xml_string(scene.world_xml((family(np.random.default_rng(seed)),)))
        assert 0.002 < model.body("object0").mass[0] < 1.5


def test_depth_is_what_single_rays_meet():
    """The many-ray routine loses objects near the poles of its sphere; the turned world must not."""
    seen = samples.view("train", 32, 1)
    model = mujoco.MjModel.from_xml_string(seen.scene.xml)
    data = mujoco.MjData(model)
    data.qpos[:] = seen.scene.state
    mujoco.mj_forward(model, data)
    directions = scene.rays(seen.camera) @ seen.camera.R.T
    geom = np.zeros(1, dtype=np.int32)
    for i in np.random.default_rng(0).integers(0, len(directions), 1500):
        length = np.linalg.norm(directions[i])
        along = mujoco.mj_ray(model, data, seen.camera.position, directions[i] / length, None, 1, -1, geom)
        assert seen.exact.flat[i] == pytest.approx(along / length, abs=1e-7)


def test_height_map_of_the_bare_table_is_the_table():
    seen = samples.view("train", 3, 1)
    corner = (slice(0, 20), slice(0, 20))
    np.testing.assert_allclose(seen.surface[corner], seen.table[corner], atol=1e-3)


def test_bare_table_has_no_grasp():
    assert found(TABLE.copy()).scores.max() == 0.0


def test_a_bar_is_grasped_across():
    best = labels.best(found(heights((0.0, 0.0, 0.06, 0.015, 0.04))))
    middle = N // 2, N // 2
    assert best.quality[middle] > 0.6
    assert abs(abs(best.angle[middle]) - 0.5 * np.pi) < 0.1
    assert best.opening[middle] == pytest.approx(0.03 + 2.0 * GRIPPER.clearance, abs=2.0 * CELL)


def test_angles_follow_the_image():
    """A bar from lower left to upper right, at +45 degrees, is grasped at -45 degrees."""
    c = CELL * (np.arange(N) - 0.5 * (N - 1))
    x, y = np.meshgrid(c, c)
    surface = TABLE.copy()
    surface[(np.abs(x + y) < 0.02) & (np.abs(x - y) < 0.08)] = 0.66
    best = labels.best(found(surface))
    assert best.quality[N // 2, N // 2] > 0.5
    assert best.angle[N // 2, N // 2] == pytest.approx(-0.25 * np.pi, abs=0.1)


def test_what_is_too_wide_is_not_grasped():
    assert found(heights((0.0, 0.0, 0.055, 0.055, 0.04))).scores.max() == 0.0


def test_fingers_need_room():
    alone = found(heights((0.0, 0.0, 0.05, 0.015, 0.04)))
    beside = found(heights((0.0, 0.0, 0.05, 0.015, 0.04), (0.0, 0.023, 0.06, 0.003, 0.04)))
    middle = (slice(None), slice(N // 2 - 4, N // 2 + 4), slice(N // 2 - 4, N // 2 + 4))
    assert alone.scores[middle].max() > 0.6
    assert beside.scores[middle].max() == 0.0


def test_slanted_faces_are_outside_the_friction_cone():
    """The only faces a gripper can span are those of a wedge of 2 x 40 degrees."""
    c = CELL * (np.arange(N) - 0.5 * (N - 1))
    x, y = np.meshgrid(c, c)
    surface = TABLE.copy()
    surface[(np.abs(x) < 0.84 * (y + 0.04)) & (y < 0.04)] = 0.66
    across = found(surface).scores[0]
    assert across.max() < 0.1


@pytest.mark.parametrize(("radius", "held"), [(0.03, True), (0.043, False)])
def test_a_lying_can_is_not_held_above_its_equator(radius, held):
    """The tips reach 25 mm below the top: past the middle of the thin one, not of the thick one."""
    c = CELL * (np.arange(N) - 0.5 * (N - 1))
    x, y = np.meshgrid(c, c)
    top = radius + np.sqrt(np.maximum(radius**2 - y**2, 0.0))
    surface = np.where((np.abs(y) < radius) & (np.abs(x) < 0.06), TABLE - top, TABLE)
    assert (found(surface).scores[:, N // 2, N // 2].max() > 0.2) == held


def test_disc_prefers_the_horizontal():
    c = CELL * (np.arange(N) - 0.5 * (N - 1))
    x, y = np.meshgrid(c, c)
    best = labels.best(found(np.where(np.hypot(x, y) < 0.02, 0.66, TABLE)))
    assert abs(best.angle[N // 2, N // 2]) < 0.2


def test_labels_in_the_image_sit_on_the_object():
    surface = heights((0.03, -0.02, 0.05, 0.015, 0.04))
    exact = np.full((300, 300), 0.7)
    focal = 427.7
    rows, columns = (150 + np.array([-0.035, -0.005]) / 0.66 * focal, 150 + np.array([-0.02, 0.08]) / 0.66 * focal)
    exact[int(rows[0]) : int(rows[1]), int(columns[0]) : int(columns[1])] = 0.66
    label = labels.in_image(labels.best(found(surface)), surface, CELL, exact, focal)
    row, column = np.unravel_index(np.argmax(label.quality), label.quality.shape)
    assert rows[0] < row < rows[1]
    assert columns[0] < column < columns[1]
    assert label.opening[row, column] == pytest.approx(0.04 / 0.66 * focal, rel=0.15)
    assert label.known[0, 0]


def test_shadow_falls_right_of_a_step():
    depth = np.full((4, 200), 0.8)
    depth[:, 50:100] = 0.6
    dark = samples.shadow(depth)
    width = samples.BASELINE_M * samples.FOCAL_PX * (1.0 / 0.6 - 1.0 / 0.8)
    assert not dark[:, :100].any()
    assert dark[0].sum() == pytest.approx(width, abs=1.0)
    assert dark[0, 100:117].all()


def test_sensor_noise_is_that_of_the_model():
    """At 0.7 m: axial error after Nguyen 1.4 mm, beside the error of the scale and the warp, which are smooth."""
    rng = np.random.default_rng(4)
    flat = np.full((400, 400), 0.7)
    errors = np.stack([samples.observe(flat, rng) for _ in range(6)]) - 0.7
    assert np.isnan(errors).mean() < 0.05
    fine = [np.nanstd(e[:, 8:] - e[:, :-8]) / np.sqrt(2.0) for e in errors]
    assert np.mean(fine) == pytest.approx(0.0014, rel=0.25)
    assert np.nanstd(np.nanmean(errors, axis=(1, 2))) < 3.0 * 0.7 * samples.SCALE_ERROR


def test_sensor_sees_nothing_too_near_and_rounds():
    depth = np.full((100, 100), 0.8)
    depth[:50] = samples.NEAREST_M - 0.02
    seen = samples.observe(depth, np.random.default_rng(1))
    assert np.isnan(seen[:50]).all()
    values = seen[60:][np.isfinite(seen[60:])]
    np.testing.assert_allclose(values * 1000.0, np.round(values * 1000.0), atol=1e-3)


@pytest.mark.parametrize("kind", surroundings.KINDS)
def test_objects_lie_where_their_surroundings_say(kind):
    """The scene that a camera sees is the one that the gripper meets, and nothing moves in it."""
    seen = samples.view(kind, 3)
    assert bool(seen.scene.fixed) is (kind != surroundings.STACK)
    model = mujoco.MjModel.from_xml_string(scene.world_xml(seen.scene.objects, 0.35, fixed=seen.scene.fixed))
    assert model.ngeom == mujoco.MjModel.from_xml_string(seen.scene.xml).ngeom
    data = mujoco.MjData(model)
    data.qpos[:] = seen.scene.state
    mujoco.mj_step(model, data, nstep=250)
    moved = (data.qpos - seen.scene.state).reshape(-1, 7)[:, :3]
    assert np.linalg.norm(moved, axis=1).max() < 0.004, "a second later"


def test_a_blob_is_read_about_its_middle(tmp_path, monkeypatch):
    (tmp_path / "007").mkdir()
    text = (
        "o convex_0\nv 0 0 0\nv 4 0 0\nv 0 4 0\nv 0 0 4\no convex_1\nv 0 0 0\nv -4 0 0\nv 0 -4 0\nv 0 0 -4\nf 1 2 3\n"
    )
    (tmp_path / "007" / "007.obj").write_text(text)
    monkeypatch.setattr(random_urdfs, "folder", lambda: tmp_path)
    random_urdfs.blob.cache_clear()
    shape = random_urdfs.blob(7)
    assert [len(part.vertices) for part in shape] == [4, 4]
    assert shape[0].vertices[1] == pytest.approx((0.06, 0.0, 0.0))
    model = mujoco.MjModel.from_xml_string(scene.world_xml((shape,)))
    assert model.body("object0").mass[0] == pytest.approx(2.0 * scene.DENSITY * 0.06**3 / 6.0, rel=1e-3)
    with pytest.raises(RigError, match="008.obj cannot be read"):
        random_urdfs.blob(8)
    random_urdfs.blob.cache_clear()


def test_without_the_package_of_the_blobs_a_sentence_says_which_command_installs_it(monkeypatch):
    monkeypatch.setattr(random_urdfs.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(RigError, match="come with the package pybullet, which is not installed: make objects"):
        random_urdfs.folder()


def test_blobs_that_are_kept_are_not_trained_on(monkeypatch):
    drawn = {}
    monkeypatch.setattr(random_urdfs, "is_used", lambda _: True)
    monkeypatch.setattr(random_urdfs, "blob", lambda number: number)
    for draw in (random_urdfs.seen_blob, random_urdfs.other_blob, random_urdfs.kept_blob):
        rng = np.random.default_rng(0)
        drawn[draw.__name__] = {draw(rng) for _ in range(2000)}
    assert max(drawn["seen_blob"]) < 600 <= min(drawn["other_blob"])
    assert max(drawn["other_blob"]) < 700 <= min(drawn["kept_blob"])


def test_surroundings_say_how_many_objects_lie_in_them():
    first, second = samples.view("on_slope", 0), samples.view("on_slope", 0, 4)
    np.testing.assert_array_equal(first.exact, second.exact)
