"""Models of the user's own: anything with states, a process f and a measurement h, not only cars.

`model` says what a model is and `log` what is filtered; `steps` merges a log's clocks; `textbook` runs the filters of
`reference/`, `kernel` the same compiled; `run` picks the one that can be had.
"""
