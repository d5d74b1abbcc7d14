"""The doctor finds faults in a log before tuning, and repairs some of them.

The doctor compares the motion of the fixes with the IMU. Many findings are disagreements that disappear when a column
is rotated, scaled or shifted in time. Other findings are about sampling, noise, and quantities that can't be estimated
from the log. The doctor uses the truth only to check its clock, and the delay and the errors of the fixes.
"""
