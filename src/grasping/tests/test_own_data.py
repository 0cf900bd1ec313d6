"""From one's own depth images to a network and its figures: label, import, train, measure, find."""

from __future__ import annotations

import csv
import json
import math
import shutil

import cv2
import numpy as np
import pytest
import torch
from test_programs import call

from grasping.lab.dataset import labelled_images as li
from grasping.lab.programs import evaluate, find_grasps, import_grasps, train_ggcnn
from grasping.network import weights
from grasping.network.networks import NETWORKS

BARS = 6


@pytest.fixture(name="images", scope="module")
def images_fixture(tmp_path_factory):
    """Depth images of a bar on a table, each with the grasp across it."""
    folder = tmp_path_factory.mktemp("images")
    rng = np.random.default_rng(4)
    for number in range(BARS):
        angle, row, column = rng.uniform(-1.5, 1.5), *rng.uniform(180.0, 300.0, 2)
        grasp = li.GraspRectangle(row, column, angle, 50.0, 30.0)
        bar = li.GraspRectangle(row, column, angle, 36.0, 120.0)
        depth = np.full((480, 640), 700, np.uint16)
        cv2.fillConvexPoly(depth, np.round(bar.corners()).astype(np.int32), 640)
        cv2.imwrite(str(folder / f"bar_{number}.png"), depth)
        li.write_grasps(folder / f"bar_{number}.grasps.json", [grasp])
    return folder


@pytest.fixture(name="shards")
def shards_fixture(images, tmp_path, monkeypatch):
    call(monkeypatch, import_grasps, images, tmp_path / "shards", "--validation", "0.4")
    return tmp_path / "shards"


@pytest.mark.parametrize("name", ["ggcnn2", "ggcnn_keras"])
def test_training_begins_with_a_weight_file_and_its_weights_are_of_the_same_network(
    shards, tmp_path, monkeypatch, capsys, name
):
    start, run = tmp_path / "start.pt", tmp_path / "run"
    torch.manual_seed(3)
    network = NETWORKS[name]()
    torch.save(weights.state_for_file(name, network), start)
    options = ["--from", start, "--count", "2", "--side", "60", "--half", "false", "--warm-up", "1"]
    call(monkeypatch, train_ggcnn, shards, run, *options, "--steps", "1", "--rate", "1e-12")
    loaded = weights.load((run / "weights.pt").read_bytes())
    assert loaded.name == name
    for key, value in loaded.network.state_dict().items():
        torch.testing.assert_close(value, network.state_dict()[key], atol=1e-6, rtol=0.0)
    settings = json.loads((run / "settings.json").read_text())
    assert settings["network"] == name and settings["from"] == weights.load(start.read_bytes()).sha256
    torch.save(weights.state_for_file(name, NETWORKS[name]()), start)
    with pytest.raises(SystemExit):
        call(monkeypatch, train_ggcnn, shards, run, *options, "--steps", "1", "--rate", "1e-12")
    assert "holds a training on other data or with other settings" in capsys.readouterr().err


def test_imported_shards_are_replaced_and_others_stay(images, shards, monkeypatch, capsys):
    """Reported in https://github.com/dougsm/ggcnn/issues/49: few images: no model is written. Tried: three images."""
    names = sorted(path.name for path in shards.iterdir())
    assert names == ["train_own_000000.npz", "validation_own_000000.npz"]
    (shards / "train_000000.npz").write_bytes(b"of make_dataset")
    call(monkeypatch, import_grasps, images, shards, "--validation", "0")
    assert sorted(path.name for path in shards.iterdir()) == ["train_000000.npz", "train_own_000000.npz"]
    printed = capsys.readouterr().out
    assert f"{BARS} images for training, 0 for validation, of {BARS} things." in printed
    assert "Training needs both" in printed
    with np.load(shards / "train_own_000000.npz") as shard:
        assert shard["depth"].shape == (BARS, 300, 300) and (shard["quality"].max(axis=(1, 2)) == 255).all()


def test_images_of_one_thing_fall_into_one_split():
    images = [
        li.LabelledImage(f"{n}_{thing}", f"thing{thing}", lambda: None, ()) for thing in range(300) for n in (0, 1)
    ]
    splits = {image.name: import_grasps.split(image, 0.2) for image in images}
    assert all(splits[f"0_{thing}"] == splits[f"1_{thing}"] for thing in range(300))
    assert 0.1 < sum(kind == "validation" for kind in splits.values()) / len(splits) < 0.3


