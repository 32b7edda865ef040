"""Work in several processes."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import psutil
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from chromagrip.errors import UserError
from chromagrip.output.processes import exit_on_sigterm, map_processes, one_thread

SCRIPT = """
import os, time
from chromagrip.output.processes import map_processes

def work(task):
    print(os.getpid(), flush=True)
    time.sleep(60.0)

if __name__ == "__main__":
    list(map_processes(work, range(4), 2))
"""


@pytest.fixture
def square():
    def local(task: int) -> int:  # a worker cannot import this module
        if task == 99:
            raise KeyError("a bug")
        if task == 98:
            os.kill(os.getpid(), signal.SIGKILL)
        return task**2

    return local


@pytest.fixture
def threads():
    def local(task: int) -> tuple[int, int, set[int]]:
        time.sleep(0.2)
        return os.getpid(), cv2.getNumThreads(), {info["num_threads"] for info in threadpool_info()}

    return local


@pytest.mark.parametrize("workers", [1, 2])
def test_results_come_in_the_order_of_the_tasks_when_asked_for(square, workers):
    counts = []
    results = map_processes(
        square, range(7), workers, lambda *count: counts.append(count), done=3, ordered=True
    )
    assert list(results) == [0, 1, 4, 9, 16, 25, 36]
    assert counts == [(done, 10) for done in range(3, 11)]
    with pytest.raises(KeyError, match="a bug"):
        list(map_processes(square, [1, 99, 2, 3], workers))
    assert sorted(map_processes(square, range(4), workers)) == [0, 1, 4, 9]


@pytest.mark.parametrize("workers", [1, 2])
def test_a_task_has_one_thread(threads, workers, monkeypatch):
    """Also where this process has more, which the tests of a worker of pytest have not."""
    monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    before = cv2.getNumThreads()
    try:
        cv2.setNumThreads(2)
        with threadpool_limits(2):
            assert {info["num_threads"] for info in threadpool_info()} == {2}
            results = list(map_processes(threads, range(2), workers))
            assert cv2.getNumThreads() == 2
        with one_thread():
            assert cv2.getNumThreads() == 1
        assert cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(before)
    assert len({process for process, _, _ in results}) == workers
    assert all(opencv == 1 and pools == {1} for _, opencv, pools in results)


def test_a_dead_worker_is_a_sentence_and_the_next_call_works(square):
    with pytest.raises(UserError, match=r"a worker was killed .* fewer --workers"):
        list(map_processes(square, [1, 98, 2, 3], 2))
    assert sorted(map_processes(square, range(3), 2)) == [0, 1, 4]


def gone(process: psutil.Process) -> bool:
    """Whether it has ended; one that nobody has waited for is listed still."""
    try:
        return process.status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


@pytest.mark.fuzz
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_the_process_that_waits(number, tmp_path, until):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    with subprocess.Popen(
        [sys.executable, "-P", script], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as process:
        workers = {psutil.Process(int(process.stdout.readline())) for _ in range(2)}
        assert len(workers) == 2
        process.send_signal(number)
        process.wait(20.0)
    until(lambda: all(map(gone, workers)), 20.0)


def test_sigterm_is_an_exit_inside_the_block_only():
    before = signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        with pytest.raises(SystemExit, match="143"), exit_on_sigterm():
            signal.raise_signal(signal.SIGTERM)
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    finally:
        signal.signal(signal.SIGTERM, before)


def test_kept_workers_find_the_modules_of_the_folder_that_one_works_in_now(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def found(task: int) -> tuple[str, str]:
        import importlib

        return importlib.import_module(f"made_in_{task}").WORD, Path.cwd().name

    for task in (1, 2):
        folder = tmp_path / str(task)
        folder.mkdir()
        (folder / f"made_in_{task}.py").write_text(f"WORD = 'of {task}'\n", encoding="utf-8")
        monkeypatch.chdir(folder)
        monkeypatch.syspath_prepend(folder)
        assert list(map_processes(found, [task, task], 2)) == [(f"of {task}", str(task))] * 2
