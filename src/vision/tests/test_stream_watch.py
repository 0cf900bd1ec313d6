"""When a stream of images counts as alive, slow, empty, frozen, vanished."""

from __future__ import annotations

import dataclasses

import pytest

from vision.camera.stream_watch import StreamWatch, WatchConfig

CONFIG = WatchConfig(silence=0.8, min_rate=10.0, min_depth=0.05, pictures=True)


def watch_of(count: int, period: float = 1 / 15, **changes) -> tuple[StreamWatch, float]:
    """Returns a watch that saw `count` new images, and the time of the last."""
    watch = StreamWatch("depth camera", dataclasses.replace(CONFIG, **changes))
    for i in range(count):
        watch.add_stamp(100.0 + i, period * i)
        watch.add_content(i, period * i)
    return watch, period * (count - 1)


def test_before_the_first_message_it_waits():
    watch, _ = watch_of(0)
    assert watch.health(1000.0).state == "waiting"


def test_new_images_often_enough_are_life():
    watch, now = watch_of(40)
    assert watch.health(now).state == "alive"
    assert watch.health(now).usable
    assert watch.rate(now) == pytest.approx(15.0, abs=0.01)


def test_nothing_for_too_long_is_vanished_and_comes_back():
    watch, now = watch_of(40)
    assert watch.health(now + 0.79).state != "vanished"
    health = watch.health(now + 0.9)
    assert (health.state, health.usable) == ("vanished", False)
    assert "0.9 s" in health.sentence
    watch.add_stamp(200.0, now + 1.0)
    watch.add_content(-1, now + 1.0)
    assert watch.health(now + 1.0).usable


def test_the_same_stamp_again_and_again_is_frozen():
    watch, now = watch_of(40)
    for i in range(20):
        watch.add_stamp(139.0, now + 0.05 * i)
    health = watch.health(now + 0.95)
    assert (health.state, "same stamp" in health.sentence) == ("frozen", True)


def test_the_same_image_under_new_stamps_is_frozen():
    watch, now = watch_of(40)
    for i in range(20):
        watch.add_stamp(200.0 + i, now + 0.05 * i)
        watch.add_content(39, now + 0.05 * i)
    health = watch.health(now + 0.95)
    assert (health.state, "same image" in health.sentence) == ("frozen", True)


def test_images_that_nobody_takes_are_not_frozen():
    watch, now = watch_of(40)
    watch.forget_content()
    for i in range(60):
        watch.add_stamp(200.0 + i, now + i / 15)
    assert watch.health(now + 59 / 15).state == "alive"


def test_depth_without_depth_is_empty():
    watch, now = watch_of(40)
    watch.add_content(-1, now, filled=0.01)
    assert watch.health(now).state == "empty"
    watch.add_stamp(200.0, now + 1.0)
    watch.add_content(-1, now + 1.0, filled=0.01)
    assert watch.health(now + 1.0).state == "empty"
    watch.add_content(-2, now, filled=0.5)
    assert watch.health(now).state == "alive"


def test_few_images_are_slow_but_usable():
    watch, now = watch_of(20, period=0.5)
    health = watch.health(now)
    assert (health.state, health.usable) == ("slow", True)
    assert watch_of(20, period=0.5, min_rate=0.0)[0].health(now).state == "alive"


def test_garbled_images_are_named_until_the_last_is_long_past():
    watch, now = watch_of(40)
    watch.add_garbled("it is torn", now)
    health = watch.health(now + 0.1)
    assert (health.state, health.usable) == ("garbled", False)
    assert "it is torn" in health.sentence
    for i in range(20):
        watch.add_stamp(200.0 + i, now + 0.1 * i)
        watch.add_content(200 + i, now + 0.1 * i)
    assert watch.health(now + 2.0).state == "alive"


def test_who_looks_away_forgets_garbled_images():
    watch, now = watch_of(40)
    watch.add_garbled("it is torn", now)
    watch.forget_content()
    assert watch.health(now + 0.1).state == "alive"


def test_images_that_do_not_come_although_their_camera_info_does_are_no_life():
    watch = StreamWatch("depth camera", CONFIG)
    watch.expect_content(0.0)
    for i in range(30):
        watch.add_stamp(float(i), i / 15)
    assert watch.health(1.5).state == "alive", "the first image may take longer"
    health = watch.health(1.9)
    assert (health.state, "no image for 1.1 s" in health.sentence) == ("vanished", True)
    watch.add_content(1, 1.95)
    assert watch.health(1.95).state == "alive"
    watch.forget_content()
    assert watch.health(2.4).state == "alive", "nobody subscribes to them"
