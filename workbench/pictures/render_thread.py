"""One thread that makes, uses and ends a VTK scene, whatever thread asks."""

import queue
import threading
import weakref
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any


class RenderThread:
    """Owns a scene that never leaves its thread; calls run one after the other.

    Not a thread pool: a pool is joined when Python is already half gone, and VTK has to be gone before.
    """

    def __init__(self, make: Callable[[], Any], end: Callable[[Any], None]) -> None:
        calls: queue.SimpleQueue = queue.SimpleQueue()
        made: Future = Future()
        thread = threading.Thread(target=_serve, args=(calls, made, make, end), name="head-renderer", daemon=True)
        thread.start()
        self._calls = calls
        self._stop = weakref.finalize(self, _stop, calls, thread)
        made.result()

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future:
        """Queue `function(scene, *arguments)`; the future has its result or exception."""
        future: Future = Future()
        self._calls.put((future, function, arguments))
        return future

    @property
    def running(self) -> bool:
        """Whether calls are still taken."""
        return self._stop.alive

    def stop(self) -> None:
        """Finish what is queued, end the scene and the thread; stopping twice is fine."""
        self._stop()


def _serve(calls: queue.SimpleQueue, made: Future, make: Callable, end: Callable) -> None:
    try:
        scene = make()
    except BaseException as error:
        made.set_exception(error)
        return
    made.set_result(None)
    while (call := calls.get()) is not None:
        future, function, arguments = call
        if future.set_running_or_notify_cancel():
            try:
                future.set_result(function(scene, *arguments))
            except BaseException as error:
                future.set_exception(error)
    end(scene)


def _stop(calls: queue.SimpleQueue, thread: threading.Thread) -> None:
    calls.put(None)
    if thread is not threading.current_thread():
        thread.join(timeout=10)
