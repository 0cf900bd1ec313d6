"""Laws of virtual time: no wake-up lost, time never backwards, one run per seed, and what is stuck is named."""

from __future__ import annotations

import queue
import signal
import sys
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
    handler = signal.getsignal(scheduling.SIGNAL)
    with virtual_time() as scheduler:
        assert clock.monotonic() == START_S and clock.Event is not threading.Event
        drawn = {scheduler.drawn(2.0) for _ in range(9)}
        assert len(drawn) == 9 and min(drawn) >= 0.0 and max(drawn) <= 2.0
    assert [getattr(clock, name) for name in clock.__all__] == before
    assert signal.getsignal(scheduling.SIGNAL) == handler
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


@pytest.mark.parametrize("seed", range(40))
@pytest.mark.parametrize("how", ["notify", "notify_all"])
def test_who_waits_for_a_condition_hears_whoever_then_takes_its_lock(how, seed):
    with virtual_time(seed):
        condition, heard = clock.Condition(), []

        def wait(seconds=1.0):
            with condition:
                clock.sleep(seconds)
                heard.append(condition.wait(9.0))

        def notify():
            clock.sleep(0.5)
            with condition:
                getattr(condition, how)()

        if how == "notify_all":
            started(lambda: wait(0.0))
            clock.sleep(0.125)
        run(wait, notify)
        clock.sleep(0.125)
        assert heard == ([True] if how == "notify" else [True, True])


def test_of_what_is_due_at_one_time_any_may_be_first():
    def order(seed):
        with virtual_time(seed):
            came = []
            (thread,) = started(lambda: (clock.sleep(1.0), came.append("first asked")))
            clock.sleep(0.5)
            clock.sleep(0.5)
            came.append("later asked")
            thread.join()
            return came[0]

    assert {order(seed) for seed in range(40)} == {"first asked", "later asked"}


def test_many_turns_at_one_time_are_none_too_many(monkeypatch):
    monkeypatch.setattr(scheduling, "SPINS", 100)
    with virtual_time():
        for _ in range(5):
            run(lambda: [clock.sleep(0.0) for _ in range(90)])
            clock.sleep(0.1)


