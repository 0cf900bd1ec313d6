"""The file of an episode: what is in it, and that nothing but an episode is taken for one."""

import contextlib
import io
import json
import pickle
import zipfile
import zlib
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from episodes import episode, metadata
from hypothesis import given, settings
from hypothesis import strategies as st

from common.poses import pose
from grasping.lab.dataset.episode import Episode
from grasping.lab.dataset.store import LAYOUT, DatasetError, decode, encode, file_name, grasp_time, unfinished
from grasping.network.depth_image import Crop

GOLDEN = Path(__file__).parent / "golden" / "episode_schema_1.npz"
"""Written once by schema 1; later versions of the package must read it, or say that they do not."""
TINY = episode(2, Crop(220, 300, 12), m=3)
WHOLE = encode(TINY)


def content(data: bytes) -> dict:
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        return dict(archive)


def changed(**arrays) -> bytes:
    """The file of the tiny episode with other arrays; None leaves one out."""
    stream = io.BytesIO()
    values = {**content(encode(TINY)), **arrays}
    np.savez_compressed(stream, **{name: value for name, value in values.items() if value is not None})
    return stream.getvalue()


def changed_meta(**entries) -> bytes:
    meta = json.loads(str(content(encode(TINY))["meta"]))
    return changed(meta=np.array(json.dumps({k: v for k, v in {**meta, **entries}.items() if v is not None})))


def assert_equal(a: Episode, b: Episode) -> None:
    for field in fields(Episode):
        one, other = getattr(a, field.name), getattr(b, field.name)
        if field.name == "camera":
            assert (one.name, one.width, one.height) == (other.name, other.width, other.height)
            for key in "KDRP":
                np.testing.assert_array_equal(getattr(one, key), getattr(other, key))
        elif isinstance(one, np.ndarray):
            np.testing.assert_array_equal(one, other)
            assert one.dtype == other.dtype
        else:
            np.testing.assert_equal(one, other)


@given(st.integers(1, 4), st.integers(8, 20), st.sampled_from([3, 6]), st.booleans())
@settings(max_examples=20)
def test_an_episode_comes_back_as_it_was(n, side, m, held):
    given_one = episode(n, Crop(200, 300, side), m=m, held=held)
    found = decode(encode(given_one))
    assert_equal(found, given_one)
    assert len(found.frames()) == n
    with pytest.raises(ValueError, match="read-only"):
        found.depth[0, 0, 0] = 1


def test_the_format_is_what_the_handbook_says_and_files_of_schema_1_have_neither_shown_tool_nor_lift():
    found = {name: (a.dtype.str.lstrip("<|"), a.shape) for name, a in content(WHOLE).items()}
    assert found.pop("meta")[0].startswith("U")
    assert found == {
        "camera_K": ("f8", (3, 3)),
        "camera_D": ("f8", (5,)),
        "camera_R": ("f8", (3, 3)),
        "camera_P": ("f8", (3, 4)),
        "crop": ("i4", (3,)),
        "T_flange_tool": ("f8", (4, 4)),
        "T_tool_grasp": ("f8", (4, 4)),
        "T_base_tool_closed": ("f8", (4, 4)),
        "T_base_tool_shown": ("f8", (4, 4)),
        "T_base_grasp": ("f8", (4, 4)),
        "t_grasp": ("f8", ()),
        "held": ("b1", ()),
        "lift": ("f8", ()),
        "stamp": ("f8", (2,)),
        "depth": ("u2", (2, 12, 12)),
        "maps": ("f2", (2, 4, 3, 3)),
        "mean": ("f4", (2,)),
        "peak": ("f8", (2, 5)),
        "T_base_camera": ("f8", (2, 4, 4)),
        "T_base_tool_measured": ("f8", (2, 4, 4)),
        "T_base_tool_desired": ("f8", (2, 4, 4)),
        "finger_angles": ("f4", (2, 4)),
        "teleop_active": ("b1", (2,)),
    }
    assert content(WHOLE).keys() - content(GOLDEN.read_bytes()).keys() == {"T_base_tool_shown", "lift"}
    meta = json.loads(str(content(GOLDEN.read_bytes())["meta"]))
    assert sorted(meta) == [
        "camera", "configuration", "date", "fingerprint", "object", "operator", "reason", "revision", "schema",
        "source", "version",
    ]  # fmt: skip
    assert meta["fingerprint"] == "03c786713fa56c63299c07782ef80d24ac301089a5b215ba02ffd94976f66e64"
    assert_equal(decode(GOLDEN.read_bytes()), TINY)


@given(st.floats(0.0, 4e9))
def test_the_name_of_a_file_tells_when_its_grasp_was(t_grasp):
    name = file_name(replace(TINY, t_grasp=t_grasp))
    assert abs(t_grasp - grasp_time(name)) < 1.1e-3
    assert unfinished(f".{name}abcdefgh") and not unfinished(name)
    assert grasp_time(f"{name}.discarded") is None


def test_the_name_of_a_file_sorts_by_time():
    assert file_name(replace(TINY, t_grasp=1.6e9 + 2.8127)) == "episode_20200913T122642_812.npz"


def test_the_fingerprint_is_that_of_the_configuration_alone():
    one = metadata(configuration={"a": 1, "b": [0.1, 2.0]})
    assert one.fingerprint == metadata(configuration={"b": [0.1, 2.0], "a": 1}, object="box").fingerprint
    assert one.fingerprint != metadata(configuration={"a": 1, "b": [0.1, 2.1]}).fingerprint


