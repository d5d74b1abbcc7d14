"""Confidence in a finding, a number from 0 to 1."""

import math

MOST = 0.999
"""Nothing is certain: a log can be strange in ways that no check thinks of."""


def confidence_of(deviations: float) -> float:
    """Of something that stands out by so many standard deviations."""
    return round(min(math.erf(abs(deviations) / math.sqrt(2)), MOST), 3)


def confidence_by_margin(margin: float) -> float:
    """Of a reading that explains the log better, by so much of chi-square."""
    return round(min(1 - math.exp(-max(margin, 0.0) / 2), MOST), 3)
