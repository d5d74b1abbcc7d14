"""Filter bank (multiple-model estimation): the estimate is the mixture of filters with different parameters."""
