"""The checks: functions ``check_...`` that return findings from the evidence."""
