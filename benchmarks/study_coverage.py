"""Measure the coverage of a study's intervals by simulation of its design.

`python benchmarks/study_coverage.py` draws studies with known expectations. The score of a drive is the mean of its
condition times three random factors: a skewed factor of the drive, a factor of the trial (variation of the optimizer),
and a factor of both. The intervals should cover the mean score of a new drive of the same conditions in a new trial.
"""

import argparse

import numpy as np

from sigmaswarm.experiments.statistics import Draws
from sigmaswarm.experiments.study.results import summarize

NAMES = ("mean +- 1.96 SD / sqrt(n)", "corrected resampled t", "bootstrap over drives and trials")
DRIVE_SPREAD, BOTH_SPREAD = 0.35, 0.05
"""Standard deviations of the logarithms of the factors."""
DESIGNS = ((25, 20, 20), (10, 3, 5), (2, 4, 5))
"""Numbers of conditions, runs per condition, and trials: the paper's study, the notebook's, and a very small study."""
TRIAL_SPREADS = (0.0, 0.01, 0.03, 0.2)
"""Standard deviations of the logarithm of the trial's factor."""


def simulated_study(
    rng: np.random.Generator, luck: float, conditions: int = 25, runs: int = 20, trials: int = 20
):
    """Return scores (trials, drives), NaN for training drives; conditions of the drives; true mean for a new drive."""
    levels = np.linspace(0.4, 2.0, conditions)
    strata = np.repeat(np.arange(conditions), runs)
    drive = levels[strata] * _factor(rng, DRIVE_SPREAD, len(strata))
    each = _factor(rng, luck, (trials, 1)) * _factor(rng, BOTH_SPREAD, (trials, len(strata)))
    scores = np.full((trials, len(strata)), np.nan)
    for trial in range(trials):
        for stratum in range(conditions):
            own = rng.permutation(np.flatnonzero(strata == stratum))
            test = own[round(0.7 * runs) :]
            scores[trial, test] = (drive * each[trial])[test]
    return scores, [str(s) for s in strata], float(levels.mean())


def _factor(rng: np.random.Generator, spread: float, shape) -> np.ndarray:
    """Draw log-normal factors with mean 1."""
    return np.exp(spread * rng.standard_normal(shape) - spread**2 / 2)


def covered(rng: np.random.Generator, luck: float, **design: int) -> list[bool]:
    """Return, for each interval of a simulated study, True if it covers the true mean."""
    scores, strata, truth = simulated_study(rng, luck, **design)
    ratio = float(np.isfinite(scores[0]).sum() / np.isnan(scores[0]).sum())
    of = dict.fromkeys(("protocol", "method", "measure", "maneuver", "environment"), "")
    found = summarize(scores, strata, ratio, Draws(rng), **of)
    intervals = found.trial_interval, found.corrected_t_interval, found.bootstrap_interval
    return [low <= truth <= high for low, high in intervals]


def coverage(studies: int, luck: float, seed: int = 0, **design: int) -> np.ndarray:
    """Return the fraction of studies in which each interval covers the true mean, (3,)."""
    rng = np.random.default_rng(seed)
    return np.mean([covered(rng, luck, **design) for _ in range(studies)], axis=0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--studies", type=int, default=2000)
    studies = parser.parse_args().studies
    error = 1.96 * np.sqrt(0.95 * 0.05 / studies)
    print(f"{studies} simulated studies of each design; 95% is known to +-{error:.1%}\n")
    print("| conditions x runs, trials | spread of the optimizer | " + " | ".join(NAMES) + " |")
    print("|---|---:|" + "---:|" * len(NAMES))
    for conditions, runs, trials in DESIGNS:
        for luck in TRIAL_SPREADS:
            found = coverage(
                studies, luck, round(1000 * luck), conditions=conditions, runs=runs, trials=trials
            )
            shares = " | ".join(f"{share:.1%}" for share in found)
            print(f"| {conditions} x {runs}, {trials} | {luck:.0%} | {shares} |", flush=True)


if __name__ == "__main__":
    main()
