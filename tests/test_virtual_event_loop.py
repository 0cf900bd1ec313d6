"""asyncio in virtual time: its timers are exact, and loops, threads and sockets meet as they do by the real clock."""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common import clock
from leap_motion.client import LeapClient
from rig_simulation.devices.leap.server import SimulatedLeapService
from rig_simulation.operator.motion import Script
from rig_simulation.operator.sources import Playback, ScriptedOperator
from simulated.clock import virtual_time
from simulated.event_loop import EventLoop, Outcome
from simulated.wires import DELAY_S, Wires

EXACT_S = 2e-6
HOUR_S = 3600.0


@pytest.fixture
def wires():
    with virtual_time() as scheduler:
        yield Wires(scheduler)


def run(wires, coroutine):
    """Returns what the coroutine returns, on a loop of its own."""
    loop = EventLoop(wires)
    with contextlib.closing(loop):
        return loop.run_until_complete(coroutine)


def in_thread(wires, coroutine):
    """Runs a coroutine in a thread of its own; returns loop and thread."""
    loop = EventLoop(wires)

    def work():
        with contextlib.closing(loop):
            loop.run_until_complete(coroutine)

    thread = clock.Thread(target=work, daemon=True)
    thread.start()
    return loop, thread


@given(st.lists(st.integers(0, 3_600_000), max_size=20, unique=True), st.integers(0, 100))
def test_timers_come_when_they_are_due_and_in_this_order(milliseconds, seed):
    delays = [1e-3 * each for each in milliseconds]
    with virtual_time(seed) as scheduler:
        begun, come = scheduler.now, []

        async def wait():
            loop = asyncio.get_running_loop()
            for delay in delays:
                loop.call_later(delay, lambda delay=delay: come.append((delay, scheduler.now - begun)))
            await asyncio.sleep(HOUR_S + 1.0)

        run(Wires(scheduler), wait())
        assert [delay for delay, _ in come] == sorted(delays)
        assert [at for _, at in come] == pytest.approx(sorted(delays), abs=EXACT_S)
        assert scheduler.now - begun == pytest.approx(HOUR_S + 1.0, abs=EXACT_S)


