"""The messages are those of the published driver: their MD5 sums are what decides whether two ROS nodes can talk."""

import pytest

pytestmark = pytest.mark.ros

SUMS = {
    "Human": "2817a017ab58b244566892058c4f6e6d",
    "Hand": "9054fd3f5821eae3259c31fe94fd08a4",
    "Finger": "c62c3b47717473d8242b45f476fc55c7",
    "Bone": "ce39afad61bdb16ab802b0100be50795",
    "Gesture": "a3bf4fe2d0e707244a5a679250ea8eba",
    "Arm": "b93012a87e6395b9975695d8d7a942db",
}


@pytest.mark.parametrize("name", SUMS)
def test_sum(name):
    messages = pytest.importorskip("leap_motion.msg")
    message = getattr(messages, name)
    assert (message._type, message._md5sum) == (f"leap_motion/{name}", SUMS[name])
