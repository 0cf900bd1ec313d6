"""The environments for pip and for conda hold the same packages."""

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
