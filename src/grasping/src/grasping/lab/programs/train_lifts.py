"""Trains the network of lifts on the shards of make_attempts.py; minutes on a processor. The temperature, which makes
its output a probability, is found on the validation's grasps that a network of lifts chose, where there are any: of
many hypotheses the best one is overrated."""

from __future__ import annotations

import argparse
import copy
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from zipfile import BadZipFile

import numpy as np
import torch
from torch import nn
from tqdm import tqdm

from common.command_line import real, whole
from common.errors import RigError
from grasping.lab.evaluation.trials import CROP, camera
from grasping.lab.programs.make_attempts import BELIEVED
from grasping.lab.programs.train_refinement import read_episodes
from grasping.lab.training.lift_examples import attempt
from grasping.network.depth_image import NetworkImage
from grasping.network.maps import PARALLEL
from grasping.poses import hand_view
from grasping.poses.candidates import image_rays, level_frame
from grasping.poses.gripper import GRIPPER, Gripper
from grasping.poses.hypotheses import Hypotheses
from grasping.poses.lift_network import LiftNetwork, saved


class LiftData(NamedTuple):
    """n attempts."""

    features: np.ndarray  # shape (n, FEATURES), float32
    lifted: np.ndarray  # shape (n,), float32, 0 or 1
    hand: str  # that tried them
    ggcnn: str  # SHA-256 of the file of GG-CNN, whose maps the features are of
    gripper: Gripper  # what the hand is like


def read(paths: Sequence[Path]) -> LiftData:
    """Returns the attempts of shards. Raises OSError, KeyError or ValueError."""
    parts, lifted, origins = [], [], set()
    for path in tqdm(paths, unit="shard", desc="features"):
        with np.load(path, allow_pickle=False) as arrays:
            gripper = Gripper(*arrays["gripper"].tolist()) if "gripper" in arrays else GRIPPER
            origins.add((str(arrays["hand"]), str(arrays["ggcnn"]), gripper))
            for i, counted in enumerate(arrays["depth"]):
                of = arrays["image"] == i
                if not of.any():
                    continue
                depth = 1e-4 * counted.astype(np.float32)
                image = NetworkImage(CROP, depth, depth, arrays["valid"][i], float(depth.mean()))
                tried = Hypotheses(arrays["T"][of], arrays["opening"][of], arrays["seen"][of])
                frame = level_frame(image, image_rays(image, camera()))
                parts.append(hand_view.features(tried, image, camera(), frame, gripper))
                lifted.append(arrays["reason"][of] == 0)
    if len(origins) > 1:
        raise ValueError(f"they are of several hands or of several GG-CNN: {origins}.")
    return LiftData(np.concatenate(parts), np.concatenate(lifted).astype(np.float32), *origins.pop())


def with_episodes(data: LiftData, folders: Sequence[Path]) -> LiftData:
    """Returns the attempts with those of a rig's episodes in and below folders; raises RigError for a folder without
    episodes of grasps on the same GG-CNN's maps."""
    for folder in folders:
        own = [
            one
            for one in (attempt(n.episode, data.ggcnn, data.gripper) for n in read_episodes(folder))
            if one is not None
        ]
        if not own:
            raise RigError(f"{folder} holds no grasp that was tried with the GG-CNN {data.ggcnn[:12]}...")
        values, held = zip(*own)
        lifted = np.concatenate([data.lifted, np.array(held, np.float32)])
        data = data._replace(features=np.concatenate([data.features, values]), lifted=lifted)
    return data


