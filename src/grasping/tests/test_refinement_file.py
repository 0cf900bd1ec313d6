"""The refinement network's file: it comes back as it was saved, and says for which rig it is."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
import torch

from grasping.network.depth_image import CAMERA, TABLE, VIEWS
from grasping.network.refinement import RefinementNetwork
from grasping.network.refinement_file import Origin, content, load, taste
from grasping.network.weights import WeightsError

RIG = Origin(
    view=CAMERA,
    crop={"side": 400, "rows_up": 0},
    network="ab" * 32,
    robot="LBR7R800",
    hand=np.eye(4).tolist(),
)
CONFIGURATION = {
    "view": TABLE,
    "crop": {"side": 400, "rows_up": 0},
    "table": {"extent": 0.65, "distance": 0.7, "noise": 0.003},
    "weights": "ab" * 32,
    "kuka": {"robot": "LBR7R800", "flange": "MF_elektrisch"},
    "T_tool_grasp": np.eye(4).tolist(),
}


def file(state) -> bytes:
    buffer = io.BytesIO()
    torch.save(state, buffer)
    return buffer.getvalue()


def trained() -> RefinementNetwork:
    torch.manual_seed(1)
    network = RefinementNetwork()
    for parameter in network.parameters():
        parameter.data.normal_(0.0, 0.2)
    network.offset[:] = torch.arange(7.0)
    return network


def test_a_saved_network_comes_back():
    network = trained()
    found, origin = load(file(content(network, RIG)))
    assert origin == RIG
    for name, value in network.state_dict().items():
        torch.testing.assert_close(found.network.state_dict()[name], value, rtol=0.0, atol=0.0)


def test_the_taste_has_no_axes_and_fits_any_rig_with_the_first_network():
    network = trained()
    found, origin = load(file(taste(network, RIG)))
    assert origin == Origin(network=RIG.network)
    assert not found.network.offset.any()
    x = torch.randn(1, 14, 3, 3)
    with torch.no_grad():
        before, after = network(x)[0], found.network(x)[0]
    assert not after[5:7].any()
    for rows in (slice(0, 5), slice(7, None)):
        torch.testing.assert_close(before[rows], after[rows], rtol=0.0, atol=0.0)
    for view in VIEWS:
        assert not origin.mismatch(replace(RIG, view=view, hand=None))
    assert "learned with network: abababababab..., but network is cdcdcdcdcdcd..." in origin.mismatch(
        replace(RIG, network="cd" * 32)
    )


def test_the_origin_is_what_matters_of_a_rigs_configuration():
    found = Origin.of(CONFIGURATION)
    assert found == replace(RIG, view=TABLE, crop=None, table={"extent": 0.65, "distance": 0.7})
    assert Origin.of({**CONFIGURATION, "view": CAMERA}) == RIG
    assert Origin.of({"robot": "LBR7R800"}) == Origin(view=CAMERA)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("view", TABLE),
        ("crop", {"side": 300, "rows_up": 0}),
        ("network", "cd" * 32),
        ("robot", "LBR14R820"),
        ("hand", np.diag([1.0, -1.0, -1.0, 1.0]).tolist()),
    ],
)
def test_another_rig_is_named(name, value):
    found = RIG.mismatch(replace(RIG, **{name: value}))
    assert found.startswith(f"learned with {name}: ")
    assert f", but {name} is " in found
    assert not RIG.mismatch(RIG)
    assert not RIG.mismatch(replace(RIG, **{name: None}))


def test_another_extent_of_the_table_is_another_rig():
    one = Origin.of(CONFIGURATION)
    other = Origin.of({**CONFIGURATION, "table": {**CONFIGURATION["table"], "extent": 0.4}})
    assert "learned with table: {'extent': 0.65, 'distance': 0.7}, but table is {'extent': 0.4" in one.mismatch(other)
    finer = Origin.of({**CONFIGURATION, "table": {**CONFIGURATION["table"], "noise": 0.002}})
    assert not one.mismatch(finer)


def bad(key, value):
    return {**content(RefinementNetwork(), RIG), key: value}


def about(text: str) -> torch.Tensor:
    return torch.tensor(list(text.encode()))


OLD = {**RefinementNetwork().state_dict(), "offset": torch.zeros(5), "view": torch.tensor(0.0)}


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"nothing", "The torch file cannot be read"),
        (file({}), "neither a state dict nor a model"),
        (file({"a": torch.zeros(3)}), "of version 2"),
        (file(OLD), "of version 2"),
        (file(bad("about", about('{"version": 3}'))), "of version 2"),
        (file(bad("about", about("[1"))), "of version 2"),
        (file(bad("about", torch.tensor([300, -1]))), "of version 2"),
        (file(bad("about", torch.tensor([[1.0, np.nan]]))), "of version 2"),
        (file(bad("about", about('{"version": 2}'))), "does not say of what rig it is"),
        (file(content(RefinementNetwork(), replace(RIG, view="above"))), "or names a view that is not known"),
        (file({k: v for k, v in content(trained(), RIG).items() if k != "last.bias"}), "lacks last.bias"),
        (file(bad("offset", torch.zeros(3))), "The array offset has the shape"),
        (file(bad("offset", torch.full((7,), np.nan))), "not finite"),
    ],
    ids=[
        "no torch",
        "empty",
        "foreign",
        "old",
        "newer",
        "torn",
        "codes",
        "nan",
        "bare",
        "view",
        "part",
        "shape",
        "inf",
    ],
)
def test_bad_files_are_refused(data, sentence):
    with pytest.raises(WeightsError, match=sentence):
        load(data)


def test_another_hash_is_refused():
    with pytest.raises(WeightsError, match="but 00 was expected"):
        load(file(content(RefinementNetwork(), RIG)), "00")
