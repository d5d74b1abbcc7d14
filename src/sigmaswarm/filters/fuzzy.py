"""Rules of a fuzzy filter for scaling R and Q, and their constants in every form of the filter.

The ratio d of the actual to the theoretical innovation covariance is NIS / 2, on average 1 for a consistent filter. The
rules use two moving averages of d over the fixes: a quick one and, for the trend, a slow one with a time constant that
is `SLOWER` times as long. Both are mapped to (-1, 1), ``ratio = (quick - 1) / (quick + 1)`` and ``trend = (quick -
slow) / (quick + slow)``. Linear edges with tuned widths give "small", "right", "large" and "rises" memberships between
0 and 1:

    ratio is small                       R / g_R    Q / g_Q     the covariance is too large
    ratio is right                       R          Q
    ratio is large, and rises            R g_R      Q           first R grows,
    ratio is large, and does not rise    R g_R      Q g_Q       later also Q

The factors are the mean of the consequents, weighted by the memberships of their rules, which sum to 1: T. Takagi and
M. Sugeno, Fuzzy identification of systems and its applications to modeling and control, IEEE Trans. SMC 15(1), 1985, of
order zero, with the product for "and". The use of the ratio of innovation covariances follows P. J. Escamilla-Ambrosio
and N. Mort, Hybrid Kalman filter-fuzzy logic adaptive multisensor data fusion architectures, CDC 2003, and later
filters. The rules, their edges and the two averages are our own.

The ratio is computed from S before the update. The update uses the new R, and the next predictions use the new Q. With
gains of 1 the filter equals the unscented filter.
"""

LARGEST_RATIO = 10.0
"""Upper limit of the ratio, so that the effect of an outlier is short; for good fixes, one ratio in 20 000 is
larger."""
SLOWER = 4.0
"""Ratio of the time constants of the second average and the first."""
