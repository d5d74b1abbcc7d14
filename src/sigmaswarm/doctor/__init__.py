"""The doctor finds faults of a log before tuning, and repairs some of them.

The doctor compares the motion of the fixes with the IMU. A finding is a disagreement that disappears when a column is
rotated, scaled or shifted in time. The doctor never uses truth.
"""
