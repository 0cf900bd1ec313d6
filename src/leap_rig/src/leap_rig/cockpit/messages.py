"""What a page of the cockpit may send on /control: JSON, one command in a message. Everything else is refused."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from common.episode_marks import MARKS
from kuka_control.numbers import SCALING_MAX, SCALING_MIN
from leap_kuka.arm_choice import BOTH
from leap_rig.cockpit.control import CLUTCH, ENABLE

STOP, TAKE, GIVE, BEAT, SECRET = "stop", "take", "give", "beat", "secret"
CONTROL, GRIPPER, SCALING, EXIT, PAUSE, GUIDE = "control", "gripper", "scaling", "exit", "pause", "guide"
RECORD, MARK, TUTORIAL, OPERATOR, CHOOSE, POLICY = "record", "mark", "tutorial", "operator", "choose", "policy"
MOST_LETTERS = 200  # of the text beside a mark, and of an operator's name
FLAGS = (CONTROL, PAUSE, GUIDE, GRIPPER, POLICY, RECORD, TUTORIAL)
OF_AN_ARM = (CONTROL, PAUSE, GUIDE, GRIPPER, POLICY, SCALING, EXIT, OPERATOR)


class PageMessageFault(ValueError):
    """No message of a page; the text is a sentence for it."""


class PageCommand(NamedTuple):
    """A command of a page: `name`, the arm's namespace where it is for one, and its value. `heard`: the newest time of
    the server's clock that the page had from it [s]."""

    name: str
    arm: str = ""
    value: Any = None
    heard: float = -math.inf


def read_command(text: object, arms: Iterable[str]) -> PageCommand:
    """Returns a page's command; raises PageMessageFault for anything else."""
    try:
        message = json.loads(text) if isinstance(text, str) else None
    except (ValueError, RecursionError):
        message = None
    if not isinstance(message, dict):
        raise PageMessageFault("That was no message of the page.")
    heard = message.get("heard")
    command = _command(message, arms)
    return command._replace(heard=float(heard)) if isinstance(heard, (int, float)) else command


def _command(message: Mapping[str, Any], arms: Iterable[str]) -> PageCommand:
    name, arm = message.get("do"), message.get("arm", "")
    value: Any = message.get("value")
    if not isinstance(name, str) or not isinstance(arm, str):
        raise PageMessageFault("A command has a name and an arm.")
    if name in (STOP, TAKE, GIVE):
        return PageCommand(name)
    if name == SECRET:
        return PageCommand(name, value=value if isinstance(value, str) else "")
    if name == BEAT:
        return PageCommand(name, value=(message.get("focus") is True, _held(message.get("held"), arms)))
    if name in OF_AN_ARM and arm not in arms:
        raise PageMessageFault(f"There is no arm {arm[:20]!r}.")
    if name == EXIT:
        return PageCommand(name, arm)
    if name in FLAGS and isinstance(value, bool):
        return PageCommand(name, arm if name in OF_AN_ARM else "", value)
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if name == SCALING and is_number and SCALING_MIN <= value <= SCALING_MAX:  # NaN is not
        return PageCommand(name, arm, float(value))
    if name == OPERATOR and _is_line(value):
        return PageCommand(name, arm, value)
    if name == CHOOSE and value in (*arms, BOTH):
        return PageCommand(name, value=value)
    note = message.get("text", "")
    if name == MARK and value in MARKS and _is_line(note):
        return PageCommand(name, value=(value, note))
    raise PageMessageFault(f"The page sent {name[:20]!r} with a value that it cannot have; nothing was sent.")


def _is_line(value: object) -> bool:
    """Whether a value is a short text without control characters."""
    return isinstance(value, str) and value.isprintable() and len(value) <= MOST_LETTERS


def _held(value: object, arms: Iterable[str]) -> Mapping[str, frozenset[str]]:
    """Returns what a heartbeat holds of each arm; nothing of what is not well-formed."""
    held = value if isinstance(value, dict) else {}
    lists = {arm: held[arm] for arm in arms if isinstance(held.get(arm), list)}
    return {arm: frozenset(name for name in (ENABLE, CLUTCH) if name in names) for arm, names in lists.items()}


def state_text(state: Mapping[str, Any]) -> str:
    """Returns the state as JSON; a number that is not finite becomes null."""
    return json.dumps(_plain(state), allow_nan=False, separators=(",", ":"))


def _plain(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, (list, tuple)) else value
