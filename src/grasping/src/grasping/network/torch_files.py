"""Files of networks that torch wrote, read without executing what is in them; what is no such file is refused in a part
of a sentence."""

from __future__ import annotations

import io
from typing import Any

import torch
from torch import nn

from common.errors import RigError


def content_of(data: bytes, **of: int) -> dict[str, Any]:
    """Returns the mapping in a file that has these numbers; raises RigError for any other file."""
    try:
        content = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except Exception as error:  # its unpickler raises anything, and a page that advises to execute the file
        raise RigError("it is torn, or not a file of torch's numbers") from error
    if not isinstance(content, dict):
        raise RigError(f"it holds a {type(content).__name__}, not a mapping")
    for name, wanted in of.items():
        found = content.get(name)
        if not isinstance(found, int) or found != wanted:
            raise RigError(f"its {name} is {found!r:.40}, not {wanted}")
    return content


def give(network: nn.Module, state: Any) -> None:
    """Gives a network the numbers of a file; raises RigError if they are those of another one, or not finite."""
    try:
        network.load_state_dict(state)
    except Exception as error:  # whatever stands there instead; torch's text is a list of shapes
        raise RigError("its numbers are those of another network") from error
    if not all(bool(torch.isfinite(one).all()) for one in network.state_dict().values()):
        raise RigError("its numbers are not all finite")
