"""Filter bank: filters of one tuning with different parameters, whose mixture is the estimate (multiple-model)."""
