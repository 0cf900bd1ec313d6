"""Laws of virtual time: no wake-up lost, time never backwards, one run per seed, and what is stuck is named."""

from __future__ import annotations

import queue
import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common import clock
from simulated import scheduler as scheduling
from simulated.clock import virtual_time
from simulated.scheduler import START_S, Stuck

SEEDS = range(8)


def started(*jobs):
    threads = [clock.Thread(target=job, name=f"job {i}") for i, job in enumerate(jobs)]
    for thread in threads:
        thread.start()
    return threads


def run(*jobs):
    for thread in started(*jobs):
        thread.join()


def test_common_clock_is_the_standard_library_s_before_and_after():
    before = [getattr(clock, name) for name in clock.__all__]
    with virtual_time():
        assert clock.monotonic() == START_S and clock.Event is not threading.Event
    assert [getattr(clock, name) for name in clock.__all__] == before
    own = (clock.monotonic, clock.sleep, clock.Event, clock.Lock, clock.Queue)
    assert own == (time.monotonic, time.sleep, threading.Event, threading.Lock, queue.Queue)


@given(st.lists(st.lists(st.floats(0.0, 5.0), max_size=6), min_size=1, max_size=5), st.integers(0, 5))
def test_each_sleep_ends_at_its_time_and_none_costs_real_time(sleeps, seed):
    seen = []

    def job(durations):
        due = START_S
        for duration in durations:
            clock.sleep(duration)
            due = due + duration
            assert clock.monotonic() == due
            seen.append(clock.monotonic())

    begun = time.monotonic()
    with virtual_time(seed) as scheduler:
        run(*(lambda durations=durations: job(durations) for durations in sleeps))
        assert clock.monotonic() == max(seen, default=START_S)
    assert seen == sorted(seen), "time ran backwards"
    assert scheduler.crashed == []
    assert time.monotonic() - begun < 60.0


def traffic(seed):
    """Threads that meet at every kind of object; returns what happened, and the turns."""
    happened = []
    with virtual_time(seed, trace=True) as scheduler:
        lock, condition, event, items = clock.Lock(), clock.Condition(), clock.Event(), clock.Queue(2)
        ready = []

        def produce(name):
            for i in range(5):
                clock.sleep(0.01 * (i % 3))
                items.put((name, i))
                with condition:
                    ready.append(name)
                    condition.notify()

        def consume():
            while True:
                item = items.get()
                if item is None:
                    return
                with lock:
                    happened.append((clock.monotonic(), *item))
                    clock.sleep(0.002)

        def wait():
            for _ in range(10):
                with condition:
                    assert condition.wait_for(lambda: ready, 10.0)
                    ready.pop()
            event.set()

        producers = started(lambda: produce("a"), lambda: produce("b"))
        others = started(consume, consume, wait)
        for thread in producers:
            thread.join()
        assert event.wait(5.0)
        for _ in range(2):
            items.put(None)
        for thread in others:
            thread.join(5.0)
            assert not thread.is_alive()
    assert scheduler.crashed == []
    return happened, scheduler.trace


@pytest.mark.parametrize("seed", SEEDS)
def test_no_wake_up_and_no_item_is_lost(seed):
    happened, trace = traffic(seed)
    assert sorted(item for _, *item in happened) == sorted([name, i] for name in "ab" for i in range(5))
    assert [at for at, _ in trace] == sorted(at for at, _ in trace)


def test_a_seed_makes_one_run_and_others_make_others():
    assert traffic(3) == traffic(3)
    assert len({tuple(traffic(seed)[1]) for seed in SEEDS}) == len(SEEDS)


def test_a_race_is_found_by_some_seed_and_a_lock_ends_it():
    def total(seed, guard):
        with virtual_time(seed):
            lock, other, sums = clock.Lock(), clock.Lock(), [0]

            def add():
                for _ in range(5):
                    with lock if guard else other:
                        before = sums[0]
                        if not guard:
                            other.release()
                            other.acquire()
                        sums[0] = before + 1

            run(add, add, add)
            return sums[0]

    assert {total(seed, True) for seed in SEEDS} == {15}
    assert min(total(seed, False) for seed in SEEDS) < 15


