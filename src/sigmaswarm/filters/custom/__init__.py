"""Models of the user's own: anything with states, a process f and a measurement h, not only cars.

`model` says what a model is and `log` what is filtered; `steps` merges a log's clocks; `run` picks the form of the
filter that can be had: `textbook/` and `compiled/` hold both, beside those for cars.
"""
