"""The programs about the refinement, from simulated episodes to table, on a handful of them."""

from __future__ import annotations

import csv
import functools
import hashlib
import itertools
import json
import pickle
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from test_programs import call

from common.errors import RigError
from grasping.lab.dataset import store
from grasping.lab.dataset.labels import relative_label
from grasping.lab.evaluation import person_study, trials
from grasping.lab.evaluation.person_study import BOTH, NETWORK, PERSON
from grasping.lab.programs import evaluate, evaluate_refinement, make_dataset, make_episodes, train_refinement
from grasping.lab.programs.make_episodes import EpisodeTask
from grasping.lab.synthetic import simulated_operator
from grasping.lab.synthetic.simulated_operator import OPERATORS
from grasping.network.maps import PARALLEL
from grasping.poses import taste_file
from grasping.poses.candidates import TASTES
from grasping.poses.lift_network import LiftNetwork, saved
from grasping.poses.taste_file import Origin, TasteFile, content

WEIGHTS = Path(__file__).parents[1] / "weights" / "ggcnn2_wide.pt"
GGCNN = hashlib.sha256(WEIGHTS.read_bytes()).hexdigest()
NUMBERS = (0, 1, 2, 3, 4)
WHO = ("high", "middle")


@pytest.fixture(scope="module", autouse=True)
def each_scene_once():
    """A scene and its grasps, which the programs make anew wherever they need them, are made once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulated_operator, "situation", functools.lru_cache(maxsize=None)(simulated_operator.situation))
        yield


@pytest.fixture(scope="module", name="every")
def every_fixture(tmp_path_factory):
    folder = tmp_path_factory.mktemp("episodes")
    for number in NUMBERS:
        make_episodes.make(EpisodeTask(folder, WEIGHTS, "kind_hammer", number, 1, WHO))
    return folder


@pytest.fixture(scope="module", name="data")
def data_fixture(every):
    return every / "high"


class InProcess:
    """A pool whose calls stay in this process, which has imported torch already, and pass as in another one's pipe."""

    def __init__(self, _processes):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def imap_unordered(self, function, tasks):
        for task in tasks:
            called, received = pickle.loads(pickle.dumps((function, task)))
            yield called(received)


def test_episodes_are_made_once_and_read_as_recorded_ones(every, data, monkeypatch):
    pools = SimpleNamespace(get_context=lambda _method: SimpleNamespace(Pool=InProcess))
    monkeypatch.setattr(make_dataset, "multiprocessing", pools)
    assert {p.name for p in every.iterdir()} == set(WHO)
    paths = sorted(data.iterdir())
    assert [p.stem for p in paths] == [simulated_operator.file_name("kind_hammer", n) for n in NUMBERS]
    assert [simulated_operator.scene_of(p.stem) for p in paths] == [("kind_hammer", n) for n in NUMBERS]
    episode = store.decode(paths[1].read_bytes())
    frame = episode.frame(0)
    assert (episode.metadata.operator, episode.metadata.object) == ("simulated high", "hammer")
    assert frame.maps.shape == (4, 150, 150)
    assert relative_label(frame) is not None
    # The hand comes from above, leaning by no more than half a radian or so.
    assert frame.T_base_grasp[2, 2] < -0.8
    assert 0.02 < frame.opening <= 0.1
    paths[0].unlink()
    kept = paths[1].stat().st_mtime_ns
    options = ["--split", "kind_hammer", "--episodes", len(NUMBERS)]
    call(monkeypatch, make_episodes, every, WEIGHTS, *options)
    assert paths[0].exists()
    assert paths[1].stat().st_mtime_ns == kept


def test_all_operators_see_the_same_and_choose_for_themselves(every):
    name = simulated_operator.file_name("kind_hammer", 1) + store.SUFFIX
    one, other = (store.decode((every / who / name).read_bytes()) for who in ("high", "middle"))
    np.testing.assert_array_equal(one.depth, other.depth)
    assert np.linalg.norm(one.T_base_grasp[:3, 3] - other.T_base_grasp[:3, 3]) > 0.005


