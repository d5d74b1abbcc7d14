"""Filter bank (multiple-model estimation): filters with different parameters, whose mixture is the estimate."""
