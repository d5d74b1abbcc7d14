"""Users' own models: anything with states, a process f and a measurement h, not only cars.

`model` describes a model, `log` a recording and its steps; `checks` tries the model on a log, and `run` chooses the
form of the filter: `textbook/` and `compiled/` have both.
"""