@pytest.mark.parametrize("views", [("camera", "table"), ("above",)])
def test_episodes_of_several_views_or_of_an_unknown_one_teach_nothing(
    data, lifts, tmp_path, monkeypatch, capsys, views
):
    for i, view in enumerate(views):
        episode = store.decode((data / f"{simulated_operator.file_name('kind_hammer', i)}.npz").read_bytes())
        metadata = replace(episode.metadata, configuration={"view": view})
        (tmp_path / f"{i}.npz").write_bytes(store.encode(replace(episode, metadata=metadata)))
    with pytest.raises(SystemExit):
        call(monkeypatch, train_refinement, tmp_path, tmp_path / "run", "--lifts", lifts)
    assert f"of the views {', '.join(views)}, whose grasps have other axes" in capsys.readouterr().err


def test_what_an_operator_meant_is_without_miss_and_tremor(data):
    """What was meant lies on the surface that the camera sees; the recorded grasp is beside it."""
    for path in sorted(data.iterdir()):
        episode = store.decode(path.read_bytes())
        frame = episode.frame(0)
        of = simulated_operator.situation(*simulated_operator.scene_of(path.stem))
        meant = simulated_operator.meant(of, episode)
        p = (np.linalg.inv(frame.T_base_camera) @ meant)[:3, 3]
        column, row = (round(float(i)) for i in frame.camera.project(p))
        assert frame.depth_m[row, column] == pytest.approx(p[2], abs=0.012)
        off = episode.T_base_grasp[:3, 3] - meant[:3, 3] - OPERATORS["high"].bias
        assert 0.0 < np.linalg.norm(off) < 0.025


def test_a_hard_lift_is_with_the_arms_error_and_through_a_shake(monkeypatch):
    of, seen = simulated_operator.situation("kind_hammer", 1), []
    monkeypatch.setattr(
        simulated_operator, "lift", lambda *at, **how: seen.append((at, how)) or SimpleNamespace(lifted=True)
    )
    T = np.eye(4)
    simulated_operator.held(of, T), simulated_operator.held(of, T, hard=True)
    (easy, how_easy), (hard, how_hard) = seen
    assert (how_easy["shake"], how_hard["shake"]) == (False, True)
    error = np.linalg.inv(easy[1]) @ hard[1]
    np.testing.assert_allclose(error, trials.drawn(1, trials.USUAL)[1], atol=1e-12)
    assert np.linalg.norm(error[:3, 3]) > 1e-4


def test_training_learns_and_says_what(data, lifts, tmp_path, monkeypatch, capsys):
    run = tmp_path / "run"
    call(monkeypatch, train_refinement, data, run, "--lifts", lifts)
    said = json.loads(capsys.readouterr().out)
    assert said == json.loads((run / "settings.json").read_text())
    assert list(said["kinds"]) == ["hammer"]
    kinds, origin = taste_file.load((run / "weights.pt").read_bytes())
    known, of = kinds["hammer"], said["kinds"]["hammer"]
    assert of["episodes"] == len(NUMBERS) and list(of["liked"]) == [*TASTES, "lift"]
    assert of["liked"]["height"] == pytest.approx(known.weights[TASTES.index("height")], abs=0.006)
    assert (of["spread_mm"], of["spread_opening_mm"]) == pytest.approx(1000.0 * known.spreads[[0, 3]], abs=0.06)
    assert known.weights.any()
    sha256 = hashlib.sha256(lifts.read_bytes()).hexdigest()
    assert origin == Origin(view="camera", crop={"side": 400, "rows_up": 0}, network=GGCNN, lifts=sha256)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"none", "holds no weights of the network of lifts"),
        (saved(LiftNetwork(PARALLEL, "ab" * 32)), "was made for the GG-CNN abababababab, but the episodes are of "),
        (None, "No such file"),
    ],
    ids=["another file", "another GG-CNN", "no file"],
)
def test_a_network_of_lifts_that_does_not_fit_the_episodes_is_refused(
    data, tmp_path, monkeypatch, capsys, content, sentence
):
    file = tmp_path / "lifts.pt"
    if isinstance(content, bytes):
        file.write_bytes(content)
    elif content is not None:
        torch.save(content, file)
    with pytest.raises(SystemExit):
        call(monkeypatch, train_refinement, data, tmp_path / "run", "--lifts", file)
    assert sentence in capsys.readouterr().err and not (tmp_path / "run").exists()


