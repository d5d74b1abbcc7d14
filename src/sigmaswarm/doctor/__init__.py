"""The doctor: finds the faults of a log before a tuning, and repairs some of them.

The doctor compares the motion of the fixes with the IMU. If fixes and IMU disagree, but agree after a column is
rotated, scaled or shifted in time, this is a finding. Truth is never used.
"""
