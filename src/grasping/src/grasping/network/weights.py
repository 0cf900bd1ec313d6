"""Weight files of the grasp networks: this package's and the published ones. No code in a file is run.

Read are torch state dicts, whole pickled torch models and Keras HDF5 files. A file says by the names and shapes of its
arrays which network it belongs to; nothing is guessed or cut to fit.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import pickle
import tarfile
import types
import warnings
from collections import OrderedDict
from collections.abc import Iterator
from typing import IO, Any, NamedTuple, TypeVar

import h5py
import numpy as np
import torch
from torch import nn

from common.errors import RigError
from grasping.network.maps import HANDS, PARALLEL
from grasping.network.networks import NETWORKS

KNOWN = {"07ed61da2f5b5aa5d8d10a85c0a26023bae489c3b15fe16e58227c14738a3770": "GG-CNN, RSS 2018, Keras"}
"""Published files by their SHA-256."""
HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
ZIP_MAGIC = b"PK\x03\x04"
PICKLE_MAGIC = b"\x80"
WRAPPED = ("state_dict", "model_state_dict")  # where the checkpoints of training programs hold the weights
PARALLEL_PREFIX = "module."  # of the names of a network that several devices trained
PROGRAM = "constants.pkl"  # record that marks a TorchScript archive, whose code torch would run while reading
SAME_PADDING = "same_padding"  # array that marks a torch file of a GG-CNN with the borders of the Keras one
HAND = "hand"  # array that holds the number of the hand in `HANDS`; without it the hand is parallel
KERAS_LAYERS = {  # layers of the Keras file and what they are called here
    **{f"conv2d_{i}": f"conv{i}" for i in (1, 2, 3)},
    **{f"conv2d_transpose_{i}": f"convt{i}" for i in (1, 2, 3)},
    **{f"{name}_out": f"{name}_output" for name in ("pos", "cos", "sin", "width")},
}
REBUILDERS = {  # all that a pickled model may call; whatever else it names becomes an empty stub
    ("collections", "OrderedDict"): OrderedDict,
    ("torch._utils", "_rebuild_tensor"): torch._utils._rebuild_tensor,
    ("torch._utils", "_rebuild_tensor_v2"): torch._utils._rebuild_tensor_v2,
    ("torch._utils", "_rebuild_parameter"): torch._utils._rebuild_parameter,
    ("torch", "FloatStorage"): torch.FloatStorage,
    ("torch", "LongStorage"): torch.LongStorage,
    ("torch.cuda", "FloatStorage"): torch.FloatStorage,
}
Network = TypeVar("Network", bound=nn.Module)


class WeightsError(RigError):
    """A weight file cannot be used."""


class Loaded(NamedTuple):
    """A network with the weights of a file."""

    network: nn.Module  # ready to be evaluated
    name: str  # of the network in `NETWORKS`
    sha256: str  # of the file, hexadecimal
    origin: str  # what the file is known to be, empty when it is not known
    hand: str = PARALLEL  # name in `HANDS` of the hand whose grasps it was trained on

    def mismatch(self, hand: str) -> str:
        """Returns one sentence if the weights are for another hand than `hand`, else an empty text."""
        if hand == self.hand:
            return ""
        return (
            f"The weights were trained on grasps of the hand {self.hand}, but the hand is {hand}: "
            "qualities and openings are not those of this hand."
        )


def load(data: bytes, sha256: str | None = None) -> Loaded:
    """Returns a weight file's network; raises WeightsError for another `sha256` (if given, hexadecimal), no weight
    file, or none of a network in `NETWORKS`.
    """
    found, hand = checked_sha256(data, sha256), PARALLEL
    if data.startswith(HDF5_MAGIC):
        name, state = "ggcnn_keras", _keras_state(data)
    elif data.startswith((ZIP_MAGIC, PICKLE_MAGIC)):
        state = torch_state(data)
        hand = _hand(state)
        name = _which(state)
    else:
        raise WeightsError("The weight file is neither a torch file nor a Keras HDF5 file.")
    return Loaded(filled(NETWORKS[name](), name, state), name, found, KNOWN.get(found, ""), hand)


def state_for_file(name: str, network: nn.Module, hand: str = PARALLEL) -> dict[str, torch.Tensor]:
    """Returns what a torch file of a network in `NETWORKS`, called `name`, for a hand in `HANDS` holds, so that `load`
    finds both.
    """
    state = {key: value.cpu() for key, value in network.state_dict().items()}
    if name == "ggcnn_keras":
        state[SAME_PADDING] = torch.ones(1)
    if hand != PARALLEL:
        state[HAND] = torch.full((1,), float(HANDS.index(hand)))
    return state


def checked_sha256(data: bytes, wanted: str | None) -> str:
    """Returns the content's SHA-256, hexadecimal; raises WeightsError if another one is wanted."""
    found = hashlib.sha256(data).hexdigest()
    if wanted is not None and found != wanted:
        raise WeightsError(f"The weight file has the SHA-256 {found}, but {wanted} was expected.")
    return found


def filled(network: Network, name: str, state: dict[str, torch.Tensor]) -> Network:
    """Returns the network with the weights of a state dict, ready to be evaluated. Raises WeightsError if the state
    dict is not of such a network, here called `name`, or not finite.
    """
    wanted = network.state_dict()
    if state.keys() != wanted.keys():
        raise WeightsError(f"The weight file lacks {', '.join(sorted(wanted.keys() - state.keys()))} of {name}.")
    for key, value in wanted.items():
        if state[key].shape != value.shape:
            found, shape = tuple(state[key].shape), tuple(value.shape)
            raise WeightsError(f"The array {key} has the shape {found} instead of {name}'s {shape}.")
    if not all(torch.isfinite(value).all() for value in state.values()):
        raise WeightsError("The weight file holds values that are not finite.")
    network.load_state_dict(state)
    return network.eval()


