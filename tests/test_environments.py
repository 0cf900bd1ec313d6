"""The environments for pip and for conda hold the same packages, and so do the lists for Debian and for Noetic."""

from __future__ import annotations

from pathlib import Path

import yaml

ROOT = Path(__file__).parents[1]


def pins(name: str) -> list[str]:
    lines = (line.split("#")[0].strip() for line in (ROOT / name).read_text().splitlines())
    return [line for line in lines if line]


def test_conda_has_what_pip_has():
    dependencies = yaml.safe_load((ROOT / "env" / "environment.yaml").read_text())["dependencies"]
    of_pip = next(entry["pip"] for entry in dependencies if isinstance(entry, dict))
    assert sorted(of_pip) == sorted(pins("requirements.txt") + pins("requirements-dev.txt"))


def test_noetic_has_what_debian_has():
    wanted, served = pins("apt-packages.txt"), []
    for line in (ROOT / "apt-packages-noetic.txt").read_text().splitlines():
        name, _, stands_for = line.partition("# in place of ")
        if name.strip() and not name.startswith("#"):
            served += stands_for.split(", ") if stands_for else [name.strip()]
    assert sorted(served) == sorted(wanted)