@pytest.mark.parametrize("what", ["event", "lock"])
def test_who_wakes_another_may_have_to_wait_for_it(what):
    """A thread that sets, or releases, before it has done all that the other needs is found by some seed."""

    def outcome(seed):
        with virtual_time(seed):
            event, lock, done, seen = clock.Event(), clock.Lock(), [], []
            lock.acquire()
            (thread,) = started(
                lambda: seen.append((event.wait() if what == "event" else lock.acquire()) and len(done))
            )
            clock.sleep(1.0)
            event.set()
            if what == "lock":
                lock.release()
            done.append(1)
            thread.join()
            return seen[0]

    assert {outcome(seed) for seed in range(40)} == {0, 1}


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

    def test_what_came_in_time_leaves_no_deadline(self):
        event = clock.Event()
        started(lambda: event.wait(5.0))

        def later():
            event.wait(5.0)
            self.lasts(9.0, lambda: clock.sleep(9.0))

        (thread,) = started(later)
        clock.sleep(1.0)
        event.set()
        thread.join()
        assert self.scheduler.crashed == []

    def test_a_timer_calls_once_unless_it_is_cancelled(self):
        calls = []
        timers = [clock.Timer(0.5, calls.append, [name]) for name in "ab"]
        for timer in timers:
            timer.start()
        clock.sleep(0.4)
        timers[0].cancel()
        clock.sleep(1.0)
        assert calls == ["b"] and timers[1].finished.is_set()

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
                assert condition.wait(0.001 if virtual else 0.0) is False
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

    @pytest.fixture
    def impatient(self, monkeypatch):
        monkeypatch.setattr(scheduling, "POLL_S", 0.02)
        monkeypatch.setattr(scheduling, "POLLS", 50)  # who waits for a processor may look asleep

    @pytest.mark.parametrize("who", ["main", "job 0"])
    def test_a_thread_that_waits_outside_is_named_with_its_stack(self, impatient, who):
        outside = threading.Event()
        with virtual_time():
            for _ in range(2):
                with pytest.raises(Stuck) as stuck:
                    run(outside.wait) if who == "job 0" else outside.wait()
                assert f"waits outside of virtual time: {who}" in str(stuck.value)
                assert "self._cond.wait" in str(stuck.value)
            outside.set()

    @pytest.fixture
    def endless(self, impatient, monkeypatch):
        """A job that waits outside where it is to end."""
        monkeypatch.setattr(scheduling, "LAST_POLLS", 50)
        outside = threading.Event()

        def job():
            try:
                clock.sleep(9.0)
            finally:
                outside.wait()

        yield job
        outside.set()

    def test_one_that_does_not_end_is_named(self, endless):
        text = r"still there after the end: job 0 \(1\) waits for sleep\(9\)(?s:.*)outside.wait"
        with pytest.raises(Stuck, match=text), virtual_time():
            started(endless, lambda: clock.sleep(1.0))
            clock.sleep(2.0)

    def test_a_failure_of_the_test_comes_before_one_that_does_not_end(self, endless):
        with pytest.raises(ZeroDivisionError), virtual_time():
            started(endless)
            clock.sleep(1.0)
            raise ZeroDivisionError

    @pytest.mark.parametrize("who", ["main", "job 0"])
    def test_a_thread_that_computes_is_not(self, impatient, who):
        def compute():
            begun = time.thread_time()
            while time.thread_time() < begun + 0.3:
                pass

        with virtual_time():
            run(compute) if who == "job 0" else compute()

    @pytest.mark.parametrize("who", ["main", "job 0"])
    def test_a_loop_that_asks_for_the_time_and_never_waits_is_named(self, who):
        def spin():
            while clock.monotonic() < START_S + 1.0:
                pass

        with pytest.raises(Stuck, match=rf"asked 100000 times for .* waiting: {who}(?s:.*)in spin"), virtual_time():
            run(spin) if who == "job 0" else spin()

    def test_where_it_waits_now_and_then_it_is_not(self, monkeypatch):
        monkeypatch.setattr(scheduling, "SPINS", 10)

        def ask():
            for _ in range(30):
                clock.sleep(0.1)
                for _ in range(9):
                    clock.monotonic()

        with virtual_time():
            run(ask, ask)

    def test_who_has_killed_them_goes_on(self, monkeypatch):
        monkeypatch.setattr(scheduling, "SPINS", 100)

        def give_way():
            while True:
                clock.sleep(0.0)

        with virtual_time() as scheduler:
            with scheduler.in_group("node"):
                started(give_way)
            with pytest.raises(Stuck):
                clock.sleep(1.0)
            scheduler.kill("node")
            clock.sleep(1.0)

    @pytest.mark.parametrize("seed", SEEDS)
    def test_a_wake_up_from_before_is_none_for_the_next_wait(self, impatient, seed):
        outside = threading.Event()
        with virtual_time(seed):
            event = clock.Event()

            def job():
                clock.sleep(1.0)
                event.set()
                outside.wait()

            started(job)
            with pytest.raises(Stuck, match="outside.wait"):
                for _ in range(2):
                    event.wait()
                    event.clear()
            begun = clock.monotonic()
            clock.sleep(1.0)
            assert clock.monotonic() == begun + 1.0
            outside.set()

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

    def test_only_one_runs_at_a_time_and_only_once(self):
        with virtual_time() as scheduler, pytest.raises(RuntimeError), virtual_time():
            pass
        with pytest.raises(RuntimeError), scheduler:
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

    @pytest.mark.parametrize("seed", SEEDS)
    def test_a_signal_ends_all_other_threads_and_the_test_goes_on_alone(self, seed):
        """As at Ctrl-C, or where pytest's time is up: fixtures then end in virtual time."""

        def interrupt(*_):
            raise ZeroDivisionError

        def job():
            clock.sleep(1.0)
            signal.pthread_kill(threading.main_thread().ident, signal.SIGUSR1)
            wait()

        def wait():
            while True:
                clock.sleep(0.01)

        before = signal.signal(signal.SIGUSR1, interrupt)
        try:
            with virtual_time(seed):
                condition = clock.Condition()
                threads = started(job, wait, wait, lambda: clock.Event().wait())
                with pytest.raises(ZeroDivisionError), condition:
                    condition.wait()
                assert not any(threading.Thread.is_alive(thread) for thread in threads)
                for thread in threads:
                    thread.join()
                begun = clock.monotonic()
                run(lambda: clock.sleep(1.0), lambda: clock.sleep(2.0))
                assert clock.monotonic() == begun + 2.0
        finally:
            signal.signal(signal.SIGUSR1, before)

    @pytest.mark.real
    def test_a_thread_that_computes_for_ever_ends_with_the_rest(self, monkeypatch):
        """It never gives way: pytest's time is up, and the next test must run."""
        monkeypatch.setattr(scheduling, "POLL_S", 0.02)
        monkeypatch.setattr(scheduling, "LAST_POLLS", 50)

        def interrupt(*_):
            raise ZeroDivisionError

        def compute():
            while True:
                pass

        before = signal.signal(signal.SIGUSR1, interrupt)
        main = threading.main_thread().ident
        try:
            with pytest.raises(ZeroDivisionError), virtual_time():
                threads = started(compute)
                threading.Timer(0.1, lambda: signal.pthread_kill(main, signal.SIGUSR1)).start()
                clock.sleep(1.0)
            assert not threading.Thread.is_alive(threads[0])
        finally:
            signal.signal(signal.SIGUSR1, before)

    def test_objects_of_another_virtual_time_say_that_it_is_over(self):
        with virtual_time():
            event, lock, thread = clock.Event(), clock.Lock(), clock.Thread(target=lambda: None)
        event.set()
        assert event.is_set() and not lock.locked() and not thread.is_alive()
        for what in (lock.acquire, thread.start, event.wait):
            with pytest.raises(RuntimeError, match="virtual time is over"):
                what()

    def test_a_thread_that_fails_is_noted(self, monkeypatch):
        reported = []
        monkeypatch.setattr(threading, "excepthook", lambda args: reported.append(args.exc_type))
        with virtual_time() as scheduler:
            run(lambda: 1 // 0)
            run(sys.exit)
            run(lambda: threading.current_thread().join())
        assert reported == [ZeroDivisionError, RuntimeError]
        assert [name for name, _ in scheduler.crashed] == ["job 0 (1)", "job 0 (3)"]


class TestWhoGoesLeavesNobodyWaiting:
    """Two wait; the one that is woken is killed, or suspended, before it comes to take what it was woken for."""

    @pytest.mark.parametrize("seed", SEEDS)
    @pytest.mark.parametrize("what", ["lock", "condition", "queue", "kept queue"])
    @pytest.mark.parametrize("how", ["killed", "suspended"])
    def test_the_other_gets_it(self, what, how, seed):
        with virtual_time(seed) as scheduler:
            lock, condition, items, came = clock.Lock(), clock.Condition(), clock.Queue(), []

            def take(name):
                if what == "lock":
                    lock.acquire()
                elif what == "condition":
                    with condition:
                        condition.wait()
                else:
                    items.get()
                came.append(name)

            lock.acquire()
            for group in ("one", "other"):
                with scheduler.in_group(group):
                    started(lambda group=group: take(group))
            clock.sleep(1.0)
            if how == "suspended":
                scheduler.suspended.add("one")
            if what == "lock":
                lock.release()
            elif what == "condition":
                with condition:
                    condition.notify()
            elif what == "queue":
                items.put(1)
            else:
                with items.mutex:  # both are woken, and wait for it
                    items._put(1)
                    items.not_empty.notify()
                    clock.sleep(1.0)
                    scheduler.kill("one") if how == "killed" else None
            if how == "killed":
                scheduler.kill("one")
            clock.sleep(1.0)
            assert came in (["other"], ["one"] if how == "killed" and "one" in came else ["other"])
            assert scheduler.crashed == []

    @pytest.mark.parametrize("seed", SEEDS)
    def test_nobody_is_woken_for_one_that_was_woken_with_all(self, seed):
        with virtual_time(seed) as scheduler:
            event = clock.Event()
            with scheduler.in_group("node"):
                started(event.wait, event.wait)
            clock.sleep(1.0)
            event.set()
            event.clear()
            seen = []
            started(lambda: seen.append(event.wait(1.0)))
            scheduler.kill("node")
            clock.sleep(2.0)
            assert seen == [False]

    def test_a_lock_that_a_suspended_thread_has_is_waited_for(self):
        with virtual_time() as scheduler:
            lock = clock.Lock()

            def hold():
                with lock:
                    clock.sleep(1.0)

            with scheduler.in_group("node"):
                started(hold)
            clock.sleep(0.5)
            scheduler.suspended.add("node")
            assert not lock.acquire(timeout=5.0)
            with pytest.raises(Stuck, match=r"which job 0 \(1\) has(?s:.*)sleep\(1\), suspended"):
                lock.acquire()
            scheduler.suspended.clear()
            assert lock.acquire(timeout=0.0) is False
            assert lock.acquire(timeout=0.1)

    def test_a_killed_thread_gives_back_what_it_has_and_leaves_alone_what_it_lost(self):
        with virtual_time() as scheduler:
            condition, again = clock.Condition(), clock.RLock()

            def job():
                with again, again, condition:
                    condition.wait()

            with scheduler.in_group("node"):
                started(job)
            clock.sleep(1.0)
            with condition:
                scheduler.kill("node")
                assert again.acquire(blocking=False)
                condition.notify()
            assert scheduler.crashed == []

    def test_a_group_ends_itself_but_for_the_thread_that_asks(self):
        with virtual_time() as scheduler:
            ended = []

            def job():
                started(lambda: clock.Event().wait(), lambda: clock.sleep(9.0))
                clock.sleep(1.0)
                scheduler.kill("node")
                clock.sleep(1.0)
                ended.append(clock.monotonic())

            with scheduler.in_group("node"):
                started(job)
            clock.sleep(3.0)
            assert ended == [START_S + 2.0] and [task.name for task in scheduler._tasks] == ["main"]

    @pytest.mark.parametrize("seed", range(5))
    def test_what_becomes_of_a_group_does_not_become_of_who_makes_its_threads(self, seed, monkeypatch):
        monkeypatch.setattr(scheduling, "GIVES_WAY", 1.0)
        with virtual_time(seed) as running, running.in_group("node"):
            started(lambda: running.kill("node"), lambda: running.suspended.add("node"))
