"""asyncio in virtual time: its own event loop, whose time, sockets and threads are those of the simulation."""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import inspect
from collections.abc import Callable, Coroutine
from typing import TYPE_CHECKING, Any

from common import clock
from simulated.scheduler import Killed

if TYPE_CHECKING:
    from simulated.wires import Wires


class EventLoop(asyncio.SelectorEventLoop):
    """As asyncio.new_event_loop(), on wires."""

    def __init__(self, wires: Wires) -> None:
        self._wires, self._killed = wires, False
        super().__init__(wires.selector())  # type: ignore[arg-type]

    def time(self) -> float:
        """Virtual time [s]."""
        return clock.monotonic()

    def run_forever(self) -> None:
        """Runs until it is stopped; where its thread is killed, its coroutines unwind, too."""
        try:
            super().run_forever()
        except Killed:
            self._killed = True
            while coroutines := [each for task in asyncio.all_tasks(self) if _is_open(each := task.get_coro())]:
                with contextlib.suppress(Killed, RuntimeError):  # it may wait once more, or begin others, as it unwinds
                    coroutines[0].throw(Killed)
            raise

    async def create_connection(  # type: ignore[override]
        self, factory: Any, host: Any = None, port: Any = None, *, sock: Any = None, local_addr: Any = None, **more: Any
    ) -> Any:
        """Connects on wires."""
        if sock is None:
            sock = await self.run_in_executor(None, self._wires.connect, (host, port))
            sock.setblocking(False)
        return await super().create_connection(factory, sock=sock, **more)

    def run_in_executor(self, _executor: Any, job: Callable[..., Any], *args: Any) -> Any:  # type: ignore[override]
        """Does the job in a thread of its own."""
        outcome: concurrent.futures.Future[Any] = concurrent.futures.Future()

        def work() -> None:
            try:
                outcome.set_result(job(*args))
            except Exception as error:
                outcome.set_exception(error)

        clock.Thread(target=work, name="executor", daemon=True).start()
        return asyncio.wrap_future(outcome, loop=self)

    def call_exception_handler(self, context: dict[str, Any]) -> None:
        """Says what went wrong, but not that the thread was killed: the next look at the time unwinds it."""
        if not self._killed and not isinstance(context.get("exception"), Killed):
            super().call_exception_handler(context)

    def _make_self_pipe(self) -> None:
        """The pair of sockets by which another thread wakes the loop."""
        self._ssock, self._csock = self._wires.pair()
        self._ssock.setblocking(False)
        self._csock.setblocking(False)
        self._internal_fds += 1  # type: ignore[attr-defined]
        self._add_reader(self._ssock.fileno(), self._read_from_self)  # type: ignore[attr-defined]


def _is_open(coroutine: Any) -> bool:
    return inspect.getcoroutinestate(coroutine) != inspect.CORO_CLOSED


class Outcome:
    """What asyncio.run_coroutine_threadsafe returns, awaited in virtual time."""

    def __init__(self, coroutine: Coroutine[Any, Any, Any], loop: asyncio.AbstractEventLoop) -> None:
        self._future, self._done = asyncio.run_coroutine_threadsafe(coroutine, loop), clock.Event()
        self._future.add_done_callback(lambda _: self._done.set())

    def result(self, timeout: float | None = None) -> Any:
        """Waits for the result; raises concurrent.futures.TimeoutError if it does not come in time."""
        if not self._done.wait(timeout):
            raise concurrent.futures.TimeoutError
        return self._future.result()
