"""Users' models: any system with states, a process f and a measurement h, not only cars.

`model` describes a model, `log` a recording and its steps. `run` checks the model on a log, and chooses between the
filters of `textbook/` and `compiled/`.
"""
