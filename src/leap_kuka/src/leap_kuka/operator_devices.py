"""From a pedal, key, gamepad or service to hold-to-enable and clutch: events in, two switches out.

The side on which the tool stays (enabling released, clutch pressed) acts at once, the other after `debounce`. A device
that is not there, or lost events, is on that side; afterwards a button that is down enables only after a release, and
the clutch stays pressed until it was pressed and released once, or cleared by the service. Any source enables or
clutches, but the service enables only where no device does: a program cannot stand in for a foot. Times are monotonic.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from common.config import integer, number, path, text
from leap_kuka.numbers import JOY_SILENCE_S

EVENT = struct.Struct("@llHHi")  # input_event of a 64-bit machine: seconds, microseconds, type, code, value
EV_KEY = 1
ENABLE, CLUTCH = "enable", "clutch"

KEYS = {
    **{f"KEY_{key}": 2 + i for i, key in enumerate("1234567890")},
    **{f"KEY_{key}": 16 + i for i, key in enumerate("QWERTYUIOP")},
    **{f"KEY_{key}": 30 + i for i, key in enumerate("ASDFGHJKL")},
    **{f"KEY_{key}": 44 + i for i, key in enumerate("ZXCVBNM")},
    **{f"KEY_F{i}": 58 + i for i in range(1, 11)},
    **{"KEY_F11": 87, "KEY_F12": 88, **{f"KEY_F{i}": 170 + i for i in range(13, 25)}},
    **{"KEY_ESC": 1, "KEY_TAB": 15, "KEY_ENTER": 28, "KEY_LEFTCTRL": 29, "KEY_LEFTSHIFT": 42, "KEY_LEFTALT": 56},
    **{"KEY_SPACE": 57, "KEY_RIGHTCTRL": 97, "KEY_PAGEUP": 104, "KEY_PAGEDOWN": 109, "KEY_UP": 103, "KEY_DOWN": 108},
    **{"KEY_LEFT": 105, "KEY_RIGHT": 106, "KEY_HOME": 102, "KEY_END": 107},
    **{f"BTN_{i}": 0x100 + i for i in range(10)},
    **{"BTN_LEFT": 0x110, "BTN_RIGHT": 0x111, "BTN_MIDDLE": 0x112, "BTN_TRIGGER": 0x120, "BTN_THUMB": 0x121},
    **{"BTN_SOUTH": 0x130, "BTN_EAST": 0x131, "BTN_NORTH": 0x133, "BTN_WEST": 0x134, "BTN_TL": 0x136, "BTN_TR": 0x137},
}
"""Names of the kernel's input-event-codes.h; any other key is given by its number."""


@dataclass(frozen=True)
class OperatorInputConfig:
    """The parameters under `leap/operator_input/`."""

    device: str = path(doc="input device, such as /dev/input/by-id/...-event-kbd; empty: none", absent="")
    enable_key: str = text(doc="its key to enable, such as KEY_F13, or a number; empty: none", absent="", empty=True)
    clutch_key: str = text(doc="its key to clutch; empty: none", absent="", empty=True)
    joy_enable_button: int = integer(low=-1, high=100, doc="button on the topic joy to enable; -1: none", absent=-1)
    joy_clutch_button: int = integer(low=-1, high=100, doc="button on the topic joy to clutch; -1: none", absent=-1)
    debounce: float = number(
        "s", low=0.0, high=0.5, doc="how long a press to enable, or the clutch's release, must last", absent=0.02
    )

    def faults(self) -> list[str]:
        names = {"enable_key": self.enable_key, "clutch_key": self.clutch_key}
        given = {name: key for name, key in names.items() if key}
        faults = [
            f"{name} is {key!r}, but must be a number or one of {', '.join(KEYS)}."
            for name, key in given.items()
            if key_code(key) is None
        ]
        if bool(self.device) != bool(given):
            faults.append(f"device is {self.device!r}, its keys are {[*names.values()]}; give it and a key, or none.")
        return faults


def key_code(name: str) -> int | None:
    """Returns the code of a key by its name or number, or None."""
    return int(name) if name.isdecimal() and int(name) < 0x300 else KEYS.get(name)


class Button:
    """One button of one source; `slow` is the side that needs `debounce` [s]."""

    def __init__(self, slow: bool, debounce: float) -> None:
        self._slow = slow
        self._debounce = debounce
        self._raw = False
        self._since = -math.inf

    def set(self, pressed: bool, now: float) -> None:
        if pressed != self._raw:
            self._raw, self._since = pressed, now

    def pressed(self, now: float) -> bool:
        return self._raw if self._raw != self._slow or now - self._since >= self._debounce else not self._slow


