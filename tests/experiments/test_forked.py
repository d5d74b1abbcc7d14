"""A grid in forks: the same as in threads, whoever fails or is killed."""

import os
import signal
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import pytest

from processes import run as run_program
from sigmaswarm.errors import InputError, SigmaswarmError
from sigmaswarm.experiments.forked import forked
from sigmaswarm.experiments.grid import Tell, run_grid
from sigmaswarm.files import held_folder

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="nothing is forked here")


def in_forks(run: Callable[[int, Tell], object], tasks: int = 6, **options: object) -> dict[int, object]:
    with ThreadPoolExecutor(2) as pool, forked(run, 2) as asked:
        return run_grid(range(tasks), asked, pool, **options)  # pyright: ignore[reportArgumentType]


def test_tasks_are_done_in_other_processes_and_told_of():
    told: list[tuple[int, int, int]] = []

    def note(done: int, total: int, task: int) -> None:
        told.append((done, total, task))

    def run(task: int, tell: Tell) -> tuple[int, int]:
        tell(1)
        time.sleep(0.01)
        return 10 * task, os.getpid()

    found = in_forks(run, rounds=2, progress=note)
    assert [value for value, _ in found.values()] == [0, 10, 20, 30, 40, 50]  # pyright: ignore
    processes = {process for _, process in found.values()}  # pyright: ignore
    assert len(processes) == 2
    assert os.getpid() not in processes
    assert [done for done, _, _ in told] == list(range(1, 13))
    assert sorted(task for _, _, task in told) == sorted(2 * [*range(6)])
    for process in processes:
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)


def test_an_error_is_the_task_s_own_and_says_where():
    def refuse(task: int, tell: Tell) -> None:
        raise InputError(f"{task}: is refused")

    with pytest.raises(InputError, match="is refused") as refused:
        in_forks(refuse)
    assert not hasattr(refused.value, "__notes__")

    def stumble(task: int, tell: Tell) -> None:
        {}["nothing"]

    with pytest.raises(KeyError) as stumbled:
        in_forks(stumble)
    assert "in stumble" in stumbled.value.__notes__[0]


def test_a_task_that_fails_leaves_its_process_for_the_next():
    def run(task: int, tell: Tell) -> int:
        if task == 0:
            raise InputError("the first")
        return os.getpid()

    with forked(run, 1) as asked:
        with pytest.raises(InputError):
            asked(0, print)
        assert asked(1, print) == asked(2, print) != os.getpid()


def test_an_interruption_ends_the_others(tmp_path: Path):
    def run(task: int, tell: Tell) -> None:
        for k in range(1, 1000):
            with (tmp_path / str(task)).open("a") as file:
                file.write(".")
            tell(k)
            time.sleep(0.005)

    def interrupt(done: int, total: int, task: int) -> None:
        if done == 20:
            raise KeyboardInterrupt

    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        in_forks(run, rounds=1000, progress=interrupt)
    assert time.monotonic() - began < 4.0
    assert all(len(file.read_text()) < 500 for file in tmp_path.iterdir())


def test_a_killed_process_is_told_of():
    def run(task: int, tell: Tell) -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    with pytest.raises(SigmaswarmError, match="was killed, perhaps for want of memory; go on with --resume"):
        in_forks(run)


def test_where_nothing_can_be_forked_it_is_done_here(monkeypatch: pytest.MonkeyPatch):
    def refuse() -> int:
        raise BlockingIOError("no more processes")

    monkeypatch.setattr(os, "fork", refuse)
    assert set(in_forks(lambda task, tell: os.getpid()).values()) == {os.getpid()}


def test_a_fork_ends_with_its_parent(tmp_path: Path):
    program = (
        "import os, signal, time\n"
        "from pathlib import Path\n"
        "from sigmaswarm.experiments.forked import forked\n"
        "def run(task, tell):\n"
        "    tell(1)\n"
        "    time.sleep(1.0)\n"
        f"    Path({str(tmp_path / 'outlived')!r}).touch()\n"
        "def die(rounds):\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
        "with forked(run, 1) as asked:\n"
        "    asked(0, die)\n"
    )
    assert run_program(program).returncode == -signal.SIGKILL  # and nobody writes to its outputs any more
    assert not (tmp_path / "outlived").exists()


def test_a_folder_is_held_by_the_parent_alone(tmp_path: Path):
    with ExitStack() as stack:
        with held_folder(tmp_path):
            asked = stack.enter_context(forked(lambda task, tell: None, 1))
            asked(0, print)
            with pytest.raises(InputError, match="another run is filling it"), held_folder(tmp_path):
                pass
        with held_folder(tmp_path):  # while the fork lives
            asked(1, print)
