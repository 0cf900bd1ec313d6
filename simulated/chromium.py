"""A browser without a window, which tests of pages drive over its DevTools protocol."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import signal
import subprocess
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Callable


@contextlib.contextmanager
def browser(address: str, folder: Path, wait_until: Callable[..., Any], size: str = "800,500") -> Iterator[Any]:
    """Opens the page and yields a function that evaluates JavaScript in it; its attribute `picture` writes a PNG,
    `call` calls a method of the protocol, `devtools` is its host, `pid` is the process. Any certificate is good enough.
    """
    from websockets.sync.client import connect

    program = subprocess.Popen(
        ["chromium", "--headless", "--no-sandbox", "--remote-debugging-port=0", f"--user-data-dir={folder}",
         "--ignore-certificate-errors", f"--window-size={size}", address],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env={**os.environ, "HOME": str(folder)},
        start_new_session=True,
    )  # fmt: skip
    try:
        active = folder / "DevToolsActivePort"
        wait_until(lambda: active.exists() and active.read_text().strip(), 60.0, "the browser")
        port = active.read_text().split()[0]

        def page() -> Any:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=30.0) as answer:
                found = [p for p in json.load(answer) if p["type"] == "page" and p["url"] == address]
            return found and found[0]["webSocketDebuggerUrl"]

        with connect(wait_until(page, 30.0, "the page"), max_size=None) as connection:

            def call(method: str, **params: Any) -> Any:
                connection.send(json.dumps({"id": 1, "method": method, "params": params}))
                return json.loads(connection.recv(timeout=30.0))["result"]

            def evaluate(expression: str) -> Any:
                answer = call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
                assert "exceptionDetails" not in answer, answer
                return answer["result"].get("value")

            def picture(path: Path) -> None:
                path.write_bytes(base64.b64decode(call("Page.captureScreenshot")["data"]))

            vars(evaluate).update(picture=picture, call=call, pid=program.pid, devtools=f"127.0.0.1:{port}")
            yield evaluate
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(program.pid, signal.SIGKILL)
        program.wait(10.0)
