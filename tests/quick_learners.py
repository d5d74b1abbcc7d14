"""Learners that fit a line through points in less than a second."""

from typing import ClassVar

import numpy as np

from sigmaswarm.learned.fitting import TrainingProblem, new_weights
from sigmaswarm.learned.noise_gru import FEATURES
from sigmaswarm.learned.outage_lstm import new_network


def square(weights, batch):
    return ((batch[0] @ weights["w"] - batch[1]) ** 2).mean()


class Quick:
    epochs = patience = 6
    batch = 4
    start: ClassVar = {"units": 3, "window": 4.0, "learning_rate": 0.1}
    box: ClassVar = {"units": (2, 3), "window": (1, 3), "learning_rate": (-4, -2)}

    def __init__(self, drives, validation, parameters, seed):
        self.seen = [drive.name for drive in (*drives, *validation)]
        self.seed = seed

    def training_problem(self, settings, seed):
        x = np.random.default_rng(seed).normal(size=(30, 3))
        examples = x[:20], x[:20] @ [1.0, -2.0, 0.5]
        return TrainingProblem(square, {"w": np.zeros(3)}, examples, examples)


class QuickOutages(Quick):
    """An outage learner with random forecasts."""

    def finish(self, settings, weights):
        rng, units = np.random.default_rng(self.seed), int(settings["units"])
        moved = rng.normal([9.0, 0.0], [3.0, 0.3], (20, 2))
        seen = rng.normal(size=(20, 40, 4))
        made = new_network(rng, ("ax", "gz"), settings["window"], units, seen, moved)
        more = {"axes": ["ax", "gz"], "inflation": 1.0, "unsure": 10.0}
        return {**made.weights, "w": weights["w"]}, more


class QuickNoises(Quick):
    """A noise learner with random factors."""

    def finish(self, settings, weights):
        rng = np.random.default_rng(self.seed)
        made = new_weights(rng, 3, FEATURES, 3, 2)
        made["head"] = rng.normal(size=(3, 2))
        return {**made, "w": weights["w"]}, {}