@given(st.data())
@settings(max_examples=300)
def test_damaged_bytes_are_noticed_or_harmless(data):
    """Not every byte of an archive carries meaning; what comes back is the episode or a sentence."""
    damaged = bytearray(WHOLE)
    for place in data.draw(st.lists(st.integers(0, len(WHOLE) - 1), min_size=1, max_size=8)):
        damaged[place] = data.draw(st.integers(0, 255))
    with contextlib.suppress(DatasetError):
        assert_equal(decode(bytes(damaged)), TINY)


DIRECTORY, END = b"PK\1\2", b"PK\5\6"
"""How an entry of an archive's list of files begins, and what stands behind the list."""


def patched(mark: bytes, offset: int, value: bytes) -> bytes:
    """The file of the tiny episode with other bytes at an offset from the first mark."""
    data = bytearray(encode(TINY))
    at = data.index(mark) + offset
    data[at : at + len(value)] = value
    return bytes(data)


@pytest.mark.parametrize(
    ("data", "cause"),
    [
        (encode(TINY)[:-30], zipfile.BadZipFile),
        (patched(DIRECTORY, 16, b"\0\0\0\0"), zipfile.BadZipFile),  # the checksum
        (patched(DIRECTORY, 8, b"\1"), RuntimeError),  # encrypted
        (patched(DIRECTORY, 10, b"\x0e"), zipfile.BadZipFile),  # packed as LZMA
        (patched(b"meta.npy", 28, b"\xff\xff\xff\xff"), zlib.error),
        (patched(DIRECTORY, 6, b"\xff"), NotImplementedError),  # the version
        (patched(END, 16, b"\xff\xff"), (ValueError, zipfile.BadZipFile)),  # where the list begins; by Python's version
    ],
    ids=["torn", "checksum", "encrypted", "lzma", "deflate", "version", "list"],
)
def test_each_damage_of_the_archive_is_a_sentence(data, cause):
    with pytest.raises(DatasetError, match=r"^The file is torn or damaged: .*\.$") as refusal:
        decode(data)
    assert isinstance(refusal.value.__context__, cause)


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"", "torn or damaged"),
        (b"episode\n" * 100, "Not an episode"),
        (pickle.dumps({"a": 1}), "Not an episode"),
        (changed(meta=None), "no metadata"),
        (changed(meta=np.array("{")), "metadata are not JSON"),
        (changed(meta=np.array('{"schema": NaN}')), "metadata are not JSON"),
        (changed(meta=np.array("[1]")), "metadata name no schema"),
        (changed(meta=np.array({"schema": 1}, dtype=object)), "torn or damaged: Object arrays"),
        (changed_meta(schema=4), "has the schema 4, but this version reads 1 to 3"),
        (changed(lift=None), "lift missing or unknown"),
        (changed_meta(operator=None), "lack or distort 'operator'"),
        (changed_meta(camera=5), "lack or distort"),
        (changed_meta(camera={"name": "x", "width": "wide", "height": 1}), "lack or distort"),
        (changed_meta(source="dream"), "source is 'dream'"),
        (changed_meta(configuration={"robot": "LBR14R820"}), "fingerprint is not that"),
        (changed(depth=None), "depth missing or unknown"),
        (changed(colour=np.zeros(3)), "colour missing or unknown"),
        (changed(depth=np.zeros((2, 12, 12), np.float32)), "array depth is float32"),
        (changed(depth=np.zeros((3, 12, 12), np.uint16)), "array depth is uint16, shape (3, 12, 12)"),
        (changed(crop=np.array([0, 0, 13], np.int32)), "do not belong together"),
        (changed(maps=np.zeros((2, 4, 7, 7), np.float16)), "do not belong together"),
        (changed(mean=np.array([1.0, np.nan], np.float32)), "mean holds values that are not finite"),
        (changed(mean=np.array([0.9, 900.0], np.float32)), "mean depth of an image is 900 m: it was not in metres"),
        (changed(T_flange_tool=pose(p=(0.0, 0.0, 106.0))), "its distance is 106 m, but must be at most 10 m"),
        (changed(stamp=np.array([101.0, 100.0])), "stamps do not rise"),
        (changed(stamp=np.array([101.0, 500.0])), "stamps do not rise"),
        (changed(T_tool_grasp=2.0 * np.eye(4)), "T_tool_grasp holds no pose"),
        (changed(T_base_tool_shown=np.eye(4)), "T_base_grasp is not the grasp of the tool that labels it"),
        (changed(T_base_tool_shown=None), "T_base_tool_shown missing or unknown"),
        (changed(T_base_camera=np.full((2, 4, 4), np.nan)), "T_base_camera holds values that are not finite"),
        (changed(T_base_grasp=np.eye(4)), "T_base_grasp is not the grasp"),
    ],
)
def test_what_is_no_episode_is_refused_with_a_sentence(data, sentence):
    with pytest.raises(DatasetError) as refusal:
        decode(data)
    assert sentence in str(refusal.value)
    assert str(refusal.value).endswith(".")


def test_an_episode_without_frames_is_none():
    framed = [name for name, (_, shape) in LAYOUT.items() if shape[:1] == ("n",)]
    with pytest.raises(DatasetError, match="no frame"):
        encode(replace(TINY, **{name: getattr(TINY, name)[:0] for name in framed}))
