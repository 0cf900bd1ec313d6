"""Weight files and the node's own yaml files, read from this package or from where the parameters say."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import rospkg
import yaml

from common.errors import RigError
from grasping.network import weights
from grasping.network.weights import Loaded, WeightsError, checked_sha256, listed_sha256
from grasping.pipeline.settings import ANY, AUTO, LISTED, NetworkConfig
from grasping.poses import lift_network, taste_file
from grasping.poses.lift_network import LiftNetwork
from grasping.poses.taste import PoseTaste
from grasping.poses.taste_file import Origin

SUMS = "SHA256SUMS"


def package_folder() -> Path:
    """Returns where this package's config and weights are."""
    return Path(rospkg.RosPack().get_path("grasping"))


def own_yaml(name: str) -> dict[str, Any]:
    return yaml.safe_load((package_folder() / "config" / name).read_text(encoding="utf-8"))


def load_network(config: NetworkConfig) -> Loaded:
    """Returns the configured network; raises RigError if the file is missing or has another hash or kind of network."""
    path = _path(config.weights)
    data, expected = _content(path), config.sha256
    if expected == LISTED:
        expected = _listed(path)
    loaded = weights.load(data, None if expected == ANY else expected)
    if config.kind not in (ANY, loaded.name):
        raise WeightsError(f"{path} holds weights of {loaded.name}, but network/kind is {config.kind}.")
    return loaded


def load_refinement(name: str, rig: Origin) -> Mapping[str, PoseTaste]:
    """Returns the tastes in a weight file by kind of object; one of this package must have the hash in its list.
    Raises RigError if it is missing, has another hash, holds something else, or was not learned on such a rig.
    """
    path = _path(name)
    if not name.startswith("/") and not path.exists():
        raise RigError(
            f"No refinement {path}; none comes with the package. Train one on an operator's grasps with "
            "train_refinement.py and set refinement_weights to its weights.pt."
        )
    kinds, origin = taste_file.load(_content(path), None if name.startswith("/") else _listed(path))
    mismatch = origin.mismatch(rig)
    if mismatch:
        raise WeightsError(f"The refinement in {path} was {mismatch}. Train one on episodes of this rig.")
    return kinds


class LoadedLifts(NamedTuple):
    """A network of lifts, or why it is missing."""

    network: LiftNetwork | None
    sha256: str  # of its file, hexadecimal
    why: str  # it is missing, a sentence


def load_lifts(name: str, wanted: str, hand: str, ggcnn: str) -> LoadedLifts:
    """Returns the network of lifts in a weight file, checked as that of `load_refinement`; `name`: of the file, empty:
    the hand's own; `ggcnn`: SHA-256 of GG-CNN's file. If the file is missing or made for another hand or GG-CNN, raises
    RigError, but returns why if `wanted` is AUTO.
    """
    name = name or f"lifts_{hand}.pt"
    path = _path(name)
    try:
        data = _content(path)
        sha256 = checked_sha256(data, None if name.startswith("/") else _listed(path))
        found = lift_network.loaded(data)
        if (found.hand, found.ggcnn) != (hand, ggcnn):
            made_for, here = f"{found.hand} and the GG-CNN {found.ggcnn[:12]}", f"{hand} and {ggcnn[:12]}"
            raise WeightsError(f"The network of lifts in {path} was made for the hand {made_for}, not for {here}.")
    except RigError as error:
        if wanted != AUTO:
            raise
        return LoadedLifts(None, "", str(error))
    return LoadedLifts(found, sha256, "")


def _listed(path: Path) -> str:
    """Returns the hash that the list beside a file says it has."""
    return listed_sha256(_content(path.parent / SUMS).decode("utf-8", "replace"), path.name)


def _path(name: str) -> Path:
    return Path(name) if name.startswith("/") else package_folder() / "weights" / name


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise RigError(f"The file {path} cannot be read: {error.strerror}.") from None
