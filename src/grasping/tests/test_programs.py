"""The programs from data to table, on a handful of scenes; each resumes where it stopped."""

from __future__ import annotations

import csv
import json
import multiprocessing.dummy
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch

from grasping.lab.evaluation import lift_file, trials
from grasping.lab.programs import (
    evaluate,
    evaluate_refinement,
    find_grasps,
    import_grasps,
    make_dataset,
    make_episodes,
    runs,
    train_ggcnn,
    train_refinement,
)
from grasping.lab.synthetic import samples
from grasping.network import weights
from grasping.network.depth_image import prepare
from grasping.network.maps import PARALLEL, REFLEX
from grasping.network.networks import NETWORKS

SHIPPED = Path(__file__).parents[1] / "weights" / "ggcnn2_wide.pt"
LIFTS = SHIPPED.with_name("lifts_parallel.pt")


def call(monkeypatch, program, *arguments):
    monkeypatch.setattr(sys, "argv", [program.__name__, *map(str, arguments)])
    program.main()


@pytest.fixture(scope="module", name="shards")
def shards_fixture(tmp_path_factory):
    """Three shards of two scenes each, made without processes of their own."""
    folder = tmp_path_factory.mktemp("shards")
    for split, first in (("train", 0), ("train", 2), ("validation", 0)):
        path = folder / f"{split}_{first:06d}.npz"
        make_dataset.make_shard(make_dataset.ShardTask(path, split, range(first, first + 2)))
    return folder


@pytest.fixture(name="data")
def data_fixture(shards, tmp_path):
    return Path(shutil.copytree(shards, tmp_path / "data"))


@pytest.fixture(name="in_process")
def in_process_fixture(monkeypatch):
    """The pool's tasks run in a thread of this process: a spawned one imports torch and MuJoCo for seconds."""
    threads = SimpleNamespace(get_context=lambda _method: multiprocessing.dummy)
    monkeypatch.setattr(evaluate, "multiprocessing", threads)
    monkeypatch.setattr(lift_file, "multiprocessing", threads)


@pytest.mark.real
def test_shards_are_made_once(data, monkeypatch):
    monkeypatch.setattr(make_dataset, "SHARD", 2)
    names = ["train_000000.npz", "train_000002.npz", "validation_000000.npz"]
    (data / names[1]).unlink()
    kept = (data / names[0]).stat().st_mtime_ns
    call(monkeypatch, make_dataset, data, "--split", "train", "--scenes", "4")
    assert sorted(p.name for p in data.iterdir()) == names
    assert (data / names[0]).stat().st_mtime_ns == kept
    with np.load(data / names[1]) as shard:
        assert shard["depth"].shape == (2, 300, 300)
        assert set(shard) == {"depth", "quality", "angle", "width", "known", "hand", "margin"}


@pytest.mark.parametrize(
    ("option", "value"),
    [
        *(
            ("--network", "foo"),
            ("--steps", "0"),
            ("--count", "0"),
            ("--side", "0"),
            ("--side", "400"),
            ("--side", "61"),
        ),
        *(
            ("--rate", "nan"),
            ("--rate", "0"),
            ("--warm-up", "-1"),
            ("--decay", "2"),
            ("--memory", "1"),
            ("--seed", "x"),
        ),
        *(("--half", "True"), ("--every", "0"), ("--threads", "0"), ("--shards", "0")),
    ],
)
def test_impossible_settings_of_a_training_are_refused_by_name(data, tmp_path, monkeypatch, capsys, option, value):
    """Reported in https://github.com/dougsm/ggcnn/issues/14: a training ends by the shapes of its arrays. Tried:
    `--side 61`, `--count 0`, `--network foo`, ....
    """
    with pytest.raises(SystemExit) as end:
        call(monkeypatch, train_ggcnn, data, tmp_path / "run", option, value)
    last = capsys.readouterr().err.rstrip().splitlines()[-1]
    assert end.value.code == 2 and option in last and value in last and not (tmp_path / "run").exists()


