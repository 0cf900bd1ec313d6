"""The programs about the refinement network, from simulated episodes to table, on a handful of them."""

from __future__ import annotations

import csv
import functools
import hashlib
import json
import pickle
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from grasping.lab.dataset import store
from grasping.lab.dataset.labels import relative_label
from grasping.lab.programs import (
    evaluate,
    evaluate_refinement,
    make_dataset,
    make_episodes,
    runs,
    train_refinement,
)
from grasping.lab.synthetic import simulated_operator
from grasping.network import refinement_file
from grasping.network.refinement import RefinementNetwork
from grasping.network.refinement_file import Origin

WEIGHTS = Path(__file__).parents[1] / "weights" / "ggcnn2.pt"
NUMBERS = (0, 1, 2, 3, 4)


def call(monkeypatch, program, *arguments):
    monkeypatch.setattr(sys, "argv", [program.__name__, *map(str, arguments)])
    program.main()


@pytest.fixture(scope="module", autouse=True)
def each_scene_once():
    """A scene and its grasps, which the programs make anew wherever they need them, are made once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulated_operator, "situation", functools.lru_cache(maxsize=None)(simulated_operator.situation))
        yield


@pytest.fixture(scope="module", name="data")
def data_fixture(tmp_path_factory):
    folder = tmp_path_factory.mktemp("episodes")
    for number in NUMBERS:
        make_episodes.make((folder, WEIGHTS, "person", number, 1))
    return folder


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


def test_episodes_are_made_once_and_read_as_recorded_ones(data, monkeypatch):
    pools = SimpleNamespace(get_context=lambda _method: SimpleNamespace(Pool=InProcess))
    monkeypatch.setattr(make_dataset, "multiprocessing", pools)
    paths = sorted(data.iterdir())
    assert [p.stem for p in paths] == [simulated_operator.file_name("person", n) for n in NUMBERS]
    assert [simulated_operator.scene_of(p.stem) for p in paths] == [("person", n) for n in NUMBERS]
    episode = store.decode(paths[1].read_bytes())
    frame = episode.frame(0)
    assert episode.metadata.operator == "simulated"
    assert frame.maps.shape == (4, 150, 150)
    assert relative_label(frame) is not None
    # The hand comes from above, leaning by no more than half a radian or so.
    assert frame.T_base_grasp[2, 2] < -0.8
    assert 0.02 < frame.opening <= 0.1
    paths[0].unlink()
    kept = paths[1].stat().st_mtime_ns
    call(monkeypatch, make_episodes, data, WEIGHTS, "--episodes", len(NUMBERS), "--frames", 1)
    assert paths[0].exists()
    assert paths[1].stat().st_mtime_ns == kept


@pytest.mark.parametrize("views", [("camera", "table"), ("above",)])
def test_episodes_of_several_views_or_of_an_unknown_one_teach_nothing(data, tmp_path, monkeypatch, capsys, views):
    for i, view in enumerate(views):
        episode = store.decode((data / f"{simulated_operator.file_name('person', i)}.npz").read_bytes())
        metadata = replace(episode.metadata, configuration={"view": view})
        (tmp_path / f"{i}.npz").write_bytes(store.encode(replace(episode, metadata=metadata)))
    with pytest.raises(SystemExit):
        call(monkeypatch, train_refinement, tmp_path, tmp_path / "run")
    assert f"of the views {', '.join(views)}, whose grasps have other axes" in capsys.readouterr().err


def test_the_simulated_grasp_is_where_the_person_wanted_it(data):
    """Without bias, tremor and lean the grasp lies on the surface that the camera sees, and comes straight down."""
    who = simulated_operator.SimulatedOperator(bias=(0.0, 0.0, 0.0), tremor_m=0.0, tremor_rad=0.0, lean=0.0, follow=0.0)
    network, sha256 = make_episodes.network(WEIGHTS)
    episode = simulated_operator.episode("person", NUMBERS[1], network, sha256, who, 1)
    frame = episode.frame(0)
    p = frame.T_camera_grasp[:3, 3]
    column, row = (round(float(i)) for i in frame.camera.project(p))
    assert frame.depth_m[row, column] == pytest.approx(p[2], abs=0.012)
    np.testing.assert_allclose(frame.T_base_grasp[:3, 2], [0.0, 0.0, -1.0], atol=1e-9)
    assert episode.metadata.fingerprint != store.decode(next(iter(data.iterdir())).read_bytes()).metadata.fingerprint


@pytest.fixture(name="holdout")
def holdout_fixture(monkeypatch):
    """Every other episode is held out, so that few are enough."""
    monkeypatch.setattr(train_refinement, "is_held_out", lambda name: int(name[-1]) % 2 == 1)


def test_training_ends_and_goes_on_and_its_weights_are_compared(data, holdout, tmp_path, monkeypatch):
    run = tmp_path / "run"
    options = ["--every", "1", "--count", "2", "--hidden", "2"]
    options = ["--steps", "3", *options]
    with monkeypatch.context() as interrupted:
        interrupted.setattr(runs, "plot", interrupt_at(2))
        with pytest.raises(KeyboardInterrupt):
            call(interrupted, train_refinement, data, run, *options)
    call(monkeypatch, train_refinement, data, run, *options)
    with (run / "curves.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["step"] for row in rows] == ["1", "2", "3"]
    assert all(np.isfinite(float(v)) for row in rows for v in row.values())
    assert (run / "curves.png").stat().st_size > 1000
    assert json.loads((run / "settings.json").read_text())["episodes"] == 3
    content = (run / "weights.pt").read_bytes()
    assert len(content) < 100_000
    network, origin = refinement_file.load(content)
    sha256 = hashlib.sha256(WEIGHTS.read_bytes()).hexdigest()
    assert origin == Origin(view="camera", crop={"side": 400, "rows_up": 0}, network=sha256)
    assert network.network.offset.any()
    taste, origin = refinement_file.load((run / "taste.pt").read_bytes())
    assert origin == Origin(network=sha256)
    assert not taste.network.offset.any()
    test, results = tmp_path / "test", tmp_path / "results"
    test.mkdir()
    for path in sorted(data.iterdir())[:2]:
        shutil.copy(path, test)
    untrained = tmp_path / "untrained.pt"
    torch.save(refinement_file.content(RefinementNetwork(), Origin()), untrained)
    call(monkeypatch, evaluate_refinement, data, test, results, "--refinement", "untrained", untrained)
    first = (results / "results.csv").read_text()
    more = ["--refinement", "untrained", untrained, "--refinement", "trained", run / "weights.pt"]
    call(monkeypatch, evaluate_refinement, data, test, results, *more)
    text = (results / "results.csv").read_text()
    assert text.startswith(first)
    rows = list(csv.DictReader(text.splitlines()))
    held = [n.name for n in train_refinement.read_episodes(test) if n.episode.held]
    bound = evaluate_refinement.BOUND
    names = {"GGCNN alone", "GGCNN + constant offset", "nearest neighbour", bound, "untrained", "trained"}
    assert sorted((r["episode"], r["method"]) for r in rows) == sorted((e, m) for e in held for m in names)
    of = {m: {r["episode"]: r for r in rows if r["method"] == m} for m in names}
    for name in held:
        # The tremor is 5 mm along each axis.
        assert 0.0 < float(of[bound][name]["position_mm"]) < 25.0
        assert of["untrained"][name]["position_mm"] == of["GGCNN alone"][name]["position_mm"]
        assert float(of["trained"][name]["nearest_of_3_mm"]) <= float(of["trained"][name]["position_mm"])
    text = (results / "table.md").read_text()
    assert "| trained |" in text
    # Untrained it is GGCNN alone, without difference.
    assert "| untrained less GGCNN alone | " + " | ".join(["+0.0 (+0.0 to +0.0)"] * 6) + " |" in text
    assert "| untrained | " in text.partition("log-likelihood")[2]
    assert "| +0.00 (+0.00 to +0.00) |" in text
    orientations = text.partition("rotation error at the operator's place")[2]
    assert all(f"| {name} | " in orientations for name in ("GGCNN alone", "GGCNN + constant offset", "trained"))
    assert "| trained less GGCNN + constant offset | " in orientations
    assert not (results / "curve.png").exists()
    with monkeypatch.context() as plain:
        plain.setattr(runs, "plot", no_plot)
        call(plain, train_refinement, data, tmp_path / "few", *options, "--episodes", "2")
    curve = ["--refinement", "few", tmp_path / "few" / "weights.pt", "--refinement", "all", run / "weights.pt"]
    call(monkeypatch, evaluate_refinement, data, test, tmp_path / "curve", "--no-lifting", *curve)
    assert (tmp_path / "curve" / "curve.png").stat().st_size > 1000
    call(monkeypatch, evaluate_refinement, data, test, tmp_path / "part", "--held-out", "--no-lifting")
    rows = list(csv.DictReader((tmp_path / "part" / "results.csv").read_text().splitlines()))
    assert {r["episode"] for r in rows} == {name for name in held if train_refinement.is_held_out(name)}
    assert {r["lifted"] for r in rows} == {""}


def no_plot(*_):
    """Takes the place of a plot that nobody looks at."""


def interrupt_at(count: int):
    """Returns what takes the place of a function and ends the program when it is called that often."""
    calls = []

    def call_it(*_):
        calls.append(1)
        if len(calls) == count:
            raise KeyboardInterrupt

    return call_it


def test_another_training_is_not_gone_on_with(data, holdout, tmp_path, monkeypatch, capsys):
    run = tmp_path / "run"
    monkeypatch.setattr(runs, "plot", no_plot)
    options = ["--steps", "1", "--every", "1", "--count", "2", "--hidden", "2"]
    call(monkeypatch, train_refinement, data, run, *options, "--episodes", "2")
    files = {p.name: p.read_bytes() for p in run.iterdir()}
    for change in (["--episodes", "3"], ["--episodes", "2", "--seed", "2"]):
        with pytest.raises(SystemExit):
            call(monkeypatch, train_refinement, data, run, *options, *change)
        assert "holds a training on other data or with other settings" in capsys.readouterr().err
        assert {p.name: p.read_bytes() for p in run.iterdir()} == files
    call(monkeypatch, train_refinement, data, run, *options, "--episodes", "3", "--anew")
    assert {p.name: p.read_bytes() for p in (run / "before_1").iterdir()} == files
    assert (run / "weights.pt").read_bytes() != files["weights.pt"]
    assert json.loads((run / "settings.json").read_text())["episodes"] == 3
    call(monkeypatch, train_refinement, data, run, *options, "--episodes", "2", "--anew")
    assert (run / "before_2" / "weights.pt").exists()
    assert (run / "weights.pt").read_bytes() == files["weights.pt"]


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
        ("crop", {"crop": {"side": 300, "rows_up": 0}}),
        ("network", {"weights": "ab" * 32}),
        ("hand", {"T_tool_grasp": np.eye(4).tolist()}),
        ("robot", {"kuka": {"robot": "LBR14R820"}}),
    ],
)
def test_episodes_of_several_rigs_are_refused_unless_asked_for(data, tmp_path, monkeypatch, capsys, name, changes):
    of_another_rig(data, tmp_path, **changes)
    with pytest.raises(SystemExit):
        call(monkeypatch, train_refinement, tmp_path, tmp_path / "run")
    assert f"_000004 differ in {name}: train on those of one, or with --mixed." in capsys.readouterr().err
    mixed = train_refinement.origin_of(train_refinement.read_episodes(tmp_path), mixed=True)
    assert mixed == replace(train_refinement.origin_of(train_refinement.read_episodes(data)), **{name: None})


def test_a_second_network_of_another_rig_is_not_compared(data, holdout, tmp_path, monkeypatch, capsys):
    file = tmp_path / "second.pt"
    torch.save(refinement_file.content(RefinementNetwork(), Origin(network="ab" * 32)), file)
    with pytest.raises(SystemExit):
        call(monkeypatch, evaluate_refinement, data, data, tmp_path / "results", "--refinement", "second", file)
    assert "second.pt learned with network: abababababab..., but network is " in capsys.readouterr().err


def test_training_is_over_when_nothing_gets_better():
    rows = [{"validation": v} for v in (3.0, 2.0, 2.5, 2.1)]
    assert not runs.is_over(rows, 3)
    assert runs.is_over(rows, 2)
    assert not runs.is_over([*rows, {"validation": 1.9}], 2)


def test_one_episode_in_five_is_held_out():
    held = [train_refinement.is_held_out(f"episode_{i}") for i in range(1000)]
    assert 150 < sum(held) < 250


def test_things_are_left_out_and_chosen(data):
    things = {n.name: n.episode.metadata.object for n in train_refinement.read_episodes(data)}
    one = next(iter(things.values())).split(", ")[0]
    only = {n.name for n in train_refinement.read_episodes(data, only=[one])}
    without = {n.name for n in train_refinement.read_episodes(data, without=[one])}
    assert only == {name for name, what in things.items() if one in what.split(", ")}
    assert without == things.keys() - only


@pytest.mark.parametrize(
    ("program", "arguments", "sentence"),
    [
        (train_refinement, ["nowhere", "run"], "holds no episode"),
        (train_refinement, [WEIGHTS.parent, "run", "--device", "gpu"], "invalid choice: 'gpu'"),
        (train_refinement, ["nowhere", "run", "--count", "0"], "--count is 0, but must be at least 1."),
        (evaluate_refinement, ["nowhere", "nowhere", "results"], "holds no episode"),
        (make_episodes, ["made", "nowhere.pt"], "No such file"),
        (make_episodes, ["made", WEIGHTS, "--frames", "0"], "--frames is 0, but must be at least 1."),
        (evaluate, ["folder", "--export", "file"], "Either a folder for the results is needed, or --export."),
        (evaluate, [], "Either a folder for the results is needed, or --export."),
    ],
)
def test_bad_calls_are_refused(tmp_path, monkeypatch, capsys, program, arguments, sentence):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        call(monkeypatch, program, *arguments)
    assert end.value.code == 2
    assert sentence in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_damaged_episode_is_named(tmp_path, data, monkeypatch, capsys):
    whole = next(iter(sorted(data.iterdir()))).read_bytes()
    (tmp_path / "torn.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(SystemExit):
        call(monkeypatch, train_refinement, tmp_path, tmp_path / "run")
    assert "torn.npz: The file is torn or damaged" in capsys.readouterr().err


def test_too_few_episodes_are_refused(data, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(train_refinement, "is_held_out", lambda name: False)
    with pytest.raises(SystemExit):
        call(monkeypatch, train_refinement, data, tmp_path / "run")
    assert "too few show a grasp that held" in capsys.readouterr().err


def test_nothing_to_learn_from_is_refused(data, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(train_refinement, "is_held_out", lambda name: True)
    with pytest.raises(SystemExit):
        call(monkeypatch, evaluate_refinement, data, data, tmp_path / "results")
    assert "and 0 to learn from, too few held." in capsys.readouterr().err
    assert not (tmp_path / "results").exists()


def test_scenes_and_grasps_are_exported(tmp_path, monkeypatch):
    file = tmp_path / "grasps.json"
    call(monkeypatch, evaluate, "--scenes", "2", "--export", file, "--weights", "GG-CNN2", WEIGHTS)
    found = json.loads(file.read_text())
    assert found["schema"] == 2
    assert [(s["scene"], s["objects"]) for s in found["scenes"]] == [(0, 1), (1, 3)]
    for scene in found["scenes"]:
        assert len(scene["qpos"]) == 7 * scene["objects"]
        assert scene["mjcf"].count("<freejoint/>") == scene["objects"]
        assert [g["method"] for g in scene["grasps"]] == [
            "oracle",
            "random pixel",
            "principal axis",
            "edge pair",
            "GG-CNN2",
        ]
        T = np.array(scene["grasps"][0]["T_world_grasp"])
        assert T[2, 2] < -0.95
        assert 0.0 < T[2, 3] < 0.2
