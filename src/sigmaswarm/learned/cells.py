"""Cells of recurrent networks; ``xp`` is NumPy to run a network, or jax.numpy to train it."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array

Weights = Mapping[str, Any]  # arrays of NumPy or of JAX


def _sigmoid(xp: Any, x: Any) -> Any:
    return 0.5 + 0.5 * xp.tanh(0.5 * x)


def lstm(xp: Any, weights: Weights, state: tuple[Any, Any], x: Any) -> tuple[Any, Any]:
    """Run a step of a long short-term memory for the input x (..., features); return h and c, each (..., hidden units).

    Sources: S. Hochreiter and J. Schmidhuber, Neural Computation 9(8), 1997; F. Gers, J. Schmidhuber and F. Cummins,
    Neural Computation 12(10), 2000.
    """
    h, c = state
    gates = x @ weights["input"] + h @ weights["hidden"] + weights["bias"]
    i, f, g, o = xp.split(gates, 4, axis=-1)
    c = _sigmoid(xp, f) * c + _sigmoid(xp, i) * xp.tanh(g)
    return _sigmoid(xp, o) * xp.tanh(c), c


def gru(xp: Any, weights: Weights, h: Any, x: Any) -> Any:
    """Run a step of a gated recurrent unit (K. Cho et al., EMNLP 2014); return h (..., hidden units)."""
    from_x = x @ weights["input"] + weights["bias"]
    from_h = h @ weights["hidden"]
    xr, xz, xn = xp.split(from_x, 3, axis=-1)
    hr, hz, hn = xp.split(from_h, 3, axis=-1)
    r, z = _sigmoid(xp, xr + hr), _sigmoid(xp, xz + hz)
    return (1.0 - z) * xp.tanh(xn + r * hn) + z * h


def head(weights: Weights, h: Any) -> Any:
    """Return the outputs (..., outputs) for a hidden state (..., hidden units)."""
    return h @ weights["head"] + weights["head_bias"]


def new_weights(
    rng: np.random.Generator, gates: int, features: int, units: int, outputs: int
) -> dict[str, Array]:
    """Draw initial weights; those of the output layer are zero, so that the outputs of a new network are 0.

    Source: X. Glorot and Y. Bengio, AISTATS 2010. The forget gate of an LSTM is open at first (R. Jozefowicz, W.
    Zaremba and I. Sutskever, ICML 2015).
    """

    def uniform(rows: int, columns: int) -> Array:
        most = np.sqrt(6.0 / (rows + columns // gates))
        return rng.uniform(-most, most, (rows, columns))

    bias = np.zeros(gates * units)
    if gates == 4:
        bias[units : 2 * units] = 1.0
    return {
        "input": uniform(features, gates * units),
        "hidden": uniform(units, gates * units),
        "bias": bias,
        "head": np.zeros((units, outputs)),
        "head_bias": np.zeros(outputs),
    }


def n_weights(weights: Weights) -> int:
    return sum(int(np.size(array)) for array in weights.values())