def test_training_stops_and_resumes(data, tmp_path, monkeypatch, capsys):
    run = tmp_path / "run"
    options = ["--steps", "4", "--count", "2", "--side", "60", "--every", "2", "--half", "false"]

    def interrupt(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as interrupted:
        interrupted.setattr(runs, "plot", interrupt)
        with pytest.raises(KeyboardInterrupt):
            call(interrupted, train_ggcnn, data, run, *options)
    call(monkeypatch, train_ggcnn, data, run, *options)
    with (run / "curves.csv").open(newline="") as file:
        assert [row["step"] for row in csv.DictReader(file)] == ["2", "4"]
    assert (run / "curves.png").stat().st_size > 1000
    content = (run / "weights.pt").read_bytes()
    assert weights.load(content).name == "ggcnn2"
    assert len(content) < 300_000
    (data / "train_000002.npz").unlink()
    for change in ([], ["--seed", "2"]):
        with pytest.raises(SystemExit):
            call(monkeypatch, train_ggcnn, data, run, *options, *change)
        assert "holds a training on other data or with other settings" in capsys.readouterr().err
        assert (run / "weights.pt").read_bytes() == content
    call(monkeypatch, train_ggcnn, data, run, *options, "--anew")
    assert (run / "before_1" / "weights.pt").read_bytes() == content
    assert (run / "weights.pt").read_bytes() != content


def test_evaluation_compares_networks(tmp_path, monkeypatch, capsys, in_process):
    file = tmp_path / "weights.pt"
    torch.save(NETWORKS["ggcnn2"]().state_dict(), file)
    results = tmp_path / "results" / "results.csv"
    networks = ["--weights", "shipped", SHIPPED, "--weights", "untrained", file]
    call(monkeypatch, evaluate, tmp_path / "results", "--scenes", "2", *networks)
    rows = list(csv.DictReader(results.read_text().splitlines()))
    assert {(r["scene"], r["method"]) for r in rows} == {
        (s, m) for s in "01" for m in ("oracle", "shipped", "untrained")
    }
    assert len(rows) == 6
    text = (tmp_path / "results" / "table.md").read_text()
    assert "| untrained |" in text and "| untrained - shipped |" in text
    assert {"reliability.png", "failures_untrained.png"} <= {p.name for p in results.parent.glob("*.png")}
    for row in rows:
        assert (row["reason"] == "lifted") == (row["lifted"] == "True")
    settings = json.loads((results.parent / "settings.json").read_text())
    assert settings["weights"]["shipped"] == weights.load(SHIPPED.read_bytes()).sha256
    with pytest.raises(SystemExit):
        call(monkeypatch, evaluate, tmp_path / "results", "--scenes", "1")
    assert "results.csv is there already: name another folder." in capsys.readouterr().err


def test_scenes_and_conditions_are_those_asked_for(tmp_path, monkeypatch, in_process):
    tasks = []
    monkeypatch.setattr(evaluate, "try_scene", lambda task: tasks.append(task) or [])
    monkeypatch.setattr(evaluate, "report", lambda *_: None)
    options = ["--first", "7", "--scenes", "3", "--error", "5", "4", "--split", "validation"]
    options += ["--precision", "bfloat16"]
    file = tmp_path / "weights.pt"
    torch.save(NETWORKS["ggcnn2"]().state_dict(), file)
    twice = ["--weights", "net", file] * 2
    call(monkeypatch, evaluate, tmp_path / "results", *options, "--shake", *twice)
    assert sorted((task.split, task.number) for task in tasks) == [("validation", n) for n in (7, 8, 9)]
    assert list(tasks[0].trained) == ["net #1", "net #2"]
    assert {network.precision for network in tasks[0].trained.values()} == {"bfloat16"}
    conditions = tasks[0].conditions
    assert conditions == (0.005, pytest.approx(np.radians(4.0)), True, PARALLEL)
    monkeypatch.setattr(lift_file, "write", lambda _path, _make, tasks, _processes: exported.extend(tasks))
    exported = []
    call(monkeypatch, evaluate, "--export", tmp_path / "grasps.json", *options)
    assert {task.conditions for task in exported} == {conditions._replace(shake=False, hand=REFLEX)}


def test_networks_are_tried_with_the_openings_of_a_hand_as_well(tmp_path, monkeypatch, in_process):
    package, exported = Path(__file__).parents[1], tmp_path / "grasps.json"
    tool = tmp_path / "tool_pose.yaml"
    wide = "preferred_opening: [0.07, 0.12]\noutside_quality: 0.01\n"
    others = (line for line in (package / "config" / "tool_pose.yaml").read_text().splitlines() if "pre" not in line)
    tool.write_text(wide + "\n".join(line for line in others if not line.startswith("outside_quality")))
    network = ["--weights", "net", package / "weights" / "ggcnn2_wide.pt", "--tool", tool]
    call(monkeypatch, evaluate, "--export", exported, "--scenes", "2", "--split", "validation", *network)
    scenes = json.loads(exported.read_text())["scenes"]
    for scene in scenes:
        widths = {grasp["method"]: grasp["width"] for grasp in scene["grasps"]}
        assert widths["net, preferred openings"] > 0.06
    with_targets = [g for s in scenes for g in s["grasps"] if g["target"] is not None]
    assert with_targets and all(0 <= g["target"] < 5 and g["peak"]["width"] > 0.0 for g in with_targets)
    call(monkeypatch, evaluate, "--export", exported, "--scenes", "1")
    assert json.loads(exported.read_text())["scenes"][0]["qpos"] != scenes[0]["qpos"]


def test_evaluated_grasps_have_the_precision_that_was_asked_for():
    image = prepare(samples.view("test", 0, 1).observed, trials.CROP)
    exact, rounded = (
        evaluate.network_grasp(image, evaluate.Trained(SHIPPED, None, precision))
        for precision in ("float32", "bfloat16")
    )
    assert 0.0 < abs(rounded.quality - exact.quality) < 0.02


HAND_OR_FOLDER = "with --weights, without --export and --tool"
EITHER = "Either a folder for the results is needed, or --export."


@pytest.mark.parametrize(
    ("program", "arguments", "sentence"),
    [
        (make_dataset, ["data", "--scenes", "70"], "--scenes is 70, but must be a multiple of 50."),
        (make_dataset, ["bad/data", "--scenes", "50"], "bad/data cannot be written: Not a directory."),
        (make_dataset, ["data", "--scenes", "50", "--margin", "0.06"], "--margin is 0.06 m, but must be between 0 and"),
        (make_dataset, ["data", "--scenes", "50", "--margin", "nan"], "--margin is nan m"),
        (make_dataset, ["data", "--check", "there.json"], "Either a folder for the shards is needed, or --check."),
        (import_grasps, [".", "data", "--validation", "1"], "--validation is 1 and must be at least 0 and below 1."),
        (import_grasps, [".", "data", "--window", "0"], "--window is 0 and must be at least 1 pixel."),
        (import_grasps, [".", "data", "--name", "../a"], "--name is '../a' and must be a word"),
        (train_ggcnn, [".", "run"], "run make_dataset.py or import_grasps.py first."),
        pytest.param(
            train_ggcnn, [".", "run", "--device", "cuda"], "torch sees no CUDA device: train with --device cpu.",
            marks=pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device"),
        ),
        (evaluate, ["bad/data"], "Not a directory."),
        (evaluate, ["new", "--error", "5", "nan"], "argument --error: 'nan' is not a number in [0, 100]"),
        (evaluate, ["new", "--weights", "net", "missing"], "No such file"),
        (evaluate, ["new", "--weights", "net", "bad"], "neither a torch file nor"),
        (evaluate, ["new", "--tool", "missing"], "No such file"),
        (evaluate, ["new", "--tool", "bad"], "while parsing"),
        (evaluate, ["new", "--tool", "hand"], "max_opening is 1"),
        (evaluate, ["new", "--export", "file"], EITHER),
        (evaluate, [], EITHER),
        (evaluate, ["--export", "file", "--folder", "."], HAND_OR_FOLDER),
        (evaluate, ["new", "--tool", "file", "--folder", "."], HAND_OR_FOLDER),
        (evaluate, ["new", "--folder", "."], HAND_OR_FOLDER),
        (find_grasps, ["missing", SHIPPED], "No such file"),
        (find_grasps, ["bad", SHIPPED], "is not an image"),
        (find_grasps, ["hole.png", SHIPPED], "holds no reading"),
        (train_refinement, ["nowhere", "run", "--lifts", LIFTS], "holds no episode"),
        (train_refinement, ["nowhere", "run"], "the following arguments are required: --lifts"),
        (evaluate_refinement, ["nowhere", "new", "bad"], "holds no weights of the network of lifts"),
        (evaluate_refinement, ["nowhere", "new", LIFTS, "--few", "-1"], "from 0 to 1000"),
        (evaluate_refinement, ["nowhere", "new", LIFTS], "holds no episode"),
        (make_episodes, ["made", "nowhere.pt"], "No such file"),
        (make_episodes, ["made", SHIPPED, "--frames", "0"], "argument --frames"),
    ],
)  # fmt: skip
def test_bad_calls_are_a_sentence_and_write_nothing(tmp_path, monkeypatch, capsys, program, arguments, sentence):
    monkeypatch.chdir(tmp_path)
    Path("bad").write_text("a: [")
    Path("hand").write_text("max_opening: 1")
    cv2.imwrite("hole.png", np.zeros((480, 640), np.uint16))
    with pytest.raises(SystemExit) as end:
        call(monkeypatch, program, *arguments)
    assert end.value.code == 2 and sentence in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad", "hand", "hole.png"]


@pytest.mark.parametrize("kind", ["npy", "png"])
def test_grasps_of_one_image(tmp_path, monkeypatch, capsys, kind):
    depth = np.full((480, 640), 0.7, np.float32)
    depth[225:255, 255:385] = 0.65
    path = tmp_path / f"depth.{kind}"
    if kind == "npy":
        np.save(path, depth)
    else:
        cv2.imwrite(str(path), np.round(1000.0 * depth).astype(np.uint16))
    call(monkeypatch, find_grasps, path, SHIPPED, "--picture", tmp_path / "seen.png")
    found = json.loads(capsys.readouterr().out)
    assert 255 <= found["pixel"][0] < 385
    assert 225 <= found["pixel"][1] < 255
    assert found["position"][2] == pytest.approx(0.65, abs=1e-3)
    assert abs(abs(found["angle"]) - 0.5 * np.pi) < 0.3
    assert 0.03 < found["width"] < 0.08
    assert cv2.imread(str(tmp_path / "seen.png")).shape == (900, 900, 3)
    call(monkeypatch, find_grasps, path, SHIPPED, "--precision", "bfloat16")
    assert 0.0 < abs(json.loads(capsys.readouterr().out)["quality"] - found["quality"]) < 0.02
