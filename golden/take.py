"""A part of a run that record.py has stored, as a small file of the gate:

python -m golden.take FOLDER NAME FROM TO        FROM and TO in seconds since its first tracker frame
"""

from __future__ import annotations

import argparse
import json
import lzma
import sys
from pathlib import Path
from typing import Any

import yaml

from common.errors import RigError
from common.ros.files import FILE_NAME
from golden.chain import SECTIONS, SRC
from golden.runs import FIRST_S, TAKEN
from leap_rig.recording import read
from leap_rig.recording.recording_files import MESSAGES
from leap_rig.recording.run import MessageDecoders, between
from tools.options import number

OPERATOR_INPUT = "/leap_kuka/operator_input"
ADDRESSES = {"ip", "port"}
MOST_S = 86400.0


def settings(parameters: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Returns what differs from the shipped parameters of the three sections."""
    found = {}
    for section, (_, file) in SECTIONS.items():
        shipped, used = yaml.safe_load((SRC / file).read_text()), parameters.get(section, {})
        keys = [key for key in shipped if key in used and used[key] != shipped[key] and key not in ADDRESSES]
        if keys:
            found[section] = {key: used[key] for key in keys}
    return found


def main(argv: list[str] | None = None) -> None:
    """Entry point of the program."""
    parser = argparse.ArgumentParser(prog="python -m golden.take", description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="of the recording")
    parser.add_argument("name", type=file_name, help="of the part")
    parser.add_argument("begin", type=number(0.0, MOST_S), help="seconds since the first tracker frame")
    parser.add_argument("end", type=number(0.0, MOST_S), help="likewise")
    options = parser.parse_args(argv)
    try:
        print(take(options.folder, options.name, options.begin, options.end))
    except (RigError, OSError) as error:
        sys.exit(f"take: {error}")


def file_name(text: str) -> str:
    """The type of a name without a folder or an ending."""
    if not FILE_NAME.fullmatch(text):
        raise argparse.ArgumentTypeError(f"{text!r} is no name: letters, digits, - and _ are")
    return text


def take(folder: Path, name: str, begin: float, end: float) -> str:
    """Writes the part of a recording from `begin` to `end` [s]; returns a sentence. RigError: there is no frame."""
    run, decode = read(folder), MessageDecoders()
    if not len(run.frames):
        raise RigError(f"{folder} has no tracker frames.")
    start = run.frame_times[0] + begin
    pairs = [(t - start, text) for t, text in zip(run.frame_times.tolist(), run.frames)]
    frames = [[round(FIRST_S + t, 6), text] for t, text in pairs if 0.0 <= t <= end - begin]
    if not frames:
        raise RigError(f"{folder} has no tracker frames from {begin:g} to {end:g} s.")
    switched: list[list[Any]] = []
    for message in between(folder, [OPERATOR_INPUT], 0.0, float("inf")):
        t, value = 1e-9 * message.received - start, decode(message)
        if -FIRST_S <= t <= end - begin:
            switched.append([round(FIRST_S + t, 6), "input", [bool(value["enabled"]), bool(value["clutch"])]])
    content = {
        "recorded": {key: run.manifest[key] for key in ("name", "started", "versions")},
        "file": run.manifest["files"][MESSAGES],
        "from_s": begin,
        "settings": settings(yaml.safe_load((folder / "parameters.yaml").read_text())),
        "switched": switched,
        "frames": frames,
    }
    text = json.dumps(content, separators=(",", ":"), sort_keys=True)
    path = TAKEN / f"{name}.json.xz"
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(lzma.compress(text.encode(), preset=9 | lzma.PRESET_EXTREME))
    return f"{path}: {len(frames)} frames, {len(switched)} inputs, {path.stat().st_size / 1e3:.0f} kB"


if __name__ == "__main__":
    main()
