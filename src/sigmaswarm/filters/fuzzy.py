"""A handful of rules by which a fuzzy filter scales R and Q, and what they share in every form of it.

The ratio d of the actual to the theoretical innovation covariance is NIS / 2, in the mean 1 for a filter that knows its
errors. It is averaged from fix to fix, quickly and, for its trend, `SLOWER` times as slowly; both averages are brought
to (-1, 1), ``ratio = (quick - 1) / (quick + 1)`` and ``trend = (quick - slow) / (quick + slow)``. Of what is small,
right or large, and rises or does not, a straight edge of a tuned width makes a truth between 0 and 1:

    ratio is small                       R / g_R    Q / g_Q     the filter is too careful
    ratio is right                       R          Q
    ratio is large, and rises            R g_R      Q           at first the fixes are doubted,
    ratio is large, and does not rise    R g_R      Q g_Q       and when it lasts the motion, too

The factors are the consequents' mean, weighed by their rules' truths, which sum to 1: T. Takagi and M. Sugeno, Fuzzy
identification of systems and its applications to modeling and control, IEEE Trans. SMC 15(1), 1985, of order zero, with
the product for "and". That the ratio of innovation covariances is what such rules should look at is the principle of P.
J. Escamilla-Ambrosio and N. Mort, Hybrid Kalman filter-fuzzy logic adaptive multisensor data fusion architectures, CDC
2003, and of the filters after it; the rules, their edges and the two averages are ours.

A fix is judged by the S that the filter had before it; it is absorbed with the R, and what follows is predicted with
the Q, that the rules then give. With gains of 1 it is the unscented filter.
"""

LARGEST_RATIO = 10.0
"""A fix counts as no more, or one far off would be remembered for long; of sound fixes, one in 20 000 is larger."""
SLOWER = 4.0
"""How many times as slowly the second average follows."""
