"""Run numbered attempts in worker processes that a Ctrl-C never reaches."""

import contextlib
import os
import signal
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from multiprocessing import get_context


def run_numbered[Result](
    function: Callable[[int], Result], next_number: Callable[[int], int | None], workers: int
) -> Generator[Result]:
    """Yield `function(n)` as they finish.

    An interrupt lets the running calls finish and yields nothing more, so that no work is lost that
    `function` stored itself.

    Args:
        function: Called in a worker process (importable and picklable), or here if `workers` is 0.
        next_number: Given how many calls are running, the next number or None to wait or stop.
        workers: Number of worker processes.
    """
    if workers == 0:
        while (number := next_number(0)) is not None:
            yield function(number)
        return
    pending: set[Future] = set()
    with _single_threaded(), ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        try:
            while True:
                while len(pending) < workers and (number := next_number(len(pending))) is not None:
                    with _interrupts_blocked():
                        pending.add(pool.submit(function, number))
                if not pending:
                    return
                done, pending = wait(pending, return_when=FIRST_COMPLETED)
                for future in done:
                    yield future.result()
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


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
