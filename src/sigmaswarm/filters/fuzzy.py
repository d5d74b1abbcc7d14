"""Rules by which a fuzzy filter scales R and Q, and their constants.

The ratio d of the actual to the theoretical innovation covariance is NIS / 2, on average 1 for a consistent filter. The
rules use two moving averages of d over the fixes, quick and slow; the time constant of the slow average is `SLOWER`
times that of the quick average. The averages give two inputs in (-1, 1), ``ratio = (quick - 1) / (quick + 1)`` and
``trend = (quick - slow) / (quick + slow)``. Piecewise linear functions of ratio and trend, with the widths
``fuzzy_widths``, give the memberships "small", "right", "large" and "rises" between 0 and 1. The rules, with the gains
g_R and g_Q (``fuzzy_gains``), are

    ratio is small                       R / g_R    Q / g_Q     the covariance is too large
    ratio is right                       R          Q
    ratio is large, and rises            R g_R      Q           first R grows,
    ratio is large, and does not rise    R g_R      Q g_Q       later also Q

The factors of R and Q are the means of the consequents, weighted by the memberships of the rules, which sum to 1. This
is the inference of T. Takagi and M. Sugeno (Fuzzy identification of systems and its applications to modeling and
control, IEEE Trans. SMC 15(1), 1985) of order zero, with the product for "and". The ratio follows P. J.
Escamilla-Ambrosio and N. Mort, Hybrid Kalman filter-fuzzy logic adaptive multisensor data fusion architectures, CDC
2003. The rules, the membership functions and the two averages are our own.

The ratio is computed from S before the update. The update uses the new R, and the next predictions use the new Q. With
gains of 1 the filter equals the unscented filter.
"""

LARGEST_RATIO = 10.0  # upper limit of d, against outliers; for good fixes, one d in 20 000 is larger
SLOWER = 4.0  # ratio of the time constants of the two averages
