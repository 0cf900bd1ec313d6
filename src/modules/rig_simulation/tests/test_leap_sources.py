"""Frames of the simulated service: read by our own codec, true to the recording, rising ids and time stamps."""

import functools
import gzip
import itertools
import json

import numpy as np
import pytest
from numpy.testing import assert_allclose

from leap_motion.codec import read_message
from leap_motion.service import wire
from rig_simulation.operator.motion import Script
from rig_simulation.operator.sources import PERIOD_S, BothHands, Playback, Recording, RecordingError, ScriptedOperator

RECORDINGS = ("rollAndPitchWithEntry", "grab", "HandSplay-110fps", "confidence-74fps", "three-claps")
SHORT = Script(figure="line", laps=1, speed=600.0, away=0.5)


def played(playback, count):
    return [playback.next() for _ in range(count)]


@functools.lru_cache(maxsize=None)
def visit(service, side):
    """The frames of a first visit, of the time without a hand, and of the second visit's beginning."""
    playback = Playback(ScriptedOperator(SHORT, side, service=service), service=service)
    texts, ids = [], []
    while ids[-1:] != [2]:
        texts.append(playback.next().text)
        ids += [hand["id"] for hand in json.loads(texts[-1])["hands"]]
        assert len(texts) < 3000, "each visit has an id of its own"
    return texts


def two_frames(first=10, second=8660):
    """A recording of two frames with one hand and one finger, times in us."""
    hand = {
        "id": 5,
        "type": "right",
        "palmPosition": [10.5, 200, -3],
        "direction": [0, 0, -1],
        "palmVelocity": [1, 2, 3],
    }
    finger = {"id": 51, "handId": 5, "type": 1, "tipPosition": [1, 2, 3], "tipVelocity": [4, 5, 6]}
    return [
        {"id": 700 + i, "timestamp": stamp, "hands": [hand], "pointables": [finger], "s": 1.5}
        for i, stamp in enumerate((first, second))
    ]


@pytest.fixture
def write(tmp_path):
    def write(lines, name="frames.jsonl"):
        path = tmp_path / name
        path.write_text("\n".join(line if isinstance(line, str) else wire.text(line) for line in lines) + "\n")
        return path

    return write


@pytest.mark.parametrize(("service", "side"), zip(wire.SERVICES, ("right", "left")))
def test_our_codec_reads_every_frame_of_the_person(service, side):
    frames = [read_message(text) for text in visit(service, side)]
    assert [frame.id for frame in frames] == list(range(1, len(frames) + 1))
    assert (np.diff([frame.timestamp_us for frame in frames]) > 8000).all()
    hands = [hand for frame in frames for hand in frame.hands]
    assert {hand.side for hand in hands} == {side}
    assert {len(hand.fingers) for hand in hands} == {5}
    for hand in hands[::50]:
        for finger in hand.fingers:
            for bone in finger.bones[1:]:
                assert_allclose(bone.rotation[:, 2] * bone.length, bone.start - bone.end, atol=1e-6)
        thumb = hand.fingers[0].bones[0]
        assert thumb.length == 0.0
    ids = [frame.hands[0].id if frame.hands else None for frame in frames]
    assert None in ids[ids.index(1) :], "the hand leaves"


def test_signs_of_entry_and_exit():
    hands = [hand for text in visit("2.3", "right") for hand in json.loads(text)["hands"] if hand["id"] == 1]
    assert hands[0]["palmVelocity"] == [1.19209e-07] * 3
    assert hands[0]["stabilizedPalmPosition"] == hands[0]["palmPosition"]
    assert hands[0]["timeVisible"] == 0
    confidence = np.array([hand["confidence"] for hand in hands])
    assert 0.4 < confidence[0] < 0.9
    assert confidence[15:40].min() < confidence[60:120].mean()
    assert np.median(confidence) > 0.9
    assert confidence[-1] < 0.3
    fist = [hand["confidence"] for hand in hands if hand["grabStrength"] == 1.0]
    assert 0.5 < np.mean(fist) < 0.85


def test_a_still_hand_trembles_as_measured():
    playback = Playback(ScriptedOperator(Script()))
    palms = []
    for frame in played(playback, 430):
        palms += [hand["palmPosition"] for hand in json.loads(frame.text)["hands"]]
    still = np.array(palms)[190:290]
    steps = np.abs(np.diff(still, axis=0))
    assert 0.005 < np.median(steps) < 0.1
    assert np.ptp(still, axis=0).max() < 12.0


