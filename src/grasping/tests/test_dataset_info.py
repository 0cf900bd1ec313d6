"""What dataset_info.py tells of a folder."""

import sys

import numpy as np
import pytest
from episodes import episode, metadata

from common.poses import translation
from grasping.lab.dataset.labels import own_grasp
from grasping.lab.dataset.store import encode
from grasping.lab.programs import dataset_info


@pytest.fixture
def folder(tmp_path):
    """Three episodes of two objects, one of them below."""
    made = {
        "episode_1": episode(),
        "episode_2": episode(held=False),
        "below/episode_3": episode(2, metadata=metadata(object="box", date="2026-02-02T00:00:00Z")),
    }
    (tmp_path / "below").mkdir()
    for name, one in made.items():
        (tmp_path / f"{name}.npz").write_bytes(encode(one))
    return tmp_path


@pytest.fixture
def info(folder, monkeypatch, capsys):
    def run(*arguments, of=folder):
        """Returns exit code and output."""
        monkeypatch.setattr(sys, "argv", ["dataset_info.py", str(of), *arguments])
        with pytest.raises(SystemExit) as end:
            dataset_info.main()
        return end.value.code, "".join(capsys.readouterr())

    return run


def test_objects_frames_and_the_fraction_that_was_held_are_reported(info):
    code, text = info("--check")
    assert code == 0
    lines = {line.split()[0]: line.split() for line in text.splitlines() if line}
    assert lines["cup"][1:4] == ["2", "6", "50"]
    assert lines["box"][1:4] == ["1", "2", "100"]
    assert lines["all"][1:4] == ["3", "8", "67"]
    assert lines["all"][7:9] == ["2026-01-02T03:04:05Z", "2026-02-02T00:00:00Z"]
    assert episode().metadata.fingerprint[: dataset_info.SHORT] in lines


def test_damaged_files_are_named_and_left_out(info, folder):
    (folder / "episode_4.npz").write_bytes(encode(episode())[:1000])
    (folder / "episode_5.npz").write_bytes(b"no archive")
    (folder / ".episode_6.npzabcdefgh").write_bytes(b"")
    (folder / "episode_7.npz.discarded").write_bytes(encode(episode()))
    (folder / "notes.txt").write_text("not of the dataset")
    for check in ([], ["--check"]):
        code, text = info("--episodes", *check)
        assert code == len(check)
        assert f"{folder}/episode_4.npz: The file is torn or damaged" in text
        assert f"{folder}/episode_5.npz: Not an episode" in text
        assert f"{folder}/.episode_6.npzabcdefgh: the process that wrote it died" in text
        assert "notes" not in text and "discarded" not in text
        assert [line.split()[0] for line in text.splitlines() if line.startswith("episode_")] == [
            "episode_3", "episode_1", "episode_2",
        ]  # fmt: skip


def test_another_rig_is_named_with_what_differs(info, folder):
    other = metadata(configuration={"robot": "LBR14R820", "tool": [0.0, 0.106]})
    (folder / "episode_4.npz").write_bytes(encode(episode(metadata=other)))
    code, text = info("--check")
    assert code == 1 and "2 configurations of the rig" in text
    (line,) = (line for line in text.splitlines() if line.startswith(other.fingerprint[: dataset_info.SHORT]))
    assert line.split()[1:] == ["1", "robot"]


def test_the_image_is_drawn(info, folder):
    code, text = info("--plot", str(folder / "image.png"))
    assert code == 0, text
    assert (folder / "image.png").read_bytes().startswith(b"\x89PNG")
    code, text = info("--plot", str(folder / "image.xyz"))
    assert code == 2 and "cannot be written" in text and "Traceback" not in text


def test_a_folder_without_episodes_is_said(info, tmp_path):
    (tmp_path / "empty").mkdir()
    assert info(of=tmp_path / "empty") == (1, f"{tmp_path}/empty holds no episode.\n")
    code, text = info(of=tmp_path / "absent")
    assert code == 2 and "is not a folder" in text


def test_the_offset_is_zero_where_the_person_grasps_as_ggcnn_proposes():
    one = episode(1)
    frame = one.frame(0)
    T = frame.T_base_camera @ own_grasp(frame).T_camera_grasp @ translation(0.01, 0.0, 0.0)
    (offset,) = dataset_info.offsets(episode(1, T_tool_grasp=np.eye(4), T_base_tool_closed=T))
    np.testing.assert_allclose(offset.position, (0.01, 0.0, 0.0), atol=1e-9)
    np.testing.assert_allclose((offset.angle, offset.tilt), 0.0, atol=1e-9)


def test_episodes_whose_grasps_have_no_place_are_complained_of():
    blind = episode(2)
    blind = episode(2, depth=np.zeros_like(blind.depth))
    (sentence,) = dataset_info.complaints([dataset_info.entry("episode_1", 1, blind)])
    assert sentence == "episode_1 has no frame in which both grasps have a pose."


def test_differences_name_what_differs_inside():
    a = {"kuka": {"robot": "a", "flange": "f"}, "weights": "w"}
    b = {"kuka": {"robot": "b", "flange": "f"}, "crop": [1]}
    assert dataset_info.differences(a, b) == ["crop", "kuka/robot", "weights"]
