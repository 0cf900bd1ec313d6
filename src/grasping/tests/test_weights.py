"""Weight files: the published kinds load, nothing in them runs, and all else is refused in one sentence."""

from __future__ import annotations

import io
import os
import tarfile
from collections import OrderedDict
from pathlib import Path
from typing import Tuple

import published_networks
import pytest
import torch

from common.ros.files import read_yaml
from grasping.network import weights
from grasping.network.maps import PARALLEL, REFLEX
from grasping.poses import lift_network, taste_file
from grasping.poses.gripper import GRIPPERS

OWN = {
    "ggcnn2_reflex.pt": ("ggcnn2", REFLEX),
    "ggcnn2_wide.pt": ("ggcnn2", PARALLEL),
}
LIFTS = {
    "lifts_parallel.pt": (PARALLEL, "ggcnn2_wide.pt"),
    "lifts_reflex.pt": (REFLEX, "ggcnn2_reflex.pt"),
}
PUBLISHED = {"ggcnn": published_networks.GGCNN, "ggcnn2": published_networks.GGCNN2}


def file(content, old: bool = False) -> bytes:
    buffer = io.BytesIO()
    torch.save(content, buffer, _use_new_zipfile_serialization=not old)
    return buffer.getvalue()


@pytest.mark.parametrize("name", PUBLISHED)
@pytest.mark.parametrize("old", [True, False], ids=["old container", "zip container"])
@pytest.mark.parametrize("whole", [True, False], ids=["whole model", "state dict"])
def test_published_kinds_load(name, old, whole):
    """Reported in https://github.com/dougsm/ggcnn/issues/30: a pickled model loads for its author alone. Tried: that
    file.
    """
    published = PUBLISHED[name]()
    loaded = weights.load(file(published if whole else published.state_dict(), old))
    assert loaded.name == name
    for key, value in published.state_dict().items():
        torch.testing.assert_close(loaded.network.state_dict()[key], value, rtol=0.0, atol=0.0)
    assert not loaded.network.training


@pytest.mark.parametrize(
    "kept",
    [
        lambda network: {"epoch": 3, "state_dict": network.state_dict()},
        lambda network: {"model_state_dict": network.state_dict(), "optimizer": {}},
        lambda network: {f"module.{key}": value for key, value in network.state_dict().items()},
        lambda network: torch.nn.DataParallel(network),
        lambda network: {key: value.double() for key, value in network.state_dict().items()},
    ],
    ids=["checkpoint", "tutorial's checkpoint", "of several devices", "whole, of several devices", "float64"],
)
def test_what_other_training_programs_keep_loads(kept):
    """Reported in https://github.com/pytorch/pytorch/issues/3805: checkpoints of several devices: keys begin with
    `module.`. Tried: such files, and `state_dict` in a checkpoint.
    """
    published = published_networks.GGCNN()
    loaded = weights.load(file(kept(published)))
    for key, value in published.state_dict().items():
        torch.testing.assert_close(loaded.network.state_dict()[key], value)


def test_published_keras_file_loads(shared_data):
    path = shared_data / "ggcnn" / "epoch_29_model.hdf5"
    loaded = weights.load(path.read_bytes(), "07ed61da2f5b5aa5d8d10a85c0a26023bae489c3b15fe16e58227c14738a3770")
    assert (loaded.name, loaded.origin) == ("ggcnn_keras", "GG-CNN, RSS 2018, Keras")
    # A ridge 60 mm high and 40 pixels broad: the grasp is on it and across it.
    image = torch.zeros(1, 1, 300, 300)
    image[:, :, 60:240, 130:170] = -0.06
    image -= image.mean()
    with torch.no_grad():
        quality, cos, _, width = loaded.network(image)[0]
    row, column = divmod(int(quality.argmax()), 300)
    assert 60 <= row < 240
    assert 130 <= column < 170
    assert float(cos[row, column]) > 0.5
    assert 40.0 < 150.0 * float(width[row, column]) < 120.0


class Foreign:
    """What it would do when it is unpickled must not happen."""

    def __init__(self, path):
        self.path = str(path)

    def __reduce__(self):
        return os.mkdir, (self.path,)


@pytest.mark.parametrize("old", [True, False], ids=["old container", "zip container"])
def test_nothing_foreign_runs(tmp_path, old):
    mark = tmp_path / "ran"
    data = file({"weight": Foreign(mark)}, old)
    with pytest.raises(weights.WeightsError, match="neither a state dict nor a model"):
        weights.load(data)
    assert not mark.exists()


