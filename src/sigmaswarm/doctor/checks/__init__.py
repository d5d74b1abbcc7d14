"""The checks: functions ``check_...`` from the evidence to findings, each with a measure and its thresholds."""
