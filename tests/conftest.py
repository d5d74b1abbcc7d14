"""Settings of all tests."""

import gc
import os
import signal
import sys
from collections.abc import Callable, Generator, Iterator
from functools import lru_cache, partial
from pathlib import Path

# Set before NumPy and Polars are imported: one test process runs per core, so more threads only cost time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("POLARS_MAX_THREADS", "1")

import pytest
from hypothesis import HealthCheck, settings

# Under `nohup`, SIGINT is ignored by this process and its children; tests of interrupts need Python's handler.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Until all tests are collected, most objects are kept; see `pytest_collection_finish`.
gc.disable()

# Files of tests need not survive a power failure; waiting for the disk would take 4% of the time.
os.fsync = lambda fd: None

# No deadline, since a machine may be busy. Examples are the same in each run, so a commit always gets the same
# result. `make test-long` sets HYPOTHESIS_PROFILE=long (more examples); ``search`` draws new examples each time.
patient = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("sigmaswarm", patient, derandomize=True, max_examples=12)
settings.register_profile("long", patient, derandomize=True, max_examples=200)
settings.register_profile("search", patient, max_examples=1000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "sigmaswarm"))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Return the number of processors + 1, since tests wait for other processes; xdist counts only physical cores."""
    return (os.cpu_count() or 1) + 1


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(file_path: Path) -> Generator[None, list[pytest.Collector], list[pytest.Collector]]:
    """Do not collect docstrings of tests: the plugin for Markdown would import each test file a second time."""
    found = yield
    return [file for file in found if type(file).__name__ != "MarkdownDocstringCodeModule"]


LONG_PAGES = (
    *("docs/models.md", "docs/objectives.md", "docs/reference/doctor.md", "docs/reference/evaluation.md"),
    *("docs/reference/drives.md", "docs/reference/experiments.md", "docs/reference/own_models.md"),
)
"""Pages with examples that take seconds. Tests call the same functions; README.md tunes and evaluates."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark slow pages as long, before pytest selects tests by marker; run the tests of the workbench first.

    A test of the workbench takes up to 30 s: at the end of the run, the other processes would wait for it.
    """
    items.sort(key=lambda item: not item.nodeid.startswith("tests/workbench"))
    for item in items:
        if item.nodeid.startswith(LONG_PAGES):
            item.add_marker(pytest.mark.long)
        # Hooks for single tests are not called for files outside of this folder.
        if item.nodeid.startswith("README.md"):
            item.runtest = partial(with_short_drives, item.runtest)


def with_short_drives(test: Callable[[], None]) -> None:
    """Simulate drives of 60 s instead of 180 s for the example of README.md, which tunes and evaluates."""
    import sigmaswarm

    simulate = sigmaswarm.simulate
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            sigmaswarm, "simulate", lambda *given, **more: simulate(*given, **more | {"duration": 60})
        )
        test()


def pytest_collection_finish() -> None:
    """Cache simulated drives and diagnoses, and exclude the collected tests from garbage collection.

    Garbage collections would take 6% of the processor time. Tests of the simulation use `simulated_anew`.
    """
    if scenarios := sys.modules.get("sigmaswarm.simulation.scenarios"):
        scenarios._drive = lru_cache(64)(scenarios._drive)
    if doctor := sys.modules.get("sigmaswarm.doctor.diagnose"):
        doctor.CACHE_SIZE = 1000
    gc.collect()
    gc.freeze()
    gc.enable()


@pytest.fixture
def unpainted() -> Iterator[None]:
    """Replace pictures by empty ones in tests of other things; drawing takes 0.5 s per picture."""
    from support import no_pictures

    with no_pictures():
        yield


@pytest.fixture(scope="module")
def undiagnosed() -> Iterator[None]:
    """Skip the search for faults that the objective does not show; it takes 70% of the time of a small tuning."""
    from sigmaswarm.tuning.tune import tune_problem

    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(tune_problem.__kwdefaults__, "diagnose", False)
        yield


@pytest.fixture(scope="module")
def quick_study() -> Iterator[None]:
    """Shorten studies: time one live filter instead of four, and draw fewer resamples."""
    from sigmaswarm.experiments import statistics
    from sigmaswarm.experiments.study import timings

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(timings, "LIVE_FILTERS", {"UKF": timings.LIVE_FILTERS["UKF"]})
        patch.setattr(statistics, "RESAMPLES", 200)
        yield


@pytest.fixture
def simulated_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """Disable the cache of simulated drives."""
    from sigmaswarm.simulation import scenarios

    monkeypatch.setattr(scenarios, "_drive", scenarios._drive.__wrapped__)


@pytest.fixture
def unoptimized(monkeypatch: pytest.MonkeyPatch) -> None:
    """Build C for `check_export` without optimization, which takes a third of the time."""
    from sigmaswarm.exports import check

    monkeypatch.setattr(check, "OPTIMIZE", "-O0")


@pytest.fixture(scope="session")
def browser() -> Iterator[object]:
    """Yield one browser per process: Playwright can't be started twice in a thread."""
    from browsing import open_browser

    with open_browser() as opened:
        yield opened