class TestTimeOuts:
    @pytest.fixture(autouse=True)
    def virtual(self):
        with virtual_time() as self.scheduler:
            yield

    @staticmethod
    def lasts(seconds, what):
        begun = clock.monotonic()
        result = what()
        assert clock.monotonic() - begun == pytest.approx(seconds, abs=1e-9)
        return result

    def test_what_does_not_come_is_waited_for_exactly_so_long(self):
        lock, condition = clock.Lock(), clock.Condition()
        run(lambda: lock.acquire())
        assert not self.lasts(0.3, lambda: lock.acquire(timeout=0.3))
        assert not self.lasts(0.0, lambda: lock.acquire(blocking=False))
        assert not self.lasts(0.4, lambda: clock.Event().wait(0.4))
        with condition:
            assert not self.lasts(0.5, lambda: condition.wait(0.5))
            assert not self.lasts(0.6, lambda: condition.wait_for(lambda: False, 0.6))
        with pytest.raises(clock.Empty):
            self.lasts(0.0, lambda: clock.Queue().get(timeout=0.7))
        with pytest.raises(clock.Empty):
            clock.SimpleQueue().get_nowait()
        full = clock.Queue(1)
        full.put(1)
        with pytest.raises(clock.Full):
            full.put(2, timeout=0.8)
        (thread,) = started(lambda: clock.sleep(9.0))
        self.lasts(0.9, lambda: thread.join(0.9))
        assert thread.is_alive()
        self.lasts(8.1, thread.join)

    def test_what_comes_in_time_is_not_waited_for_longer(self):
        event, condition, items = clock.Event(), clock.Condition(), clock.Queue()

        def later():
            clock.sleep(0.2)
            event.set()
            clock.sleep(0.2)
            with condition:
                condition.notify_all()
            clock.sleep(0.2)
            items.put("it")

        started(later)
        assert self.lasts(0.2, lambda: event.wait(5.0))
        with condition:
            assert self.lasts(0.2, lambda: condition.wait(5.0))
        assert self.lasts(0.2, lambda: items.get(timeout=5.0)) == "it"

    def test_a_timer_calls_once_unless_it_is_cancelled(self):
        calls = []
        timers = [clock.Timer(0.5, calls.append, [name]) for name in "ab"]
        for timer in timers:
            timer.start()
        clock.sleep(0.4)
        timers[0].cancel()
        clock.sleep(1.0)
        assert calls == ["b"]

    def test_an_unlucky_sleep_is_refused(self):
        for seconds in (-1.0, float("nan")):
            with pytest.raises(ValueError):
                clock.sleep(seconds)


BOTH = pytest.mark.parametrize("virtual", [True, False], ids=["virtual", "standard library"])


@BOTH
def test_locks_and_queues_answer_as_the_standard_library_s(virtual):
    """What one thread sees of them, without waiting."""
    with virtual_time() if virtual else threading.Lock():
        lock, again, event, items = clock.Lock(), clock.RLock(), clock.Event(), clock.Queue(1)
        assert lock.acquire() and lock.locked() and not lock.acquire(False)
        lock.release()
        with pytest.raises(RuntimeError):
            lock.release()
        with again, again:
            assert again.acquire(False)
            again.release()
        with pytest.raises(RuntimeError):
            again.release()
        with again, again:
            condition = clock.Condition(again)
            with condition:
                assert condition.wait(0.001) is False
                assert condition.wait_for(lambda: 7, 1.0) == 7
        with pytest.raises(RuntimeError):
            again.release()
        for call in (clock.Condition().wait, clock.Condition().notify):
            with pytest.raises(RuntimeError):
                call()
        assert not event.is_set() and event.wait(0.0) is False
        event.set()
        assert event.wait() is True
        event.clear()
        assert not event.is_set()
        items.put(1)
        with pytest.raises(queue.Full):
            items.put_nowait(2)
        assert (items.qsize(), items.full(), items.get(), items.empty()) == (1, True, 1, True)
        with pytest.raises(ValueError):
            items.get(timeout=-1.0)
        items.task_done()
        items.join()
        thread = clock.Thread(target=lambda: None)
        with pytest.raises(RuntimeError):
            thread.join()
        assert not thread.is_alive()
        thread.start()
        with pytest.raises(RuntimeError):
            thread.start()
        thread.join()
        assert not thread.is_alive()