def of_other_objects(data, folder, *objects):
    """Copies the episodes into a folder, as if these had been grasped, in turns."""
    folder.mkdir()
    for path, thing in zip(sorted(data.iterdir()), itertools.cycle(objects)):
        episode = store.decode(path.read_bytes())
        metadata = replace(episode.metadata, object=thing)
        (folder / path.name).write_bytes(store.encode(replace(episode, metadata=metadata)))


def learned(monkeypatch, data, run, lifts, *options):
    """Returns the arrays that train_refinement.py writes for each kind."""
    call(monkeypatch, train_refinement, data, run, "--lifts", lifts, *options)
    kinds, _ = taste_file.load((run / "weights.pt").read_bytes())
    return {
        name: {k: np.array(v) for k, v in content(TasteFile({name: of}, Origin())).items()}
        for name, of in kinds.items()
    }


def test_each_kind_learns_from_its_own_episodes_as_if_it_were_alone(data, lifts, tmp_path, monkeypatch, capsys):
    both = tmp_path / "both"
    of_other_objects(data, both, "cup", "bottle, cup")
    found = learned(monkeypatch, both, tmp_path / "run", lifts)
    assert list(found) == ["bottle", "cup"]
    said = json.loads(capsys.readouterr().out)["kinds"]
    assert {name: kind["episodes"] for name, kind in said.items()} == {"bottle": 2, "cup": 5}
    for name, of in found.items():
        alone = learned(monkeypatch, both, tmp_path / name, lifts, "--only", name)
        assert list(alone) == [name]
        for key, value in of.items():
            np.testing.assert_array_equal(alone[name][key], value)
    chosen = learned(monkeypatch, both, tmp_path / "run", lifts, "--only", "cup", "--only", "bottle")
    assert list(chosen) == list(found)
    assert (found["bottle"]["0/weights"] != found["cup"]["0/weights"]).any()
    pooled = learned(monkeypatch, both, tmp_path / "run", lifts, "--pooled")
    assert list(pooled) == [taste_file.ANY_KIND]
    np.testing.assert_array_equal(pooled[taste_file.ANY_KIND]["0/weights"], found["cup"]["0/weights"])


def test_a_kind_without_episodes_is_refused(data, lifts, tmp_path, monkeypatch, capsys):
    with pytest.raises(SystemExit):
        call(
            monkeypatch, train_refinement, data, tmp_path / "run", "--lifts", lifts, "--only", "hammer", "--only", "mug"
        )
    assert "holds no episode of mug: collect some" in capsys.readouterr().err


@pytest.fixture(scope="module", name="lifts")
def lifts_fixture(tmp_path_factory):
    file = tmp_path_factory.mktemp("lifts") / "lifts.pt"
    torch.manual_seed(0)
    torch.save(saved(LiftNetwork(PARALLEL, GGCNN)), file)
    return file


def test_predictors_are_compared_and_the_study_reads_it(every, lifts, tmp_path, monkeypatch):
    both, results = tmp_path / "both", tmp_path / "results"
    for who in ("high", "middle"):
        shutil.copytree(every / who, both / who)
    call(monkeypatch, evaluate_refinement, both, results, lifts, "--few", 0, 3)
    rows = list(csv.DictReader((results / "results.csv").read_text().splitlines()))
    tested = [f"{who}/{simulated_operator.file_name('kind_hammer', n)}" for who in ("high", "middle") for n in (3, 4)]
    alone = [(name, "0") for name in (NETWORK, PERSON, evaluate_refinement.LIFTS, evaluate_refinement.AGAIN)]
    methods = [*alone, (BOTH, "0"), (BOTH, "3")]
    assert sorted((r["episode"], r["method"], r["shown"]) for r in rows) == sorted(
        (e, *m) for e in tested for m in methods
    )
    assert {r["lifted"] for r in rows} <= {"True", "False"}
    of = {m: {r["episode"]: r for r in rows if (r["method"], r["shown"]) == m} for m in methods}
    for name in tested:
        safest = of[evaluate_refinement.LIFTS, "0"][name]
        # Before anything is shown, the safest grasp is taken.
        assert of[BOTH, "0"][name]["meant_mm"] == safest["meant_mm"]
        assert of[BOTH, "0"][name]["lifted"] == safest["lifted"]
        assert float(of[PERSON, "0"][name]["position_mm"]) == 0.0 < float(of[PERSON, "0"][name]["meant_mm"])
    assert any(float(of[evaluate_refinement.AGAIN, "0"][name]["meant_mm"]) > 0.0 for name in tested), "a whim"
    table = (results / "table.md").read_text()
    assert "n = 4 episodes in 2 scenes" in table
    assert "| taste, 3 shown - GG-CNN alone |" in table
    assert len(person_study.kept(person_study.read(results / "results.csv"), 3)) == 12


