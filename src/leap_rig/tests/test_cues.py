"""Which change sounds which: none without a change, few a second, and a stop is always heard."""

import io
import wave

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from leap_rig.operator.cues import GAP_S, LIMIT_GAP_S, NOTES, RATE_HZ, Cue, Sound, Sounds, wav

STEP_S = 0.1
cues = st.builds(Cue, st.booleans(), st.booleans(), st.booleans())
walks = st.lists(st.tuples(cues, st.integers(1, 8)), min_size=1, max_size=30).map(
    lambda runs: [cue for cue, times in runs for _ in range(times)]
)


def heard(walk):
    """The sounds of one state every STEP_S, as (number of the step, sound)."""
    sounds = Sounds()
    found = [(i, sounds.step(cue, 50.0 + STEP_S * i)) for i, cue in enumerate(walk)]
    return [(i, sound) for i, sound in found if sound is not None]


def cause(walk, sound):
    """The steps at which the state changed as the sound says."""
    attribute, value = {
        Sound.ENGAGE: ("engaged", True), Sound.RELEASE: ("engaged", False),
        Sound.LIMIT: ("limited", True), Sound.STOP: ("stopped", True),
    }[sound]  # fmt: skip
    states = [getattr(cue, attribute) == value for cue in walk]
    return [i for i in range(1, len(states)) if states[i] and not states[i - 1]]


@given(walks)
def test_each_sound_has_a_change_of_its_own_shortly_before(walk):
    for sound in Sound:
        at, causes = [i for i, s in heard(walk) if s is sound], cause(walk, sound)
        assert len(at) <= len(causes)
        for i in at:
            assert any(0 <= i - c <= GAP_S / STEP_S + 1 for c in causes)


@given(walks)
def test_sounds_come_one_after_the_other(walk):
    found = heard(walk)
    gaps = np.diff([i for i, _ in found]) * STEP_S
    assert (gaps >= GAP_S - 1e-9).all()
    assert (np.diff([i for i, s in found if s is Sound.LIMIT]) * STEP_S >= LIMIT_GAP_S - 1e-9).all()


@given(walks)
def test_a_stop_is_heard_whatever_else_happens(walk):
    walk = walk + walk[-1:] * 10
    at = [i for i, sound in heard(walk) if sound is Sound.STOP]
    for i in cause(walk, Sound.STOP):
        assert any(0 <= j - i <= GAP_S / STEP_S + 1 for j in at)


@given(walks)
def test_without_stops_the_last_word_about_the_hand_is_true(walk):
    walk = [Cue(cue.engaged, cue.limited, False) for cue in walk]
    about = [sound for _, sound in heard(walk + walk[-1:] * 10) if sound is not Sound.LIMIT]
    if about:
        assert (about[-1] is Sound.ENGAGE) == walk[-1].engaged


def test_each_change_is_heard():
    at_rest, engaged, limited, stopped = (Cue(*of) for of in ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 0, 1)))
    walk = [cue for cue in (at_rest, engaged, limited, engaged, at_rest, stopped) for _ in range(10)]
    assert heard(walk) == [(10, Sound.ENGAGE), (20, Sound.LIMIT), (40, Sound.RELEASE), (50, Sound.STOP)]


@pytest.mark.parametrize("sound", list(Sound))
def test_a_sound_is_short_and_does_not_click(sound):
    with wave.open(io.BytesIO(wav(sound))) as file:
        assert (file.getnchannels(), file.getframerate()) == (1, RATE_HZ)
        samples = np.frombuffer(file.readframes(file.getnframes()), "<i2") / 2**15
    assert len(samples) == pytest.approx(RATE_HZ * sum(length for _, length in NOTES[sound]), abs=2)
    assert len(samples) < GAP_S * RATE_HZ and 0.2 < np.abs(samples).max() < 0.9
    assert np.abs(np.diff(np.concatenate(([0.0], samples, [0.0])))).max() < 0.2


def test_all_sounds_differ():
    assert len({wav(sound) for sound in Sound}) == len(Sound)