def listed_sha256(sums: str, name: str) -> str:
    """Returns the hash of a file in a `sha256sum` list; raises WeightsError if the list does not name it."""
    for line in sums.splitlines():
        found, _, file = line.partition("  ")
        if file == name:
            return found
    raise WeightsError(f"The list of hashes does not name {name}.")


def _hand(state: dict[str, torch.Tensor]) -> str:
    """Returns the hand that the state dict names; takes its mark out."""
    mark = state.pop(HAND, torch.zeros(1))
    for number, hand in enumerate(HANDS):
        if mark.shape == (1,) and float(mark) == number:
            return hand
    raise WeightsError(
        f"The weight file names the hand {mark.flatten()[:4].tolist()}; known are 0 to {len(HANDS) - 1}."
    )


def _which(state: dict[str, torch.Tensor]) -> str:
    """Returns the name of the network whose layers the state dict names; takes the mark of `SAME_PADDING` out."""
    if state.pop(SAME_PADDING, None) is not None:
        return "ggcnn_keras"
    for name in ("ggcnn", "ggcnn2"):
        if state.keys() == NETWORKS[name]().state_dict().keys():
            return name
    if {"features.14.weight", "features.16.weight"} <= state.keys():
        raise WeightsError("The weight file holds a GG-CNN2 from before July 2020, whose layers were others.")
    names = ", ".join(sorted(state)[:4])
    raise WeightsError(f"The weight file holds {len(state)} arrays ({names}, ...), which fit no known network.")


def _keras_state(data: bytes) -> dict[str, torch.Tensor]:
    """Returns the state dict of a Keras file; kernels go from (rows, columns, a, b) to (b, a, rows, columns)."""
    state = {}
    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            layers = file.get("model_weights", file)
            for theirs, ours in KERAS_LAYERS.items():
                arrays: dict[str, np.ndarray] = {}
                layers[theirs].visititems(lambda path, item, into=arrays: _collect(into, path, item))
                kernel = np.ascontiguousarray(arrays["kernel:0"].transpose(3, 2, 0, 1))
                state[f"{ours}.weight"] = torch.from_numpy(kernel)
                state[f"{ours}.bias"] = torch.from_numpy(arrays["bias:0"])
    except Exception as error:  # of a damaged file, HDF5 raises KeyError, OSError, RuntimeError, ...
        raise WeightsError(f"The Keras file does not hold GG-CNN's layers: {error}.") from error
    return state


def _collect(into: dict[str, np.ndarray], path: str, item: Any) -> None:
    if isinstance(item, h5py.Dataset):
        into[path.rsplit("/", 1)[-1]] = np.asarray(item, dtype=np.float32)


def torch_state(data: bytes) -> dict[str, torch.Tensor]:
    """Returns the state dict of a torch file, of the checkpoint or of the whole model in it. Raises WeightsError if it
    holds neither, or torch cannot read it with the pickle given here.
    """
    try:
        # Of the records asks torch's own reader: another one may see others in a malformed archive.
        if data.startswith(ZIP_MAGIC) and PROGRAM in torch._C.PyTorchFileReader(io.BytesIO(data)).get_all_records():
            raise WeightsError("it is a TorchScript program, not a state dict")
        with contextlib.suppress(tarfile.TarError), tarfile.open(fileobj=io.BytesIO(data)):
            raise WeightsError("it is a tar archive of a torch before 0.2")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # torch remarks that the model's source is not the stub's
            content = torch.load(io.BytesIO(data), map_location="cpu", pickle_module=_SAFE_PICKLE, weights_only=False)
    except Exception as error:  # a broken pickle may raise anything
        raise WeightsError(f"The torch file cannot be read: {error}.") from error
    content = next((content[key] for key in WRAPPED if isinstance(content, dict) and key in content), content)
    state = dict(content) if isinstance(content, dict) else dict(_arrays(content))
    if all(isinstance(key, str) and key.startswith(PARALLEL_PREFIX) for key in state):
        state = {key[len(PARALLEL_PREFIX) :]: value for key, value in state.items()}
    if not state or not all(isinstance(value, torch.Tensor) for value in state.values()):
        raise WeightsError("The torch file holds neither a state dict nor a model.")
    return {key: value.detach().float() for key, value in state.items()}


def _arrays(module: object, prefix: str = "") -> Iterator[tuple[str, torch.Tensor]]:
    """Yields the names and values of a stub's parameters and buffers, as `state_dict` names them."""
    if not isinstance(module, _Stub):
        return
    for kind in ("_parameters", "_buffers"):
        for name, value in module.__dict__.get(kind, {}).items():
            if value is not None:
                yield prefix + name, value
    for name, child in module.__dict__.get("_modules", {}).items():
        yield from _arrays(child, f"{prefix}{name}.")


class _Stub:
    """Stands for whatever a pickle names: takes all arguments, does nothing."""

    dump_patches = False

    def __new__(cls, *_: object, **__: object) -> _Stub:
        return super().__new__(cls)

    def __init__(self, *_: object, **__: object) -> None:
        pass

    def __setstate__(self, state: object) -> None:
        if isinstance(state, dict):
            self.__dict__.update(state)


class _SafeUnpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        return REBUILDERS.get((module, name), _Stub)


def _safe_load(file: IO[bytes], **options: Any) -> Any:
    return _SafeUnpickler(file, **options).load()


_SAFE_PICKLE = types.SimpleNamespace(__name__="safe_pickle", Unpickler=_SafeUnpickler, load=_safe_load)
