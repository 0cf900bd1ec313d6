"""Video of a camera for pages: the strip with the time, and where the two peers may meet."""

from __future__ import annotations

import asyncio
import contextlib
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vision.stereo import webrtc
from vision.stereo.transport import NewestPicture

RANGE = 2**webrtc.BITS
CANDIDATES = st.lists(
    st.tuples(st.sampled_from(["udp", "tcp"]), st.ip_addresses().map(str) | st.just("a.local"), st.integers(1, 65535))
)


def read(frame):
    """The number in a frame's strip, and whether its parity holds, as a page reads them."""
    width, count = frame.shape[1], webrtc.BITS + webrtc.PARITY
    row = frame[-webrtc.STRIP // 2, ((np.arange(count) + 0.5) * width / count).astype(int), 0] > 127
    parity = row[: webrtc.BITS].reshape(-1, webrtc.PARITY).sum(axis=0) % 2 == row[webrtc.BITS :]
    return int((row[: webrtc.BITS] * 2 ** np.arange(webrtc.BITS)).sum()), bool(parity.all())


@given(st.floats(0.0, 1e6), st.integers(64, 200), st.integers(2, 50))
def test_the_strip_says_when_an_image_was_taken_and_leaves_the_image_as_it_is(taken, width, height):
    image = np.random.default_rng(0).integers(0, 256, (height, width, 3), np.uint8)
    frame = webrtc.stamped(image, taken)
    assert read(frame) == (round(1e3 * taken) % RANGE, True)
    assert frame.shape[0] % 2 == frame.shape[1] % 2 == 0
    even = image[: height // 2 * 2, : width // 2 * 2]
    np.testing.assert_array_equal(frame[: -webrtc.STRIP], even)


@given(st.floats(0.0, 1e6), st.integers(0, webrtc.BITS + webrtc.PARITY - 1))
def test_one_wrong_bit_is_seen(taken, bit):
    frame = webrtc.stamped(np.zeros((4, 320, 3), np.uint8), taken)
    frame[-webrtc.STRIP :, 10 * bit : 10 * bit + 10] = 255 - frame[-1, 10 * bit, 0]
    assert not read(frame)[1]


@given(CANDIDATES)
def test_the_peers_meet_at_one_address_alone(candidates):
    lines = ["v=0", *(f"a=candidate:1 1 {kind} 99 {host} {port} typ host" for kind, host, port in candidates)]
    lines.append("a=candidate:2 1 udp 98 203.0.113.9 40 typ srflx raddr 0.0.0.0 rport 0")
    sdp = webrtc.at_address("\r\n".join(lines), "192.0.2.7").splitlines()
    assert sdp[0] == "v=0"
    ports = [port for kind, _, port in candidates if kind == "udp"]
    assert [line.split()[4:] for line in sdp[1:]] == [["192.0.2.7", str(port), "typ", "host"] for port in ports]


def test_of_several_own_addresses_the_one_that_the_page_reached_is_told():
    lines = [f"a=candidate:1 1 udp 99 {host} 5 typ host" for host in ("10.0.0.1", "192.0.2.1", "172.16.0.1")]
    assert webrtc.at_address("\n".join(lines), "192.0.2.9", "192.0.2.1").count("a=candidate") == 1
    assert webrtc.at_address("\n".join(lines), "192.0.2.9", "192.0.2.2").count("a=candidate") == 3


@pytest.mark.real
@pytest.mark.parametrize("offer", ["", "v=0", "nonsense", "v=0\r\nm=video 9 x y\r\n", "m=audio\r\n" * 50])
def test_what_is_no_offer_gets_no_answer(offer):
    pytest.importorskip("aiortc")

    async def answer():
        page = SimpleNamespace(local_address=("192.0.2.1", 1), remote_address=("192.0.2.2", 2), request=None)
        async with contextlib.AsyncExitStack() as stack:
            return await webrtc.answered(offer, NewestPicture(asyncio.get_running_loop(), 80), page, stack)

    assert asyncio.run(answer()) is None


@pytest.mark.real
def test_an_offer_is_answered_with_the_address_of_the_page_and_ends_with_it():
    aiortc = pytest.importorskip("aiortc")

    async def answer():
        request = SimpleNamespace(headers={"Host": "192.0.2.7:8470"})
        page = SimpleNamespace(local_address=("192.0.2.1", 1), remote_address=("192.0.2.2", 2), request=request)
        peer = aiortc.RTCPeerConnection(aiortc.RTCConfiguration(iceServers=[]))
        peer.addTransceiver("video", direction="recvonly")
        await peer.setLocalDescription(await peer.createOffer())
        async with contextlib.AsyncExitStack() as stack:
            newest = NewestPicture(asyncio.get_running_loop(), 80)
            offer = peer.localDescription.sdp
            sdp = await webrtc.answered(offer, newest, page, stack)
            candidate = "a=candidate:1 1 udp 1 192.0.2.2 9 typ host\r\n"
            too_much = [
                offer + 33 * candidate,
                offer + offer[offer.index("m=") :],
                offer + "a=x:" + 16384 * "x" + "\r\n",
            ]
            refused = [await webrtc.answered(each, newest, page, stack) for each in too_much]
        await peer.close()
        return sdp, refused

    sdp, refused = asyncio.run(answer())
    assert refused == [None, None, None]
    assert "m=video" in sdp and "a=sendonly" in sdp
    hosts = {line.split()[4] for line in sdp.splitlines() if line.startswith("a=candidate")}
    assert hosts <= {"192.0.2.7"}