def test_intervals_are_over_scenes():
    """Ten operators in one scene are no ten scenes."""
    scenes = np.repeat(np.arange(20), 10)
    values = np.repeat(np.random.default_rng(1).normal(0.0, 1.0, 20), 10)
    wide = evaluate_refinement.interval(values, None, np.mean, evaluate_refinement.drawn(scenes), "")
    narrow = evaluate_refinement.interval(values, None, np.mean, evaluate_refinement.drawn(np.arange(200)), "")
    (a, b), (c, d) = ([float(x) for x in text[text.index("(") + 1 : -1].split(" to ")] for text in (wide, narrow))
    assert b - a > 2.0 * (d - c)


def of_another_rig(data, folder, **changes):
    """Copies the episodes into a folder, the last one with changes to its rig's configuration."""
    paths = sorted(data.iterdir())
    for path in paths:
        content = path.read_bytes()
        if path == paths[-1]:
            episode = store.decode(content)
            metadata = replace(episode.metadata, configuration={**episode.metadata.configuration, **changes})
            content = store.encode(replace(episode, metadata=metadata))
        (folder / path.name).write_bytes(content)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("network", {"weights": "ab" * 32}),
        ("robot", {"kuka": {"robot": "LBR14R820"}}),
    ],
)
def test_episodes_of_several_rigs_are_refused_unless_asked_for(
    data, lifts, tmp_path, monkeypatch, capsys, name, changes
):
    of_another_rig(data, tmp_path, **changes)
    with pytest.raises(SystemExit):
        call(monkeypatch, train_refinement, tmp_path, tmp_path / "run", "--lifts", lifts)
    assert f"_000004 differ in {name}: train on those of one, or with --mixed." in capsys.readouterr().err
    mixed = train_refinement.origin_of(train_refinement.read_episodes(tmp_path), mixed=True)
    assert mixed == replace(train_refinement.origin_of(train_refinement.read_episodes(data)), **{name: None})


def test_things_are_left_out_and_chosen(data):
    assert len(train_refinement.read_episodes(data, only=["hammer"])) == len(NUMBERS)
    for choice in ({"only": ["mug"]}, {"without": ["hammer"]}):
        with pytest.raises(RigError, match="holds no episode of these things"):
            train_refinement.read_episodes(data, **choice)


def test_a_damaged_episode_is_named(tmp_path, data, lifts, monkeypatch, capsys):
    whole = next(iter(sorted(data.iterdir()))).read_bytes()
    (tmp_path / "torn.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(SystemExit):
        call(monkeypatch, train_refinement, tmp_path, tmp_path / "run", "--lifts", lifts)
    assert "torn.npz: The file is torn or damaged" in capsys.readouterr().err


def test_nothing_to_test_on_is_refused(data, lifts, monkeypatch, capsys, tmp_path):
    with pytest.raises(SystemExit):
        call(monkeypatch, evaluate_refinement, data, tmp_path / "results", lifts, "--few", len(NUMBERS))
    assert f"has more than {len(NUMBERS)} episodes of a kind to test on" in capsys.readouterr().err
    assert not (tmp_path / "results").exists()


@pytest.mark.real
def test_scenes_and_grasps_are_exported(tmp_path, monkeypatch):
    file = tmp_path / "grasps.json"
    call(monkeypatch, evaluate, "--scenes", "2", "--export", file, "--weights", "GG-CNN2", WEIGHTS)
    found = json.loads(file.read_text())
    assert found["schema"] == 2
    assert [(s["scene"], s["objects"]) for s in found["scenes"]] == [(0, 1), (1, 3)]
    for scene in found["scenes"]:
        assert len(scene["qpos"]) == 7 * scene["objects"]
        assert scene["mjcf"].count("<freejoint/>") == scene["objects"]
        assert [g["method"] for g in scene["grasps"]] == ["oracle", "GG-CNN2"]
        T = np.array(scene["grasps"][0]["T_world_grasp"])
        assert T[2, 2] < -0.95
        assert 0.0 < T[2, 3] < 0.2
