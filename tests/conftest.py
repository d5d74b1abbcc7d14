"""Settings of all tests."""

import gc
import os
import signal
import sys
from collections.abc import Generator, Iterator
from functools import lru_cache
from pathlib import Path

# Before NumPy and Polars are imported: as many processes as cores run the tests, so more threads only cost time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("POLARS_MAX_THREADS", "1")

import pytest
from hypothesis import HealthCheck, settings

# Under `nohup` SIGINT is ignored, by all child processes too: tests of interrupts need Python's handler.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# No file of a test must survive a power failure; to wait for the disk would take 4% of the time.
os.fsync = lambda fd: None

# A busy machine is no failure, and the same commit gets the same verdict; ``HYPOTHESIS_PROFILE=long``, as in
# `make test-long`, and ``search`` look farther.
patient = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("sigmaswarm", patient, derandomize=True, max_examples=12)
settings.register_profile("long", patient, derandomize=True, max_examples=200)
settings.register_profile("search", patient, max_examples=1000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "sigmaswarm"))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """One more than the processors, since tests wait for other processes; xdist counts only physical cores."""
    return (os.cpu_count() or 1) + 1


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(file_path: Path) -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
    """Leave the docstrings of tests alone: the plugin for Markdown would import each file a second time for them."""
    found = yield
    return [file for file in found if type(file).__name__ != "MarkdownDocstringCodeModule"]


LONG_PAGES = (
    *("docs/models.md", "docs/objectives.md", "docs/reference/doctor.md", "docs/reference/evaluation.md"),
    *("docs/reference/drives.md", "docs/reference/experiments.md", "docs/reference/own_models.md"),
)
"""Pages whose examples take seconds. Tests call the same functions, and README.md tunes and evaluates."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave some pages to `make test-long`, before pytest selects by marker; begin with the workbench.

    Its tests take up to half a minute: at the end, one process would wait for another.
    """
    items.sort(key=lambda item: not item.nodeid.startswith("tests/workbench"))
    for item in items:
        if item.nodeid.startswith(LONG_PAGES):
            item.add_marker(pytest.mark.long)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, None, None]:
    """Simulate drives of a minute, not of three, for the example of README.md, which tunes and evaluates."""
    if not item.nodeid.startswith("README.md"):
        return (yield)
    import sigmaswarm

    simulate = sigmaswarm.simulate
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            sigmaswarm, "simulate", lambda *given, **more: simulate(*given, **more | {"duration": 60})
        )
        return (yield)


def pytest_collection_finish() -> None:
    """Simulate and diagnose the same drive once, and keep the collected tests out of garbage collections.

    Garbage collections would take 6% of the processor's time. Tests of the simulation itself use `simulated_anew`.
    """
    if scenarios := sys.modules.get("sigmaswarm.simulation.scenarios"):
        scenarios._drive = lru_cache(64)(scenarios._drive)
    if doctor := sys.modules.get("sigmaswarm.doctor.diagnose"):
        doctor.CACHE_SIZE = 1000
    gc.collect()
    gc.freeze()


@pytest.fixture
def unpainted() -> Iterator[None]:
    """Pictures are not drawn, which takes half a second each: where a test is about something else."""
    from support import no_pictures

    with no_pictures():
        yield


@pytest.fixture(scope="module")
def undiagnosed() -> Iterator[None]:
    """Tunings look for no faults that the objective does not show, which takes 70% of a small one."""
    from sigmaswarm.tuning.tune import tune_problem

    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(tune_problem.__kwdefaults__, "diagnose", False)
        yield


@pytest.fixture(scope="module")
def quick_study() -> Iterator[None]:
    """Studies end sooner: they time one live filter instead of four, and draw fewer resamples."""
    from sigmaswarm.experiments import statistics
    from sigmaswarm.experiments.study import timings

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(timings, "LIVE_FILTERS", {"UKF": timings.LIVE_FILTERS["UKF"]})
        patch.setattr(statistics, "RESAMPLES", 200)
        yield


@pytest.fixture
def simulated_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each call of `simulate` computes its drive."""
    from sigmaswarm.simulation import scenarios

    monkeypatch.setattr(scenarios, "_drive", scenarios._drive.__wrapped__)


@pytest.fixture
def unoptimized(monkeypatch: pytest.MonkeyPatch) -> None:
    """Build C for `check_export` without optimization, which takes a third of the time."""
    from sigmaswarm.exports import check

    monkeypatch.setattr(check, "OPTIMIZE", "-O0")


@pytest.fixture(scope="session")
def browser() -> Iterator[object]:
    """One for a process: Playwright can't be started twice in a thread."""
    from browsing import open_browser

    with open_browser() as opened:
        yield opened
