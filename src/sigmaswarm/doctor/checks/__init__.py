"""The checks: functions ``check_...`` that yield findings from the evidence."""
