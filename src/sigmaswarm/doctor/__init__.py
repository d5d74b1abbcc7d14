"""The doctor: says what is wrong with a log before anybody tunes on it, and mends what can be mended.

The fixes show how the car moved; the IMU says how it felt. Where the two can't be brought together by the log as it
stands, but can with a column turned, scaled or moved in time, that is the finding. Truth is never looked at.
"""
