"""What Python 3.8 lacks is found by types, and nothing else is."""

from __future__ import annotations

import pytest

from tools.python38 import FOLDERS, ROOT, missing_in_38

MISSING = """
def joined(a: dict[str, int], b: dict[str, int]) -> dict[str, int]: return a | b  #
def grown(a: dict[str, int]) -> None: a |= {"b": 1}  #
def cut(name: str) -> str: return name.removeprefix("a")  #
def pairs(a: list[int]) -> None: list(zip(a, a, strict=True))  #
def inside(a: pathlib.Path) -> bool: return a.is_relative_to("/")  #
def is_tar(data: bytes) -> bool: return tarfile.is_tarfile(io.BytesIO(data))  #
print(math.lcm(1, 2), os.pidfd_open(1), itertools.pairwise([1]), datetime.UTC)  #
from functools import cache  #
import zoneinfo  #
def bare(): return "a".removesuffix("a")  #
import io, math, pathlib, tarfile, itertools, os, datetime
untyped = {"a": 1}.nonsense + no_such_name
def sets(a: set[int], b: set[int]) -> set[int]: return a | b
"""


@pytest.mark.real
def test_finds_what_is_newer_and_no_other_fault(tmp_path):
    file = tmp_path / "newer.py"
    file.write_text("from __future__ import annotations\n" + MISSING)
    lines = [number for number, line in enumerate(file.read_text().splitlines(), 1) if line.endswith("#")]
    assert sorted({int(line.split(":")[1]) for line in missing_in_38([file])}) == lines


@pytest.mark.real
def test_says_so_if_mypy_cannot_read_the_files(tmp_path):
    with pytest.raises(RuntimeError, match="could not check"):
        missing_in_38([tmp_path / "absent.py"])


def test_looks_at_all_folders_with_python():
    made = {"build", "devel", "logs", "site"}
    folders = {f.name for f in ROOT.iterdir() if f.is_dir() and f.name.isalpha() and next(f.glob("**/*.py"), None)}
    assert folders - made == {*FOLDERS, "cad", "integrations"}, "those have environments of their own"
