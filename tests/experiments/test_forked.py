"""A grid in forks: the same as in threads, whoever fails or is killed."""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from multiprocessing.connection import Connection
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


def test_whoever_takes_a_killed_process_is_told_of_it():
    def run(task: int, tell: Tell) -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    with forked(run, 1) as asked:
        for task in range(3):
            with pytest.raises(SigmaswarmError, match="was killed"):
                asked(task, print)


@pytest.mark.parametrize("kind", [ConnectionResetError, EOFError])
def test_an_error_of_who_is_told_is_no_killed_process(kind: type[Exception]):
    def lose(rounds: int) -> None:
        raise kind("of the progress bar")

    with forked(lambda task, tell: tell(1), 1) as asked, pytest.raises(kind, match="of the progress bar"):
        asked(0, lose)


class Half:
    """Is pickled, but not unpickled."""

    def __reduce__(self) -> tuple[type, tuple[str]]:
        return int, ("no number",)


class HalfError(Exception):
    """Likewise, whatever else in this process has taught pickle of errors."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.half = Half()


def test_an_error_that_can_t_travel_is_told_of():
    class LocalError(Exception):
        pass

    def stumble(task: int, tell: Tell) -> int:
        if task == 0:
            raise LocalError("here")
        if task == 1:
            raise HalfError("a hole in the road")
        return task

    with forked(stumble, 1) as asked:
        for task, message in enumerate(["LocalError: here", "HalfError: a hole in the road"]):
            with pytest.raises(RuntimeError) as stumbled:
                asked(task, print)
            assert str(stumbled.value) == message
            assert "in stumble" in stumbled.value.__notes__[0]
        assert asked(2, print) == 2


def test_a_result_that_can_t_travel_is_told_of():
    def run(task: int, tell: Tell) -> object:
        return Half() if task else threading.Lock()

    with forked(run, 1) as asked:
        with pytest.raises(TypeError, match="cannot pickle"):
            asked(0, print)
        with pytest.raises(ValueError, match="no number"):
            asked(1, print)


def test_a_line_is_closed_once_where_two_hang_up(monkeypatch: pytest.MonkeyPatch):
    close = Connection._close  # pyright: ignore
    leaving = threading.Event()

    def close_slowly(line: Connection) -> None:
        lines.append(line)
        leaving.set()
        if line is lines[0]:
            time.sleep(0.2)  # for the other to come
        close(line)

    def run(task: int, tell: Tell) -> int:
        tell(os.getpid())
        return os.getpid()

    def stumble(process: int) -> None:
        raise InputError("told enough")

    lines: list[Connection] = []
    processes: list[int] = []
    with ThreadPoolExecutor(1) as pool:
        listeners: list[Future[int]] = []
        with pytest.raises(KeyboardInterrupt), forked(run, 2) as asked:
            processes.extend((asked(0, print), asked(1, print)))
            monkeypatch.setattr(Connection, "_close", close_slowly)
            listeners.append(pool.submit(asked, 2, stumble))
            assert leaving.wait(10.0)
            raise KeyboardInterrupt
        with pytest.raises(InputError, match="told enough"):
            listeners[0].result()
    assert len(set(processes)) == 2
    for process in processes:
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)


def test_one_that_can_t_be_ended_keeps_no_other(monkeypatch: pytest.MonkeyPatch):
    kill = os.kill
    spared: list[int] = []
    processes: set[int] = set()

    def run(task: int, tell: Tell) -> int:
        return os.getpid()

    def spare_one(process: int, number: int) -> None:
        if not spared:
            spared.append(process)
            raise PermissionError("not this one")
        kill(process, number)

    with pytest.raises(PermissionError), forked(run, 2) as asked:
        processes.update((asked(0, print), asked(1, print)))
        monkeypatch.setattr(os, "kill", spare_one)
    (other,) = processes - {*spared}
    with pytest.raises(ProcessLookupError):
        kill(other, 0)
    os.waitpid(spared[0], 0)  # it has seen that nobody is left to ask


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