def test_bad_labels_and_images_are_named_counted_and_left_out_and_without_others_the_shards_before_stay(
    images, tmp_path, monkeypatch, capsys
):
    source, shards = tmp_path / "source", tmp_path / "shards"
    shutil.copytree(images, source)
    (source / "bar_0.grasps.json").write_text("{")
    np.save(source / "bar_1.npy", np.full((480, 640), 700.0))
    (source / "bar_1.png").unlink()
    (source / "bar_2.png").unlink()
    (source / "bar_3.png").write_bytes(b"\x89PNG")
    call(monkeypatch, import_grasps, source, shards, "--validation", "0")
    streams = capsys.readouterr()
    assert [f"bar_{n}" in streams.err for n in range(BARS)] == [n < 4 for n in range(BARS)]
    assert f"{BARS - 4} images for training, 0 for validation, of {BARS - 4} things; 4 left out." in streams.out
    before = {path: path.read_bytes() for path in shards.iterdir()}
    for number in range(4, BARS):
        (source / f"bar_{number}.png").unlink()
        np.save(source / f"bar_{number}.npy", np.full((480, 640), 700.0, np.float32))
    with pytest.raises(SystemExit) as ended:
        call(monkeypatch, import_grasps, source, shards)
    said = capsys.readouterr().err
    assert ended.value.code and "in millimetres as 16-bit ones" in said
    assert "None of the 4 labelled images" in said
    assert {path: path.read_bytes() for path in shards.iterdir()} == before


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda arrays: {**arrays, "depth": 60.0 * np.sign(arrays["depth"])}, "holds depths 60 m from their mean"),
        (lambda arrays: {**arrays, "depth": np.full_like(arrays["depth"], np.inf)}, "holds depths inf m from"),
        (lambda arrays: {"depth": arrays["depth"]}, "is not a shard"),
        (None, "is not a shard"),
    ],
)
def test_shards_of_images_in_another_unit_or_torn_ones_are_refused(shards, tmp_path, monkeypatch, capsys, damage, said):
    shard = shards / "train_own_000000.npz"
    if damage is None:
        shard.write_bytes(shard.read_bytes()[:-300])
    else:
        with np.load(shard) as arrays:
            damaged = damage(dict(arrays))
        np.savez(shard, **damaged)
    with pytest.raises(SystemExit):
        call(monkeypatch, train_ggcnn, shards, tmp_path / "run", "--steps", "1")
    assert f"{shard} {said}" in capsys.readouterr().err and not (tmp_path / "run").exists()


class Knowing(torch.nn.Module):
    """Says a grasp of given angle and opening where the images' bars are thickest; stands for a trained network."""

    def __init__(self, turned: float) -> None:
        super().__init__()
        self.turned = turned

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        mask = (image[0, 0] < image.mean() - 0.02).numpy().astype(np.uint8)
        (column, row), (width, height), degrees = cv2.minAreaRect(np.argwhere(mask)[:, ::-1].astype(np.float32))
        angle = -math.radians(degrees) + (0.0 if width < height else math.pi / 2.0) + self.turned
        maps = torch.zeros((1, 4, *mask.shape))
        maps[0, 0, round(row) - 3 : round(row) + 4, round(column) - 3 : round(column) + 4] = 1.0
        maps[0, 1], maps[0, 2], maps[0, 3] = math.cos(2.0 * angle), math.sin(2.0 * angle), 0.25
        return maps


@pytest.mark.parametrize(("turned", "right"), [(0.0, BARS), (0.7, 0)])
def test_the_rectangle_metric_tells_a_good_network_from_one_that_is_turned(
    images, tmp_path, monkeypatch, capsys, turned, right
):
    file, results = tmp_path / "weights.pt", tmp_path / "results"
    torch.save(NETWORKS["ggcnn2"]().state_dict(), file)
    monkeypatch.setattr(evaluate, "network", lambda _file, _precision: Knowing(turned))
    call(monkeypatch, evaluate, results, "--folder", images, "--weights", "mine", file)
    with (results / "results.csv").open(newline="") as csv_file:
        rows = list(csv.DictReader(csv_file))
    assert [row["right"] for row in rows] == [str(right > 0)] * BARS
    assert f"| mine | {100 if right else 0} (" in capsys.readouterr().out


def test_where_no_image_can_be_used_no_results_stay(images, tmp_path, monkeypatch, capsys):
    file, source, results = tmp_path / "weights.pt", tmp_path / "source", tmp_path / "results"
    torch.save(NETWORKS["ggcnn2"]().state_dict(), file)
    source.mkdir()
    cv2.imwrite(str(source / "bar_0.png"), cv2.imread(str(images / "bar_0.png"), cv2.IMREAD_UNCHANGED)[:300])
    li.write_grasps(source / "bar_0.grasps.json", [li.GraspRectangle(400.0, 320.0, 0.0, 50.0, 30.0)])
    with pytest.raises(SystemExit):
        call(monkeypatch, evaluate, results, "--folder", source, "--weights", "mine", file)
    assert "None of the 1 labelled images" in capsys.readouterr().err
    assert not any(results.iterdir())


def test_grasps_are_found_in_a_folder_and_drawn(images, tmp_path, monkeypatch, capsys):
    file, source = tmp_path / "weights.pt", tmp_path / "source"
    torch.save(NETWORKS["ggcnn2"]().state_dict(), file)
    source.mkdir()
    for name in ("bar_0.png", "bar_1.png"):
        (source / name).write_bytes((images / name).read_bytes())
    (source / "torn.png").write_bytes(b"\x89PNG")
    call(monkeypatch, find_grasps, source, file, "--picture", tmp_path / "pictures")
    streams = capsys.readouterr()
    assert [json.loads(line)["image"] for line in streams.out.splitlines()] == ["bar_0.png", "bar_1.png"]
    assert "Left out" in streams.err and "torn.png" in streams.err
    assert cv2.imread(str(tmp_path / "pictures" / "bar_1.png")).shape == (900, 900, 3)


def test_grasps_are_found_neither_in_another_unit_nor_with_a_focal_length_of_another_image(
    images, tmp_path, monkeypatch, capsys
):
    file, source = tmp_path / "weights.pt", tmp_path / "source"
    torch.save(NETWORKS["ggcnn2"]().state_dict(), file)
    source.mkdir()
    np.save(source / "depth.npy", np.full((480, 640), 700.0, np.float32))
    cases = (
        ([source / "depth.npy"], "the median of the depth is 700 m"),
        ([source], "None of the 1 images"),
        ([images / "bar_0.png", "--focal", "3.6"], "the focal lengths 3.6 and 3.6"),
    )
    for (image, *options), said in cases:
        with pytest.raises(SystemExit) as ended:
            call(monkeypatch, find_grasps, image, file, *options)
        streams = capsys.readouterr()
        assert ended.value.code and said in streams.err and not streams.out