def train(data: LiftData, validation: LiftData, epochs: int, rate: float, seed: int) -> tuple[LiftNetwork, list[dict]]:
    """Returns the network of the epoch that validates best, and each epoch's losses."""
    batch, decay = 256, 1e-3
    rng = np.random.default_rng(seed)
    torch.manual_seed(seed)
    network = LiftNetwork(data.hand, data.ggcnn, data.gripper)
    optimiser = torch.optim.AdamW(network.parameters(), lr=rate, weight_decay=decay)
    steps = epochs * -(-len(data.lifted) // batch)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, total_steps=steps)
    loss_of = nn.BCEWithLogitsLoss()
    known, wanted = torch.from_numpy(validation.features), torch.from_numpy(validation.lifted)
    best = copy.deepcopy(network)
    rows: list[dict] = []
    for epoch in tqdm(range(epochs), unit="epoch"):
        network.train()
        losses = []
        for chosen in np.array_split(rng.permutation(len(data.lifted)), -(-len(data.lifted) // batch)):
            across, along = bool(rng.integers(2)), bool(rng.integers(2))
            # Exchanging unlike fingers makes another hand.
            mirrored = hand_view.mirrored(data.features[chosen], across and data.hand == PARALLEL, along)
            noisy = mirrored + rng.normal(0.0, 0.05, mirrored.shape)
            optimiser.zero_grad()
            loss = loss_of(network(torch.from_numpy(noisy.astype(np.float32))), torch.from_numpy(data.lifted[chosen]))
            loss.backward()
            optimiser.step()
            schedule.step()
            losses.append(loss.item())
        network.eval()
        with torch.no_grad():
            found = float(loss_of(network(known), wanted))
        if found < min((row["validation"] for row in rows), default=np.inf):
            best = copy.deepcopy(network)
        rows.append({"epoch": epoch + 1, "training": float(np.mean(losses)), "validation": found})
    return best.eval(), rows


def calibrate(network: LiftNetwork, data: LiftData) -> None:
    """Sets the temperature to that of the least loss."""
    wanted = torch.from_numpy(data.lifted)
    with torch.no_grad():
        logits = network(torch.from_numpy(data.features))
        tried = torch.linspace(0.5, 3.0, 51)
        losses = [float(nn.functional.binary_cross_entropy_with_logits(logits / t, wanted)) for t in tried]
        network.temperature.copy_(tried[int(np.argmin(losses))])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="folder of the shards train_*.npz and validation_*.npz")
    parser.add_argument("run", type=Path, help="folder for lifts.pt and curves.json")
    more = "a folder of episodes, whose grasps are further attempts"
    parser.add_argument("--episodes", type=Path, action="append", default=[], help=more)
    parser.add_argument("--epochs", type=whole(1, 10_000), default=40, help="default 40")
    parser.add_argument("--rate", type=real(0.0, 1.0, open_low=True), default=2e-3, help="of learning, default 0.002")
    parser.add_argument("--seed", type=whole(0, 2**32 - 1), default=0, help="default 0")
    trusts = "probability of a lift above which GG-CNN's own grasp is taken, default 1: never"
    parser.add_argument("--trusts", type=real(0.0, 1.0), default=1.0, help=trusts)
    given = parser.parse_args()
    torch.set_num_threads(1)
    used, kept = (
        sorted(path for path in given.data.glob(f"{name}_*.npz") if ".part." not in path.name)
        for name in ("train", "validation")
    )
    believed = [path for path in kept if BELIEVED in path.name]
    if not kept or not used:
        parser.error(f"{given.data} needs shards train_*.npz and validation_*.npz.")
    try:
        given.run.mkdir(parents=True, exist_ok=True)
        data, validation = with_episodes(read(used), given.episodes), read(kept)
        chosen = read(believed) if believed else validation
    except RigError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"{error.filename or given.data} cannot be used: {error.strerror}.")
    except (KeyError, ValueError, EOFError, BadZipFile) as error:
        parser.error(f"A file in {given.data} is no shard of make_attempts.py: {error}")
    if data[2:] != validation[2:]:
        parser.error(f"{given.data} trains on {data[2:]}, but validates on {validation[2:]}.")
    network, rows = train(data, validation, given.epochs, given.rate, given.seed)
    calibrate(network, chosen)
    network.trusts = given.trusts
    torch.save(saved(network), given.run / "lifts.pt")
    (given.run / "curves.json").write_text(json.dumps(rows, indent=1) + "\n")
    least = min(row["validation"] for row in rows)
    sys.stdout.write(f"validation loss {least:.4f}, temperature {float(network.temperature):.2f}\n")
