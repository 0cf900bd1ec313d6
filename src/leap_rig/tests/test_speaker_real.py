"""The speaker with real programs in the place of `aplay`."""

import wave

import pytest

pytest.importorskip("rospy")
from leap_rig.operator.cues import Sound
from leap_rig.operator.ros import speaker

pytestmark = pytest.mark.ros


@pytest.fixture
def play(tmp_path, monkeypatch):
    """Plays a sound by a shell script; returns what was logged, and the folder where the script has run."""
    program, said = tmp_path / "aplay", []
    monkeypatch.setattr(speaker, "LONGEST_S", 300.0)
    monkeypatch.setattr(speaker.rospy, "logwarn", lambda text, *words: said.append(text % words))

    def made(script):
        program.write_text(f"#!/bin/sh\ncd {tmp_path}\n{script}\n")
        program.chmod(0o755)
        player = speaker.Speaker(str(program))
        for _ in range(2):
            player.play(Sound.STOP)
            with player._busy:  # until it has ended
                pass
        return said, tmp_path

    return made


@pytest.mark.long
def test_without_a_sound_card_it_says_so_once_and_is_silent(play):
    said, folder = play("echo call >> calls\necho 'no soundcards found' >&2\nexit 1")
    assert said == ["No sounds: no soundcards found. The rig works without them."]
    assert (folder / "calls").read_text() == "call\n"


@pytest.mark.real
def test_the_program_gets_a_sound(play):
    said, folder = play("cat > heard")
    with wave.open(str(folder / "heard")) as heard:
        assert heard.getnframes() > 0
    assert not said
