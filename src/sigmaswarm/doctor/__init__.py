"""The doctor: find faults of a log before a tuning, and repair some of them.

The doctor compares the motion of the fixes with the IMU. If they disagree, but agree after a column is rotated, scaled
or shifted in time, the doctor reports a finding. Truth is never used.
"""
