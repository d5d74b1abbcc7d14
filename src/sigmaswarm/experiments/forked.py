"""The tasks of a grid in processes of their own, forked: as threads they would wait for each other.

A tuning spends a quarter of its time in the interpreter, which one thread has at a time, and where it races it asks for
it thousands of times a second: two threads fill a core and a half, and the system is busy waking them. A fork has all
that its parent has made, drives and time lines too, without copying it, and an interpreter of its own.

Whoever hands out tasks stays a thread of the parent, one a fork, which listens: to how far the task is, and to its end.
"""

import ctypes
import gc
import os
import pickle
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Generator, Hashable, Sequence
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing.connection import Connection, Pipe
from queue import SimpleQueue
from typing import Any, Generic, NoReturn, TypeVar

from sigmaswarm.errors import SigmaswarmError
from sigmaswarm.experiments.grid import Tell

T = TypeVar("T", bound=Hashable)
R = TypeVar("R")


@contextmanager
def forked(run: Callable[[T, Tell], R], size: int) -> Generator[Callable[[T, Tell], R]]:
    """What `run_grid` is to run in place of ``run``: each task in one of ``size`` forks, which end with the block.

    To be called by so many threads at a time. Tasks, results and errors travel pickled; what is not made yet when the
    processes fork, each makes for itself, so compile before. Where no process can be forked it is ``run`` itself: forks
    of macOS can't use its frameworks, Windows has none, and memory may not suffice.
    """
    crew: list[_Fork[T, R]] = []
    with ExitStack() as ends:  # each, whatever becomes of the others
        with suppress(OSError):
            for _ in range(size if sys.platform == "linux" else 0):
                crew.append(_Fork(run, crew))
                ends.callback(crew[-1].end)
        yield _handed_to(crew) if crew else run


def _handed_to(crew: "Sequence[_Fork[T, R]]") -> Callable[[T, Tell], R]:
    idle: SimpleQueue[_Fork[T, R]] = SimpleQueue()
    for fork in crew:
        idle.put(fork)

    def ask(task: T, tell: Tell) -> R:
        fork = idle.get()
        try:
            return fork.ask(task, tell)
        finally:
            idle.put(fork)  # a dead one too: whoever takes it is told so, and nobody waits for ever

    return ask


class _Fork(Generic[T, R]):
    """A process that does one task after the other, and the parent's line to it."""

    def __init__(self, run: Callable[[T, Tell], R], others: "Sequence[_Fork[T, R]]") -> None:
        parent = os.getpid()
        self._line, theirs = Pipe()
        self._hanging_up = threading.Lock()
        # of other threads, which it has not: those here hold nothing that it needs
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self._pid = os.fork()
        if self._pid == 0:
            try:
                for line in (self._line, *(fork._line for fork in others)):
                    line.close()  # else it would never see that the parent has gone
                _serve(run, theirs, parent)
            finally:
                os._exit(1)
        theirs.close()

    def ask(self, task: T, tell: Tell) -> R:
        """Have a task done."""
        word, said = self._answer(task, tell)
        if word == "failed":
            raise said
        return said

    def _answer(self, task: T, tell: Tell) -> tuple[str, Any]:
        try:
            with _telling_of_a_death():
                self._line.send(task)
            while True:
                with _telling_of_a_death():
                    word, said = self._line.recv()
                if word != "told":
                    return word, said
                tell(said)
        except BaseException:
            self._hang_up()  # where it is in the midst of a task, it ends when it tells
            raise

    def end(self) -> None:
        """End it at once: files are written whole or not at all."""
        try:
            with suppress(ProcessLookupError, ChildProcessError):  # somebody else waits for all children, too
                os.kill(self._pid, signal.SIGKILL)
                os.waitpid(self._pid, 0)
        finally:
            self._hang_up()

    def _hang_up(self) -> None:
        # a thread that listens may do so while another ends it: two would close it twice
        with self._hanging_up:
            self._line.close()


@contextmanager
def _telling_of_a_death() -> Generator[None]:
    """Around what is said and heard on a line, nothing else: a caller's own errors may be of the same types."""
    try:
        yield
    # OSError itself: closed after an earlier task, or cut in the midst of a message
    except (EOFError, OSError):
        raise SigmaswarmError(
            "a process of this experiment was killed, perhaps for want of memory; go on with --resume"
        ) from None


def _serve(run: Callable[[T, Tell], Any], line: Connection, parent: int) -> NoReturn:
    """In the fork: do what is asked for, until nobody is left to ask."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's matter
    # PR_SET_PDEATHSIG: nothing is written behind a killed parent's back
    ctypes.CDLL(None).prctl(1, int(signal.SIGKILL))
    if os.getppid() != parent:
        os._exit(1)
    gc.freeze()  # to look at all that was inherited would copy it

    def tell(rounds: int) -> None:
        line.send(("told", rounds))

    while True:
        task = line.recv()
        try:
            answer = _packed("done", run(task, tell))
        except BaseException as error:
            answer = _packed_error(error)
        line.send_bytes(answer)


def _packed(word: str, said: object) -> bytes:
    """As `Connection.recv` takes it; raises here, not in the parent, what it would raise there."""
    packed = pickle.dumps((word, said))
    pickle.loads(packed)
    return packed


def _packed_error(error: BaseException) -> bytes:
    note = f"in a process of this experiment:\n{''.join(traceback.format_exception(error))}"
    if not isinstance(error, SigmaswarmError):
        error.add_note(note)
    try:
        return _packed("failed", error)
    except Exception:  # not all errors can travel: what it says can
        stand_in = RuntimeError(f"{type(error).__name__}: {error}")
        stand_in.add_note(note)
        return _packed("failed", stand_in)