def test_a_task_that_is_cancelled_or_too_slow_ends_then_and_cleans_up(wires):
    ends = []

    async def sleeper():
        try:
            await asyncio.sleep(HOUR_S)
        finally:
            ends.append(clock.monotonic())

    async def both():
        task = asyncio.ensure_future(sleeper())
        await asyncio.sleep(1.0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        with pytest.raises(asyncio.TimeoutError):
            await asyncio.wait_for(sleeper(), 2.0)

    begun = clock.monotonic()
    run(wires, both())
    assert [end - begun for end in ends] == pytest.approx([1.0, 3.0], abs=EXACT_S)


def test_each_of_two_loops_has_its_own_timers_at_the_same_time(wires):
    come = []

    async def tick(name, period):
        for _ in range(3):
            await asyncio.sleep(period)
            come.append((round(clock.monotonic() - begun, 5), name))

    begun = clock.monotonic()
    threads = [in_thread(wires, tick(name, period))[1] for name, period in (("a", 0.2), ("b", 0.3))]
    for thread in threads:
        thread.join()
    assert come[:3] + come[-1:] == [(0.2, "a"), (0.3, "b"), (0.4, "a"), (0.9, "b")]
    assert sorted(come[3:5]) == [(0.6, "a"), (0.6, "b")]


def test_another_thread_wakes_a_loop_at_once(wires):
    async def wait():
        woken.append(asyncio.Event())
        await woken[0].wait()
        return clock.monotonic()

    async def answer(number):
        return number + 1

    loop = EventLoop(wires)
    woken, times = [], []
    thread = clock.Thread(target=lambda: times.append(loop.run_until_complete(wait())))
    thread.start()
    clock.sleep(1.0)
    begun = clock.monotonic()
    assert Outcome(answer(1), loop).result(1.0) == 2
    with pytest.raises(concurrent.futures.TimeoutError):
        Outcome(asyncio.sleep(HOUR_S), loop).result(0.5)
    assert clock.monotonic() - begun == pytest.approx(0.5, abs=EXACT_S)
    loop.call_soon_threadsafe(woken[0].set)
    thread.join()
    assert times == [pytest.approx(begun + 0.5, abs=EXACT_S)]
    loop.close()
    with pytest.raises(RuntimeError):
        loop.call_soon_threadsafe(woken[0].set)


def test_a_loop_goes_on_while_an_executor_works(wires):
    async def both():
        loop, begun = asyncio.get_running_loop(), clock.monotonic()
        work = loop.run_in_executor(None, clock.sleep, 2.0)
        await asyncio.sleep(1.0)
        assert not work.done()
        await work
        with pytest.raises(ZeroDivisionError):
            await loop.run_in_executor(None, lambda: 1 / 0)
        return clock.monotonic() - begun

    assert run(wires, both()) == pytest.approx(2.0, abs=EXACT_S)


def test_a_server_echoes_and_waits_where_its_client_reads_nothing(wires):
    said = []

    async def converse(reader, writer):
        writer.write(await reader.read(100))
        await writer.drain()
        writer.write(bytes(200_000))
        await writer.drain()
        said.append(("all written", clock.monotonic() - begun))
        writer.close()

    async def serve():
        async with await asyncio.start_server(converse, sock=listener, limit=1000):
            await asyncio.sleep(10.0)

    listener = wires.serve(("127.0.0.1", 0))
    _, thread = in_thread(wires, serve())
    begun = clock.monotonic()
    client = wires.connect(listener.getsockname())
    wires.connections[0].down.room = 50_000
    client.sendall(b"hello")
    assert client.recv(5) == b"hello" and clock.monotonic() - begun == pytest.approx(4 * DELAY_S, abs=EXACT_S)
    clock.sleep(1.0)
    assert not said, "what does not fit into the connection waits"
    count = 0
    while data := client.recv(100_000):
        count += len(data)
    assert count == 200_000 and said == [("all written", pytest.approx(1.0, abs=0.01))]
    thread.join()
    with pytest.raises(ConnectionRefusedError):
        wires.connect(listener.getsockname())


@pytest.mark.parametrize(("options", "error", "after"), [((0.5,), TimeoutError, 0.5), ((0.0,), BlockingIOError, 0.0)])
def test_a_full_connection_lets_its_sender_wait(wires, options, error, after):
    near, far = wires.pair()
    far.incoming.room = 10
    near.settimeout(*options)
    assert near.send(b"0123456") == 7 and near.send(b"0123456") == 3
    begun = clock.monotonic()
    with pytest.raises(error):
        near.send(b"x")
    assert clock.monotonic() - begun == pytest.approx(after, abs=EXACT_S)
    assert far.recv(4) == b"0123" and near.send(b"0123456") == 4


def test_what_unwinds_with_its_thread_says_nothing_and_ends_its_coroutines(capfd):
    ended = []

    async def waits(name):
        try:
            await asyncio.sleep(HOUR_S)
            yield name
        finally:
            ended.append(name)
            await asyncio.sleep(1.0)

    async def consumes(name):
        async for _ in waits(name):
            pass

    async def both():
        other = asyncio.ensure_future(consumes("other"))
        await consumes("main")
        await other

    with virtual_time() as scheduler:
        in_thread(Wires(scheduler), both())
        clock.sleep(1.0)
    assert sorted(ended) == ["main", "other"]
    assert capfd.readouterr() == ("", "")


def test_only_addresses_of_this_machine_can_be_served(wires):
    for host in ("127.0.0.1", "localhost", "0.0.0.0", ""):
        assert wires.serve((host, 0)).family == socket.AF_INET
    with pytest.raises(OSError, match="assign requested address"):
        wires.serve(("192.0.2.1", 0))


@pytest.mark.parametrize("seed", range(3))
def test_one_seed_makes_one_run(seed):
    def traced():
        with pytest.MonkeyPatch.context() as patch, virtual_time(seed, trace=True) as scheduler:
            Wires(scheduler).stand_in(patch)
            service = SimulatedLeapService(Playback(ScriptedOperator(Script())), "127.0.0.1", 0, 0)
            thread = clock.Thread(target=service.run, daemon=True)
            thread.start()
            clients = [LeapClient(port=service.port, runtime=clock) for _ in range(2)]
            clock.sleep(0.5)
            for client in clients:
                client.close()
            service.stop()
            thread.join()
        return scheduler.trace

    first = traced()
    assert len(first) > 200 and traced() == first
