"""Makes a training set of depth images with labelled grasps: Cornell's, Jacquard's, or your own (label_grasps.py).

It writes shards as make_dataset.py does, so both may lie in one folder. All images of one thing fall into the same
split, which depends on its name alone. Images and label files that cannot be used are named and left out.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from pathlib import Path

from tqdm import tqdm

from common.errors import RigError
from grasping.lab.dataset.labelled_images import LabelledImage, read, sample
from grasping.lab.programs.make_dataset import SHARD, write_shard
from grasping.lab.synthetic.samples import LabelSettings, Sample
from grasping.network.depth_image import CROP_SIDE
from grasping.network.maps import HANDS, PARALLEL


def split(image: LabelledImage, validation: float) -> str:
    """Returns "validation" for so large a fraction of all things, else "train"."""
    number = int.from_bytes(hashlib.sha256(image.thing.encode()).digest()[:4], "big")
    return "validation" if number < validation * 2**32 else "train"


class Shards:
    """Files of at most SHARD samples each, called after the number of samples before them; older ones go."""

    def __init__(self, folder: Path, name: str, hand: str) -> None:
        self._folder, self._name, self._settings = folder, name, LabelSettings(hand)
        self._samples: list[Sample] = []
        self.written = 0
        for old in folder.glob(f"{name}_*.npz"):
            old.unlink()

    def add(self, sample: Sample) -> None:
        """Takes a sample; writes a shard that is full."""
        self._samples.append(sample)
        if len(self._samples) == SHARD:
            self.write()

    def write(self) -> None:
        if self._samples:
            write_shard(self._folder / f"{self._name}_{self.written:06d}.npz", self._samples, self._settings)
            self.written += len(self._samples)
            self._samples = []


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("source", type=Path, help="folder of the labelled images")
    parser.add_argument("folder", type=Path, help="where the shards go")
    parser.add_argument("--name", default="own", help="of these shards, to tell them from others in the folder")
    parser.add_argument("--validation", type=float, default=0.2, help="fraction of the things for validation")
    parser.add_argument("--hand", choices=HANDS, default=PARALLEL, help=f"that they are for, default {PARALLEL}")
    side_help = f"side of the window about an image's grasps [px], default {CROP_SIDE}; Jacquard: 1024"
    parser.add_argument("--window", type=int, default=CROP_SIDE, help=side_help)
    arguments = parser.parse_args()
    if not 0.0 <= arguments.validation < 1.0:
        parser.error(f"--validation is {arguments.validation:g} and must be at least 0 and below 1.")
    if arguments.window < 1:
        parser.error(f"--window is {arguments.window} and must be at least 1 pixel.")
    if not arguments.name.isidentifier():
        parser.error(f"--name is {arguments.name!r} and must be a word of letters, digits and underscores.")
    shards: dict[str, Shards] = {}
    things = set()
    try:
        images, left_out = read(arguments.source)
        for sentence in left_out:
            sys.stderr.write(f"Left out: {sentence}\n")
        for image in tqdm(images, unit="image"):
            try:
                found = sample(image, arguments.window)
            except RigError as error:
                sys.stderr.write(f"Left out: {error}\n")
                left_out.append(str(error))
                continue
            if not shards:  # not before: the older ones go
                arguments.folder.mkdir(parents=True, exist_ok=True)
                for kind in ("train", "validation"):
                    shards[kind] = Shards(arguments.folder, f"{kind}_{arguments.name}", arguments.hand)
            things.add(image.thing)
            shards[split(image, arguments.validation)].add(found)
        if not shards:
            raise RigError(f"None of the {len(images)} labelled images in {arguments.source} can be used: no shard.")
        for one in shards.values():
            one.write()
    except RigError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"{error.filename or arguments.folder}: {error.strerror}.")
    counts = [one.written for one in shards.values()]
    text = f"{counts[0]} images for training, {counts[1]} for validation, of {len(things)} things"
    sys.stdout.write(text + (f"; {len(left_out)} left out.\n" if left_out else ".\n"))
    if not all(counts):
        sys.stdout.write("Training needs both: label more things, or change --validation.\n")
