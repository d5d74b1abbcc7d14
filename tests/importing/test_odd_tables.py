"""Tables in odd dialects, units, dates and clocks: read right or refused in one line, never read wrong."""

import os
from collections import Counter
from pathlib import Path

import pytest

from importing.odd_tables import make, verdict

TABLES = int(os.environ.get("ODD_TABLES", "6000"))


def tally(seeds: range, folder: Path) -> Counter[str]:
    """How many tables were read right and refused; one that is read wrong fails."""
    count: Counter[str] = Counter()
    for seed in seeds:
        case = make(seed, folder / str(seed))
        said, why = verdict(case)
        assert said != "wrong", f"seed {seed}: {why}\n" + "\n".join(case.said)
        count[said] += 1
    return count


def test_a_sample(tmp_path: Path):
    count = tally(range(10), tmp_path)
    assert count["right"] >= 5, count


@pytest.mark.long
def test_many(tmp_path: Path):
    count = tally(range(30, 30 + TABLES), tmp_path)
    print(count)
    assert count["right"] >= 0.6 * TABLES, count
