"""Python imports this by itself where this folder is on PYTHONPATH: the wall clock of a process as campaign.clocks sets
it, by a number of seconds in the file `all` of the folder CAMPAIGN_CLOCK, and another in a file named as the node."""

import mmap
import os
import re
import struct
import time


def _shift_clock(folder: str) -> None:
    with open("/proc/self/cmdline") as file:
        found = re.search(r"__name:=([^\0]+)", file.read())
    own = os.path.join(folder, found[1] if found else "nobody")
    if not os.path.exists(own):
        with open(own, "wb") as file:
            file.write(bytes(8))
    offsets = []
    for path in (os.path.join(folder, "all"), own):
        with open(path, "rb") as file:
            offsets.append(mmap.mmap(file.fileno(), 8, access=mmap.ACCESS_READ))
    now, read = time.time, struct.Struct("d").unpack_from

    def shifted() -> float:
        return now() + read(offsets[0])[0] + read(offsets[1])[0]

    time.time = shifted
    time.time_ns = lambda: int(1e9 * shifted())


if "CAMPAIGN_CLOCK" in os.environ:
    _shift_clock(os.environ["CAMPAIGN_CLOCK"])
