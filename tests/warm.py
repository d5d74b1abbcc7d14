"""Compile each kernel once, on all cores, before the tests race each other to them: ``python tests/warm.py``."""

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial

from filter_cases import equipped, parameters
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.filters.bank.live import LiveFilterBank
from sigmaswarm.filters.live import LiveFilter
from sigmaswarm.filters.run import run_filter
from sigmaswarm.filters.smoothing import smooth

MODELS = ("tilted12", "planar8", "planar5")  # the longest first


def run(model: str) -> None:
    run_filter(equipped(), parameters(model))


def live(model: str, lag: float | None = None) -> None:
    LiveFilter(parameters(model), initial_state(equipped()), nominal_interval=0.01, lag=lag)


def hindsight(model: str) -> None:
    smooth(equipped(), parameters(model))


def many(model: str) -> None:
    LiveFilterBank(parameters(model), initial_state(equipped()), nominal_interval=0.01)


def main() -> None:
    ways: list[Callable[[str], None]] = [live, run, partial(live, lag=1.0), hindsight, many]
    with ProcessPoolExecutor() as pool:
        for done in [pool.submit(way, model) for model in MODELS for way in ways]:
            done.result()


if __name__ == "__main__":
    main()
