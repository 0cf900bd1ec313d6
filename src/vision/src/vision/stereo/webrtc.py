"""A camera's newest images as video over WebRTC (VP8 or H.264 with congestion control), by aiortc, for pages on other
machines: a lost packet there would stop the JPEGs of TCP. The peers meet at the two addresses of the page's WebSocket
and at no other, so neither asks a server, looks a name up or sends anywhere that the page names.

Below each frame is a strip that says when its image was taken: STRIP rows with BITS bits, black or white, the least
first, and then their parity by columns. A page reads it and does not show it."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import importlib.util
import re
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from websockets.asyncio.server import ServerConnection

from common import clock
from leap_motion.service.access import is_loopback

if TYPE_CHECKING:
    from vision.stereo.transport import NewestPicture

MAX_VIDEOS = 2  # at once: each is encoded by itself
STRIP, BITS, PARITY = 16, 24, 8
CLOCK_HZ = 90000
CANDIDATE = re.compile(r"(a=candidate:\S+ \d+ udp \d+) (\S+) (\d+) typ host\b.*", re.IGNORECASE)


@functools.lru_cache(maxsize=1)
def missing() -> str:
    """Returns why there is no video on this rig, a sentence; empty if there is."""
    if importlib.util.find_spec("aiortc"):
        return ""
    return "Pages on other machines get single images instead of video: aiortc is not installed (make setup)."


def stamped(image: np.ndarray, taken: float) -> np.ndarray:
    """Returns an RGB image with the strip below it, and an even width and height; `taken` [s]."""
    height, width = (size // 2 * 2 for size in image.shape[:2])
    number = round(1e3 * taken) % 2**BITS
    bits = (number >> np.arange(BITS)) & 1
    bits = np.concatenate((bits, bits.reshape(-1, PARITY).sum(axis=0) & 1))
    frame = np.empty((height + STRIP, width, 3), np.uint8)
    frame[:height] = image[:height, :width]
    frame[height:] = 255 * bits[np.arange(width) * len(bits) // width][None, :, None]
    return frame


def at_address(sdp: str, address: str, only: str = "") -> str:
    """Returns an SDP whose candidates are those of a host's UDP, at an address; `only`: those at this one, if any."""
    lines = sdp.splitlines()
    found = [match for line in lines if (match := CANDIDATE.fullmatch(line))]
    kept = {match[0] for match in found if match[2] == only} or {match[0] for match in found}
    told = [line for line in lines if not line.startswith("a=candidate:") or line in kept]
    return "\r\n".join(CANDIDATE.sub(rf"\1 {address} \3 typ host", line) for line in told) + "\r\n"


async def answered(
    offer: str, newest: NewestPicture, page: ServerConnection, stack: contextlib.AsyncExitStack
) -> str | None:
    """Returns the answer to a page's offer; None: it is no offer of one that looks. The video ends with the stack."""
    import aiortc
    import av

    class NewestTrack(aiortc.MediaStreamTrack):
        kind = "video"
        number, began = newest.number, clock.monotonic()

        async def recv(self) -> Any:
            await newest.after(self.number)
            self.number, picture = newest.number, newest.picture
            assert picture is not None
            frame = av.VideoFrame.from_ndarray(stamped(picture.image, picture.taken), "rgb24")
            frame.pts, frame.time_base = round(CLOCK_HZ * (clock.monotonic() - self.began)), Fraction(1, CLOCK_HZ)
            return frame

    answer_s, most_bytes, most_candidates = 5.0, 16384, 32
    if len(offer) > most_bytes or offer.count("\nm=") > 1 or offer.count("candidate:") > most_candidates:
        return None  # more than a page asks for: to read it would take its time from the emergency stop
    here, there = page.local_address[0], page.remote_address[0]
    host = page.request.headers.get("Host", "").rpartition(":")[0].strip("[]") if page.request else ""
    peer = aiortc.RTCPeerConnection(aiortc.RTCConfiguration(iceServers=[]))
    stack.push_async_callback(_close, peer)
    peer.addTrack(NewestTrack())
    try:
        remote = aiortc.RTCSessionDescription(at_address(offer, there), "offer")
        await asyncio.wait_for(peer.setRemoteDescription(remote), answer_s)
        await asyncio.wait_for(peer.setLocalDescription(await peer.createAnswer()), answer_s)
    except Exception:  # aiortc raises whatever comes of a text that is no SDP
        return None
    named = host if re.fullmatch(r"[\d.]+|[\da-f:]+", host) else here
    return peer.localDescription.sdp if is_loopback(here) else at_address(peer.localDescription.sdp, named, here)


async def _close(peer: Any) -> None:
    close_s = 2.0
    with contextlib.suppress(Exception):
        await asyncio.wait_for(peer.close(), close_s)
