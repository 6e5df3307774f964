"""Run calls in worker processes that a Ctrl-C never reaches and that never outlive this process."""

import contextlib
import ctypes
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait

_PR_SET_PDEATHSIG = 1
"""Of prctl(2)."""


def run_each[Item, Result](
    function: Callable[[Item], Result], next_item: Callable[[int], Item | None], workers: int
) -> Generator[Result]:
    """Yield `function(item)` of every item as they finish.

    An interrupt lets the running calls finish and yields nothing more, so that no work is lost that
    `function` stored itself. Workers end when this process does, even if it is killed.

    Args:
        function: Called in a worker process (importable and picklable), or here if `workers` is 0.
        next_item: Given how many calls are running, the next item (picklable), or None to wait or stop.
        workers: Number of worker processes.
    """
    if workers == 0:
        while (item := next_item(0)) is not None:
            yield function(item)
        return
    pending: set[Future] = set()
    spawn = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=spawn, initializer=_end_with_parent)
    with _single_threaded(), pool:
        try:
            while True:
                while len(pending) < workers and (item := next_item(len(pending))) is not None:
                    with _interrupts_blocked():
                        pending.add(pool.submit(function, item))
                if not pending:
                    return
                done, pending = wait(pending, return_when=FIRST_COMPLETED)
                for future in done:
                    yield future.result()
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def _end_with_parent() -> None:
    """Let this worker end with the process that started it: a killed one cannot tell its workers to stop."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    if sys.platform == "linux":  # At once, even from within compiled code that holds the interpreter's lock.
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextlib.contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Hold back Ctrl-C while a worker starts: it inherits the mask, so only this process hears it."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


@contextlib.contextmanager
def _single_threaded() -> Iterator[None]:
    """Give workers one BLAS thread each unless the user chose otherwise; more only fight for the cores."""
    chosen = "OMP_NUM_THREADS" in os.environ
    if not chosen:
        os.environ["OMP_NUM_THREADS"] = "1"
    try:
        yield
    finally:
        if not chosen:
            del os.environ["OMP_NUM_THREADS"]
