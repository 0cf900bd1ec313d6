"""A file is written whole or not at all."""

import errno
import os

import pytest

from common.errors import ConfigError
from common.ros.files import read_text, read_yaml, write_whole


def test_what_was_there_is_replaced_and_folders_are_made(tmp_path):
    path = tmp_path / "a" / "b" / "file.yaml"
    for text in ("first: 1\n", "second: ä\n"):
        write_whole(path, text)
        assert path.read_text(encoding="utf-8") == text
    assert os.listdir(path.parent) == ["file.yaml"]
    assert path.stat().st_mode & 0o777 == 0o644


@pytest.mark.parametrize("step", ["fsync", "replace"])
def test_on_a_full_disk_the_old_file_stays_and_nothing_else(tmp_path, monkeypatch, step):
    path = tmp_path / "file.yaml"
    write_whole(path, "old")

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, step, full)
    with pytest.raises(OSError, match="No space left"):
        write_whole(path, "new")
    assert path.read_text() == "old" and os.listdir(tmp_path) == ["file.yaml"]


@pytest.mark.parametrize("text", ["%YAML:1.0\n---\ncamera_name: x\n", "a: [1,", "\tb: 1", "a: 1\na: 2\n", "a: 0x_"])
def test_a_file_that_is_no_yaml_is_named(tmp_path, text):
    """The first is what OpenCV's FileStorage writes.

    Reported in https://github.com/NVIDIA-AI-IOT/redtail/issues/52: OpenCV's own files begin with `%YAML:1.0`.
    Tried: such a file.
    """
    (tmp_path / "file.yaml").write_text(text)
    with pytest.raises(ConfigError, match="file.yaml is not yaml"):
        read_yaml(tmp_path / "file.yaml")


WINDOWS = {
    "line ends": lambda text: text.replace("\n", "\r\n").encode(),
    "old line ends": lambda text: text.replace("\n", "\r").encode(),
    "a byte order mark": lambda text: b"\xef\xbb\xbf" + text.encode(),
    "PowerShell's UTF-16": lambda text: text.replace("\n", "\r\n").encode("utf-16"),
    "UTF-16, big endian": lambda text: b"\xfe\xff" + text.encode("utf-16-be"),
}
TEXT = "name: Prüfstand  # of the camera\nsize: [640, 480]\nat: {x: 0.1}\n"


@pytest.mark.parametrize("how", WINDOWS)
@pytest.mark.parametrize("blanks", ["", "  ", " \t", "\t"])
def test_a_text_from_windows_is_the_same(tmp_path, how, blanks):
    path = tmp_path / "FILE.YAML"
    path.write_bytes(WINDOWS[how](TEXT.replace("\n", f"{blanks}\n")))
    assert read_text(path) == TEXT
    assert read_yaml(path) == {"name": "Prüfstand", "size": [640, 480], "at": {"x": 0.1}}


def test_a_file_of_blanks_is_read_in_time_that_grows_with_its_size(tmp_path):
    """An expression that seeks the end of the line from each blank takes hours."""
    path = tmp_path / "blanks.txt"
    path.write_text(f"a{' ' * 2_000_000}b \t\r\nc")
    assert read_text(path) == f"a{' ' * 2_000_000}b\nc"


@pytest.mark.parametrize("content", ["name: Prüfstand".encode("latin-1"), b"\0\1\2\xff", b"\xff\xfea"])
def test_what_is_no_text_is_named(tmp_path, content):
    (tmp_path / "file.yaml").write_bytes(content)
    with pytest.raises(ConfigError, match="file.yaml is not yaml"):
        read_yaml(tmp_path / "file.yaml")