def test_the_same_seed_gives_the_same_frames():
    a, b, c = ([frame.text for frame in played(Playback(ScriptedOperator(SHORT), seed), 300)] for seed in (1, 1, 2))
    assert a == b
    assert a != c


def test_play_and_pause():
    playback = Playback(ScriptedOperator(SHORT), playing=False)
    assert not any(json.loads(frame.text)["hands"] for frame in played(playback, 50))
    playback.play()
    first = json.loads(playback.next().text)
    assert [hand["id"] for hand in first["hands"]] == [1]
    assert (playback.playing, playback.position, first["id"]) == (True, 1, 51)
    playback.pause()
    assert json.loads(playback.next().text)["hands"] == []
    playback.play()
    assert [hand["id"] for hand in json.loads(playback.next().text)["hands"]] == [2]
    times = [frame.time for frame in played(playback, 100)]
    assert times == sorted(times)


@pytest.mark.parametrize("name", RECORDINGS)
def test_a_recording_is_served_byte_for_byte_but_for_ids_and_time_stamps(shared_data, name):
    path = shared_data / "leap" / f"{name}.jsonl.gz"
    with gzip.open(path, "rt") as lines:
        recorded = [line.strip() for line in lines]
    playback = Playback(Recording(path))
    first_stamp = json.loads(recorded[0])["timestamp"]
    for number, (line, frame) in enumerate(zip(recorded, played(playback, len(recorded))), 1):
        original, served = json.loads(line), json.loads(frame.text)
        shift = served["timestamp"] - original["timestamp"]
        assert served["id"] == number
        assert abs(shift - (1_000_000 + round(PERIOD_S * 1e6) - first_stamp)) <= 1
        served.update(id=original["id"], timestamp=original["timestamp"])
        assert wire.text({key: served[key] for key in original}) == line
    assert json.loads(playback.next().text)["hands"] == [], "nothing comes after it"


def test_an_offset_moves_positions_only(write):
    frames = Recording(write(two_frames()), offset=(100, -50, 0.25)).frames(np.random.default_rng(0), 1)
    frame = json.loads(next(frames)[1].text(1, 1))
    original = two_frames()[0]
    assert frame["hands"][0] == {**original["hands"][0], "palmPosition": [110.5, 150, -2.75]}
    assert frame["pointables"][0] == {**original["pointables"][0], "tipPosition": [101, -48, 3.25]}


def test_every_position_of_a_frame_is_moved():
    original = json.loads(Playback(ScriptedOperator(SHORT)).next().text)
    moved = wire.shifted(original, (1000, 2000, 3000))
    for before, after in zip(original["hands"] + original["pointables"], moved["hands"] + moved["pointables"]):
        for key, value in before.items():
            if key.endswith(("Position", "Center")) or key in ("elbow", "wrist"):
                assert_allclose(np.subtract(after[key], value), [1000, 2000, 3000], atol=0.01)
            else:
                assert after[key] == value


def test_rate_changes_the_rhythm(write):
    frames = Recording(write(two_frames(0, 20000)), rate=4.0).frames(np.random.default_rng(0), 1)
    assert_allclose([next(frames)[0] for _ in range(2)][1], 0.005)


def test_a_loop_has_a_pause_without_hands_and_new_ids(write):
    playback = Playback(Recording(write(two_frames()), loop=True))
    frames = [json.loads(frame.text) for frame in played(playback, 1200)]
    ids = [frame["hands"][0]["id"] if frame["hands"] else None for frame in frames]
    rounds = [key for key, _ in itertools.groupby(ids)]
    assert rounds[:5] == [5, None, 11, None, 17]
    assert [frame["id"] for frame in frames] == list(range(1, 1201))
    stamps = np.array([frame["timestamp"] for frame in frames])
    assert (np.diff(stamps) > 0).all()
    again = ids.index(11)
    assert 1.0e6 < stamps[again] - stamps[1] < 2.5e6
    assert frames[again]["pointables"][0]["handId"] == 11
    assert frames[again]["pointables"][0]["id"] == 111