class Program(torch.nn.Module):
    """What it would do when torch reads it as a TorchScript archive must not happen; it works where it stands."""

    def __init__(self):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.zeros(3))

    def forward(self, x):
        return x

    @torch.jit.export
    def __getstate__(self):
        return self.weight, self.training

    @torch.jit.export
    def __setstate__(self, state: Tuple[torch.Tensor, bool]):  # noqa: UP006  # evaluated, also by Python 3.8
        torch.save(state[0], "ran")
        self.weight = state[0]
        self.training = state[1]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("load", [weights.load, taste_file.load], ids=["network", "refinement"])
def test_no_program_runs(tmp_path, monkeypatch, load):
    monkeypatch.chdir(tmp_path)
    buffer = io.BytesIO()
    torch.jit.save(torch.jit.script(Program()), buffer)
    with pytest.raises(weights.WeightsError, match="it is a TorchScript program, not a state dict"):
        load(buffer.getvalue())
    assert not list(tmp_path.iterdir())


def test_no_tar_archive_is_unpacked():
    """Its first file's name makes it begin as a pickle does."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w", format=tarfile.GNU_FORMAT, encoding="latin-1") as archive:
        archive.addfile(tarfile.TarInfo("\x80"))
        archive.addfile(tarfile.TarInfo("storages"))
    assert buffer.getvalue().startswith(weights.PICKLE_MAGIC)
    with pytest.raises(weights.WeightsError, match="it is a tar archive"):
        weights.load(buffer.getvalue())


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"", "neither a torch file nor a Keras"),
        (b"hello", "neither a torch file nor a Keras"),
        (b"\x89HDF\r\n\x1a\n" + bytes(64), "does not hold GG-CNN's layers"),
        (b"PK\x03\x04" + bytes(64), "cannot be read"),
        (b"\x80\x02cos\nsystem\n.", "cannot be read"),
        (file({"a": torch.zeros(1)}), "fit no known network"),
        (file([1, 2]), "neither a state dict nor a model"),
        (file({"features.14.weight": torch.zeros(1), "features.16.weight": torch.zeros(1)}), "before July 2020"),
    ],
    ids=["empty", "text", "broken hdf5", "broken zip", "broken pickle", "other arrays", "a list", "older GG-CNN2"],
)
def test_other_files_are_refused(data, sentence):
    with pytest.raises(weights.WeightsError, match=sentence):
        weights.load(data)


def test_wrong_shape_is_named():
    state = OrderedDict(published_networks.GGCNN().state_dict())
    state["conv1.weight"] = torch.zeros(32, 4, 9, 9)
    with pytest.raises(weights.WeightsError, match=r"conv1.weight has the shape \(32, 4, 9, 9\) instead of"):
        weights.load(file(state))


def test_values_that_are_not_finite_are_refused():
    state = published_networks.GGCNN2().state_dict()
    state["features.0.bias"][3] = float("nan")
    with pytest.raises(weights.WeightsError, match="not finite"):
        weights.load(file(state))


def test_hash_is_checked():
    data = file(published_networks.GGCNN().state_dict())
    found = weights.load(data).sha256
    assert weights.load(data, found).name == "ggcnn"
    with pytest.raises(weights.WeightsError, match="was expected"):
        weights.load(data, "0" * 64)


def test_the_packages_own_weights_are_as_listed():
    folder = Path(__file__).parents[1] / "weights"
    sums = (folder / "SHA256SUMS").read_text()
    assert {path.name for path in folder.glob("*.pt")} == {*OWN, *LIFTS}
    for name, (network, hand) in OWN.items():
        content = (folder / name).read_bytes()
        assert len(content) < 300_000
        loaded = weights.load(content, weights.listed_sha256(sums, name))
        assert (loaded.name, loaded.hand) == (network, hand)
    with pytest.raises(weights.WeightsError, match="does not name other.pt"):
        weights.listed_sha256(sums, "other.pt")
    for name, (hand, ggcnn) in LIFTS.items():
        content = (folder / name).read_bytes()
        weights.checked_sha256(content, weights.listed_sha256(sums, name))
        assert len(content) < 320_000
        lifts = lift_network.loaded(content)
        assert (lifts.hand, lifts.ggcnn) == (hand, weights.listed_sha256(sums, ggcnn))
        assert lifts.gripper == GRIPPERS[hand] and (lifts.trusts < 1.0) == (hand == REFLEX)


def test_the_node_comes_with_weights_for_the_hand_that_the_rig_has():
    config = Path(__file__).parents[1] / "config"
    name = read_yaml(config / "ggcnn.yaml")["network"]["weights"]
    assert OWN[name][1] == read_yaml(config / "tool_pose.yaml")["hand"] == REFLEX