class ButtonSource:
    """The buttons of one source by what they do, and what it is called."""

    def __init__(self, name: str, debounce: float, has_clutch: bool = False) -> None:
        self.name = name
        self._has_clutch = has_clutch
        self.buttons = {ENABLE: Button(True, debounce), CLUTCH: Button(False, debounce)}
        self.unsure = False  # whether the clutch is pressed because the device was not there
        self.lost(-math.inf)

    def lost(self, now: float) -> None:
        """Releases enabling and presses the clutch, if it has one."""
        self.buttons[ENABLE].set(False, now)
        if self._has_clutch:
            self.unsure = True
            self.buttons[CLUTCH].set(True, now)

    def clear(self, now: float) -> None:
        """Releases a clutch that nobody is known to press."""
        if self.unsure:
            self.unsure = False
            self.buttons[CLUTCH].set(False, now)


class InputDevice(ButtonSource):
    """A Linux input device; `keys` has the codes of its keys by what they do."""

    def __init__(self, keys: dict[str, int], debounce: float) -> None:
        self._keys = keys
        self._rest = b""
        super().__init__("pedal", debounce, CLUTCH in keys)

    def read(self, data: bytes, now: float) -> None:
        """Takes bytes of the device, which may end within an event."""
        dropped = (0, 3)  # EV_SYN, SYN_DROPPED: the kernel's queue was full, and what is pressed is unknown
        released = 0
        pressed = 1  # 2 is an automatic repetition
        data = self._rest + data
        end = len(data) - len(data) % EVENT.size
        self._rest = data[end:]
        for _, _, kind, code, value in EVENT.iter_unpack(data[:end]):
            if (kind, code) == dropped:
                self.lost(now)
            for name, key in self._keys.items():
                if (kind, code) != (EV_KEY, key):
                    continue
                if name == CLUTCH:
                    self.unsure = False
                    self.buttons[name].set(value != released, now)
                elif value in (released, pressed):
                    self.buttons[name].set(value == pressed, now)

    def lost(self, now: float) -> None:
        """Forgets a half event, too."""
        super().lost(now)
        self._rest = b""


class Gamepad(ButtonSource):
    """The buttons on the topic joy, by number; it must report all the time."""

    def __init__(self, numbers: dict[str, int], debounce: float) -> None:
        super().__init__("gamepad", debounce, CLUTCH in numbers)
        self._numbers = numbers
        self._at = -math.inf
        self._reports = self._was_released = False  # and whether enabling was seen released since

    def take(self, buttons: list[int], now: float) -> None:
        """Takes the state of all buttons."""
        self.watch(now)
        self._at, self._reports = now, True
        for name, i in self._numbers.items():
            pressed = 0 <= i < len(buttons) and bool(buttons[i])
            if name == CLUTCH:
                self.unsure &= not pressed
                self.buttons[name].set(pressed or self.unsure, now)
            else:
                self._was_released |= not pressed
                self.buttons[name].set(pressed and self._was_released, now)

    def watch(self, now: float) -> None:
        """Takes it for lost when it has fallen silent."""
        if self._reports and now - self._at > JOY_SILENCE_S:
            self.lost(now)
            self._reports = self._was_released = False


class OperatorInput:
    """All sources together."""

    def __init__(self, config: OperatorInputConfig) -> None:
        keys = {ENABLE: key_code(config.enable_key), CLUTCH: key_code(config.clutch_key)}
        numbers = {ENABLE: config.joy_enable_button, CLUTCH: config.joy_clutch_button}
        self.device = InputDevice({name: key for name, key in keys.items() if key is not None}, config.debounce)
        self.gamepad = Gamepad({name: i for name, i in numbers.items() if i >= 0}, config.debounce)
        self.service = ButtonSource("service", 0.0)
        self._sources: tuple[ButtonSource, ...] = self.device, self.gamepad, self.service
        configured = ((self.device, keys[ENABLE] is not None), (self.gamepad, numbers[ENABLE] >= 0))
        self._enabling = " or the ".join(source.name for source, enables in configured if enables)

    def request(self, name: str, on: bool, now: float) -> str:
        """Sets a switch by the service; returns why not, in a sentence, or nothing. Releasing the clutch also
        releases that of devices that were not there."""
        if name == ENABLE and on and self._enabling:
            return f"Enabling needs the {self._enabling}: the service enables only where none is configured."
        self.service.buttons[name].set(on, now)
        if name == CLUTCH and not on:
            for source in self._sources:
                source.clear(now)
        return ""

    def state(self, now: float) -> tuple[bool, bool, str]:
        """Returns whether any source enables, whether any clutches, and the names of those that do."""
        self.gamepad.watch(now)
        pressed = {name: [s.name for s in self._sources if s.buttons[name].pressed(now)] for name in (ENABLE, CLUTCH)}
        names = dict.fromkeys(pressed[ENABLE] + pressed[CLUTCH])
        return bool(pressed[ENABLE]), bool(pressed[CLUTCH]), " and ".join(names)