@pytest.mark.parametrize(
    ("lines", "sentence"),
    [
        (["no json"], "line 1"),
        ([*two_frames(), '{"id":1}'], "line 3"),
        ([{**two_frames()[0], "hands": [{"type": "right"}]}], "line 1"),
        (two_frames(20, 10), "time stamps"),
        ([""], "frames"),
    ],
)
def test_bad_recordings_are_refused(write, lines, sentence):
    with pytest.raises(RecordingError, match=sentence):
        Recording(write(lines))


@pytest.mark.parametrize("coding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("name", ["windows.jsonl", "windows.JSONL.GZ"])
def test_a_recording_from_windows_is_the_same(tmp_path, write, coding, name):
    plain = write(two_frames())
    content = plain.read_text().replace("\n", " \r\n").encode(coding)
    (tmp_path / name).write_bytes(gzip.compress(content) if name.endswith("GZ") else content)
    frames = [list(itertools.islice(Recording(p).frames(None, 1), 2)) for p in (plain, tmp_path / name)]
    assert str(frames[0]) == str(frames[1])


def test_missing_and_torn_files_are_refused(tmp_path, write):
    with pytest.raises(RecordingError):
        Recording(tmp_path / "nothing.jsonl")
    torn = tmp_path / "torn.jsonl.gz"
    torn.write_bytes(gzip.compress(b"x" * 1000)[:-20])
    with pytest.raises(RecordingError):
        Recording(torn)
    with pytest.raises(RecordingError):
        Recording(write(["plain"], "plain.jsonl.gz"))


@pytest.mark.parametrize(
    ("number", "printed"),
    [(1.23456789, "1.23457"), (-0.000123456789, "-0.000123457"), (20.0, "20"), (1.19209289e-07, "1.19209e-07")],
)
def test_numbers_are_printed_with_six_digits(number, printed):
    assert json.dumps(wire.six(number)) == printed


def palms_of(frames, side):
    """The palm in each frame, None where that hand is not in view; its id must stay while it is."""
    found, ids = [], set()
    for text in frames:
        hands = [hand for hand in json.loads(text)["hands"] if hand["type"] == side]
        assert len(hands) <= 1
        found.append(hands[0]["palmPosition"] if hands else None)
        ids |= {hand["id"] for hand in hands}
    return found, ids


def test_both_hands_move_each_as_one_alone():
    sides = {"left": -160.0, "right": 160.0}
    alone = {side: ScriptedOperator(SHORT, side, centre=(x, 350.0, 0.0)) for side, x in sides.items()}
    both = [frame.text for frame in played(Playback(BothHands((alone["left"], alone["right"])), 7), 2600)]
    palms = {}
    for (side, one), seed in zip(alone.items(), np.random.default_rng(7).integers(2**32, size=2).tolist()):
        palms[side], ids = palms_of(both, side)
        expected, _ = palms_of([frame.text for frame in played(Playback(one, seed), 2600)], side)
        assert palms[side] == expected
        assert len(ids) >= 2
        seen = np.array([palm for palm in palms[side] if palm is not None])
        assert abs(np.median(seen[:, 0]) - sides[side]) < 40.0
    together = [a is not None and b is not None for a, b in zip(*palms.values())]
    either = [(a is None) != (b is None) for a, b in zip(*palms.values())]
    assert sum(together) > 300 and sum(either) > 0, "each comes and goes by itself"
    assert not palms_of(both, "left")[1] & palms_of(both, "right")[1]


def test_at_a_lower_frame_rate_the_same_hand_comes_in_fewer_frames():
    slow, usual = (
        played(Playback(ScriptedOperator(SHORT, frame_rate=rate), 3, frame_rate=rate), round(2.0 * rate))
        for rate in (57.65, 115.3)
    )
    assert slow[-1].time == pytest.approx(usual[-1].time, rel=0.02) == pytest.approx(2.0, rel=0.02)
    assert read_message(slow[0].text).rate == pytest.approx(57.65, abs=0.01)

    def path(frames):
        found, _ = palms_of([frame.text for frame in frames], "right")
        return np.array([(frame.time, *palm) for frame, palm in zip(frames, found) if palm is not None])

    few, many = path(slow), path(usual)
    assert len(few) == pytest.approx(len(many) / 2, rel=0.1)
    both = few[few[:, 0] < many[-1, 0]]
    for axis in (1, 2, 3):
        between = np.interp(both[:, 0], many[:, 0], many[:, axis])
        assert np.abs(between - both[:, axis]).max() < 10.0, "noise and wandering differ, the motion does not"