class TestStuck:
    def test_a_deadlock_names_who_waits_for_whom(self):
        with pytest.raises(Stuck) as stuck, virtual_time():
            one, other = clock.Lock(), clock.Lock()

            def take(first, second):
                with first:
                    clock.sleep(0.1)
                    with second:
                        pass

            run(lambda: take(one, other), lambda: take(other, one))
        text = str(stuck.value)
        assert "all wait for ever" in text and "test_virtual_time.py" in text and "in take" in text
        assert "which job 0 (1) has" in text and "which job 1 (2) has" in text and "the end of job 0" in text

    def test_a_thread_that_waits_outside_is_named_with_its_stack(self, monkeypatch):
        monkeypatch.setattr(scheduling, "POLL_S", 0.02)
        monkeypatch.setattr(scheduling, "POLLS", 5)
        outside = threading.Event()
        with pytest.raises(Stuck) as stuck, virtual_time():
            try:
                run(lambda: outside.wait())
            finally:
                outside.set()
        assert "waits outside of virtual time: job 0" in str(stuck.value) and "outside.wait" in str(stuck.value)

    def test_a_thread_that_computes_is_not(self, monkeypatch):
        monkeypatch.setattr(scheduling, "POLL_S", 0.01)
        monkeypatch.setattr(scheduling, "POLLS", 5)

        def compute():
            while time.thread_time() < 0.3:
                pass

        with virtual_time():
            run(compute)

    def test_a_loop_that_asks_for_the_time_and_never_waits_is_named(self):
        def spin():
            while clock.monotonic() < START_S + 1.0:
                pass

        with virtual_time() as scheduler, pytest.MonkeyPatch.context() as patch:
            patch.setattr(threading, "excepthook", lambda _: None)
            run(spin)
        ((name, error),) = scheduler.crashed
        assert name.startswith("job 0") and "without waiting" in str(error)

    def test_a_thread_of_somebody_else_has_no_turns(self):
        failed = []

        def ask():
            try:
                clock.monotonic()
            except RuntimeError as error:
                failed.append(str(error))

        with virtual_time():
            stranger = threading.Thread(target=ask, name="stranger")
            stranger.start()
            stranger.join()
        assert "stranger was not made by common.clock" in failed[0]

    def test_only_one_runs_at_a_time(self):
        with virtual_time(), pytest.raises(RuntimeError), virtual_time():
            pass


class TestEnds:
    def test_threads_that_wait_at_the_end_unwind(self):
        ended = []

        def job():
            lock = clock.Lock()
            try:
                with lock:
                    clock.Event().wait()
            finally:
                ended.append(clock.Lock)

        with virtual_time():
            threads = started(job, job)
            clock.sleep(1.0)
        assert len(ended) == 2 and not any(threading.Thread.is_alive(thread) for thread in threads)

    def test_a_failure_in_the_test_comes_through(self):
        with pytest.raises(ZeroDivisionError), virtual_time():
            started(lambda: clock.sleep(100.0))
            clock.sleep(1.0)
            raise ZeroDivisionError

    def test_a_thread_that_fails_is_noted(self, monkeypatch):
        reported = []
        monkeypatch.setattr(threading, "excepthook", lambda args: reported.append(args.exc_type))
        with virtual_time() as scheduler:
            run(lambda: 1 // 0)
        assert reported == [ZeroDivisionError]
        assert [(name.split()[0], type(error)) for name, error in scheduler.crashed] == [("job", ZeroDivisionError)]


class TestGroups:
    @pytest.fixture(autouse=True)
    def virtual(self):
        self.beats = []
        with virtual_time() as self.scheduler:
            with self.scheduler.in_group("node"):
                started(self.beat)
            yield

    def beat(self):
        started(self.beat_too)  # a thread of a thread belongs to its group
        while True:
            clock.sleep(0.1)
            self.beats.append(clock.monotonic())

    def beat_too(self):
        while True:
            clock.sleep(0.1)
            self.beats.append(clock.monotonic())

    def test_a_suspended_group_stands_still_and_its_time_passes(self):
        clock.sleep(1.05)
        self.scheduler.suspended.add("node")
        clock.sleep(5.0)
        assert len(self.beats) == 20
        self.scheduler.suspended.clear()
        clock.sleep(0.01)
        assert [beat for beat in self.beats if beat > START_S + 5.0] == [pytest.approx(START_S + 6.05)] * 2

    @pytest.mark.parametrize("suspended", [False, True])
    def test_a_killed_group_unwinds(self, suspended):
        clock.sleep(1.05)
        if suspended:
            self.scheduler.suspended.add("node")
        self.scheduler.kill("node")
        clock.sleep(5.0)
        assert len(self.beats) == 20 and self.scheduler.crashed == []

    def test_where_all_others_are_suspended_the_test_is_told(self):
        self.scheduler.suspended.add("node")
        with pytest.raises(Stuck, match="suspended"):
            clock.Event().wait()
