"""Work in several processes, each with one thread, that end with the process that waits for them.

    for result in map_processes(function, tasks, workers=2):
        ...

A worker takes about 2 s to start and 320 MB. Workers are kept for the next call and end with this
process: at its normal end, with an exception, with Ctrl-C, with SIGTERM and when it is killed.
"""

import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import cache, lru_cache
from typing import Any, TypeVar

import cv2
from threadpoolctl import ThreadpoolController, threadpool_limits

from ..errors import UserError

Task = TypeVar("Task")
Result = TypeVar("Result")
#: Called with the number of tasks that are done and the number of all tasks.
Progress = Callable[[int, int], None]


def map_processes(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    workers: int,
    progress: Progress = lambda done, total: None,
    *,
    done: int = 0,
    ordered: bool = False,
    advice: str = "give fewer --workers",
) -> Generator[Result, None, None]:
    """Apply a function to each task, in several processes with one thread each.

    Ending the iteration early (`break` in a loop over `contextlib.closing(map_processes(...))`) or
    an exception ends the workers. The exception of a task is raised here.

    Parameters
    ----------
    function: may be defined anywhere, `__main__` included
    tasks: its arguments, one each; started in this order
    workers: number of processes; 1 computes in this process
    progress: called at the start, and before each result is yielded
    done: tasks that were done before, which `progress` counts too
    ordered: yield results in the order of the tasks; else as they come
    advice: what the message of a worker that was killed ends with

    Raises
    ------
    UserError
        When a worker was killed.
    """
    total = done + len(tasks)
    progress(done, total)
    if not tasks:
        return
    workers = min(workers, len(tasks))
    with (
        exit_on_sigterm(),
        closing(_results(function, tasks, workers, ordered, advice)) as results,
    ):
        for result in results:
            done += 1
            progress(done, total)
            yield result


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit BLAS, OpenMP and OpenCV to one thread in this process."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with _pools(len(sys.modules)).limit(limits=1):
            yield
    finally:
        cv2.setNumThreads(threads)


@lru_cache(maxsize=1)
def _pools(modules: int) -> ThreadpoolController:
    """Thread pools of this process; looking for them takes 2 ms.

    Parameters
    ----------
    modules: how many are loaded; another number may have brought another library
    """
    return ThreadpoolController()


@contextmanager
def exit_on_sigterm() -> Iterator[None]:
    """Make SIGTERM raise `SystemExit` in the main thread, so that what is open is closed.

    Nothing changes in other threads, or where a handler is set already.
    """

    def leave(number: int, frame: Any) -> None:
        sys.exit(128 + number)

    if (
        threading.current_thread() is not threading.main_thread()
        or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
    ):
        yield
        return
    signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _results(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    workers: int,
    ordered: bool,
    advice: str,
) -> Generator[Result, None, None]:
    if workers > 1:
        from joblib import effective_n_jobs

        workers = effective_n_jobs(workers)  # 1 on a machine whose /dev/shm cannot be written
    if workers == 1:
        for task in tasks:
            with one_thread():
                result = function(task)
            yield result
        return
    from joblib import Parallel, delayed, parallel_config
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    # Kernels and tables make a worker grow, and loky replaces one that has grown; nothing is lost.
    warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
    with parallel_config("loky", inner_max_num_threads=1):
        parallel = Parallel(
            n_jobs=workers,
            return_as="generator" if ordered else "generator_unordered",
            pre_dispatch="2*n_jobs",
            max_nbytes=None,  # arrays are copied: a mapped file is read-only
        )
    where = os.getcwd(), tuple(sys.path)
    results = parallel(delayed(_work)(os.getpid(), where, function, task) for task in tasks)
    try:
        for result in results:  # `yield from` would close `results` outside the `finally`
            yield result
    except TerminatedWorkerError:
        raise UserError(f"a worker was killed (out of memory?); {advice}") from None
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of tasks that are cancelled
            results.close()


def _work(
    parent: int,
    where: tuple[str, tuple[str, ...]],
    function: Callable[[Task], Result],
    task: Task,
) -> Result:
    """Apply the function to a task in a worker.

    Parameters
    ----------
    where: folder and module path of the parent now; a kept worker has those of its own start
    """
    _start_worker(parent)
    folder, sys.path[:] = where[0], where[1]
    os.chdir(folder)
    return function(task)


@cache
def _start_worker(parent: int) -> None:
    """Limit a worker to one thread; Ctrl-C is handled by the parent, whose end is its end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)
    threadpool_limits(1)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    check_s = 0.5  # interval at which a worker checks that the process it works for is alive [s]
    while os.getppid() == parent:
        time.sleep(check_s)
    os._exit(1)
