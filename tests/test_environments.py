"""Conda has the packages of pip, Noetic those of Debian, and the container takes the lists of the set-up."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
CONTAINERFILE = (ROOT / "Containerfile").read_text()
INSTRUCTIONS = [line.split() for line in CONTAINERFILE.replace("\\\n", " ").splitlines() if re.match(r"[A-Z]+ ", line)]


def pins(name: str) -> list[str]:
    lines = (line.split("#")[0].strip() for line in (ROOT / name).read_text().splitlines())
    return [line for line in lines if line]


def test_conda_has_what_pip_has():
    dependencies = yaml.safe_load((ROOT / "env" / "environment.yaml").read_text())["dependencies"]
    of_pip = next(entry["pip"] for entry in dependencies if isinstance(entry, dict))
    assert sorted(of_pip) == sorted(pins("requirements.txt") + pins("requirements-dev.txt"))


def test_python_38_has_what_is_needed_elsewhere_each_package_in_one_release():
    known = pins("requirements-noetic.txt")
    assert all(re.fullmatch(r"[\w.-]+==[\w.]+", pin) for pin in known)
    elsewhere = pins("requirements.txt") + pins("requirements-dev.txt")
    assert not {pin.lower().split("==")[0] for pin in elsewhere} - {pin.split("==")[0] for pin in known}


def test_what_few_need_has_a_list_and_a_command_of_its_own():
    recipes = (ROOT / "Makefile").read_text()
    usual = pins("requirements.txt") + pins("requirements-dev.txt") + pins("requirements-webcam.txt")
    for command, package in {"objects": "pybullet", "lerobot": "lerobot"}.items():
        recipe = re.search(rf"^{command}:.*\n((?:\t.*\n)+)", recipes, re.M)
        assert recipe and f"-r requirements-{command}.txt" in recipe[1]
        assert package in {pin.split("==")[0] for pin in pins(f"requirements-{command}.txt")}
        assert package not in {pin.split("==")[0] for pin in usual}


def test_noetic_has_what_debian_has():
    wanted, served = pins("apt-packages.txt"), []
    for line in (ROOT / "apt-packages-noetic.txt").read_text().splitlines():
        name, _, stands_for = line.partition("# in place of ")
        if name.strip() and not name.startswith("#"):
            served += stands_for.split(", ") if stands_for else [name.strip()]
    assert sorted(served) == sorted(wanted)


def arguments(instruction: str) -> list[list[str]]:
    return [words for name, *words in INSTRUCTIONS if name == instruction]


@pytest.mark.parametrize("words", arguments("COPY"), ids=" ".join)
def test_what_is_copied_is_there_and_not_ignored(words):
    ignored = (ROOT / ".containerignore").read_text().split()
    sources = [word for word in words[:-1] if not word.startswith("--")]
    assert sources
    for source in sources:
        assert (ROOT / source).exists()
        assert source not in ignored


def test_an_image_gets_nothing_that_git_ignores():
    ignored = {line.replace("**/", "") for line in (ROOT / ".containerignore").read_text().splitlines()}
    assert {line.strip("/") for line in (ROOT / ".gitignore").read_text().splitlines()} <= ignored


def test_packages_come_from_the_lists_of_the_set_up_alone():
    packages = {*pins("apt-packages.txt"), *(pin.split("==")[0] for pin in pins("requirements.txt"))}
    words = {word for command in arguments("RUN") for word in command}
    assert not words & packages
    assert {"install_packages", "make_environment"} <= words


def test_docker_and_podman_ignore_the_same():
    assert (ROOT / ".dockerignore").resolve() == ROOT / ".containerignore"


def test_nothing_runs_as_root_or_with_all_rights():
    users = [words[0] for name, *words in INSTRUCTIONS if name == "USER"]
    assert users and "root" not in users
    handbook = ROOT / "docs" / "handbook"
    pages = [ROOT / "README.md", handbook / "installation.md", handbook / "installation-elsewhere.md"]
    assert not any("--privileged" in page.read_text() for page in pages)


def test_the_development_container_is_a_stage_of_the_same_file():
    folder = ROOT / ".devcontainer"
    settings = json.loads((folder / "devcontainer.json").read_text())
    build = settings["build"]
    assert (folder / build["dockerfile"]).resolve() == ROOT / "Containerfile"
    assert (folder / build["context"]).resolve() == ROOT
    assert build["target"] in {words[-1] for words in arguments("FROM") if "AS" in words}
    assert settings["remoteUser"] in {words[0] for words in arguments("USER")}
