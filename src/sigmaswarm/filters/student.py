"""Student's t: constants of filters and objectives that are robust to outliers.

With v degrees of freedom, Student's t is a Gaussian whose covariance is divided by a random weight. The weight has a
gamma distribution with mean 1; for an outlier the weight is small.
"""

ITERATIONS = 3  # number of alternating estimates of the state and the weight of a fix
OUTLYING = 0.25  # a fix with a smaller weight is an outlier
OUTLIERS = 3  # number of consecutive outliers, over at least OUTLIERS_SPAN, that show a wrong filter
OUTLIERS_SPAN = 5.0  # s

# The scale of an objective is c = 2 x, where x e^x E1(x) = v / (v + 2) and E1 is the exponential integral. With this c,
# the mean of ln det S / 2 + (v + 2) / 2 ln(1 + NIS / c) over Gaussian innovations is least where their mean NIS is 2,
# as for the Gaussian likelihood. With c = v (Student's density), it is least at a mean NIS of 2.75 (v = 4) or
# 2.42 (v = 8).
INNOVATION_DOF, INNOVATION_SCALE = 4.0, 2.9069903810286775  # v and c of `innovation-t`
FORECAST_DOF, FORECAST_SCALE = 8.0, 6.609907797270899  # v and c of `forecast-t`
LARGEST_TAIL = 1e38  # upper limit of 1 + NIS / c in `innovation-t`; a product of eight cannot overflow
