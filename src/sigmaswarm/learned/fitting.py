"""Cells of recurrent networks, and the fit of their weights by AdamW with early stopping.

Fits are reproducible, and a stopped fit resumes after its last epoch. They need JAX and Optax, the extra ``learned``.
"""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import lru_cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.errors import InputError, not_installed
from sigmaswarm.tuning.store import load_checkpoint, save_checkpoint

Weights = Mapping[str, Any]  # arrays of NumPy or of JAX


def _sigmoid(xp: Any, x: Any) -> Any:
    return 0.5 + 0.5 * xp.tanh(0.5 * x)


def lstm(xp: Any, weights: Weights, state: tuple[Any, Any], x: Any) -> tuple[Any, Any]:
    """Run a step of a long short-term memory for the input x (..., features). Return h and c, each (..., hidden units).

    Sources: S. Hochreiter and J. Schmidhuber, Neural Computation 9(8), 1997; F. Gers, J. Schmidhuber and F. Cummins,
    Neural Computation 12(10), 2000.
    """
    h, c = state
    gates = x @ weights["input"] + h @ weights["hidden"] + weights["bias"]
    i, f, g, o = xp.split(gates, 4, axis=-1)
    c = _sigmoid(xp, f) * c + _sigmoid(xp, i) * xp.tanh(g)
    return _sigmoid(xp, o) * xp.tanh(c), c


def gru(xp: Any, weights: Weights, h: Any, x: Any) -> Any:
    """Run a step of a gated recurrent unit (K. Cho et al., EMNLP 2014). Return h (..., hidden units)."""
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
    """Draw initial weights. Those of the output layer are zero, so that the outputs of a new network are 0.

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


Loss = Callable[[Any, tuple[Any, ...]], Any]  # loss for weights and a batch
Settings = Mapping[str, float]  # number of hidden units, window or segment (s), and learning rate
WEIGHT_DECAY = 1e-4  # per step, relative to the learning rate: I. Loshchilov and F. Hutter, ICLR 2019
MAX_GRADIENT_NORM = 1.0
"""Largest norm of a gradient. A larger gradient is scaled down (R. Pascanu, T. Mikolov and Y. Bengio, ICML 2013)."""
# Fraction of a drive, at its end, that is validation data if there are no validation drives
VALIDATION_SHARE = 0.25


@dataclass(frozen=True, eq=False)
class Examples:
    """Arrays of shape (number of examples, ...), and a mask of the validation examples."""

    arrays: tuple[Array, ...]
    held_back: NDArray[np.bool_]

    def part(self, *, held_back: bool) -> tuple[Array, ...]:
        return tuple(array[self.held_back == held_back] for array in self.arrays)


@dataclass(frozen=True, eq=False)
class TrainingProblem:
    """Loss, initial weights and examples of a training run. ``fixed`` contains weights that are not trained."""

    loss: Loss
    weights: Mapping[str, Array]
    examples: tuple[Array, ...]
    held_back: tuple[Array, ...]
    fixed: Mapping[str, Array] = field(default_factory=dict[str, Array])


@dataclass(frozen=True)
class Schedule:
    """Options of a training run.

    ``batch`` is the number of examples per step. ``patience`` is the number of epochs without a lower validation loss
    after which the training stops.
    """

    learning_rate: float
    epochs: int
    batch: int
    patience: int
    seed: int


@dataclass(frozen=True, eq=False)
class TrainingResult:
    """Weights after the best epoch, and losses.

    ``losses``, shape (epochs + 1, 2), contains the mean over the training examples during each epoch (NaN in the first
    row), and the mean over the validation examples before the first epoch and after each epoch.
    """

    weights: dict[str, Array]
    losses: Array

    @property
    def best(self) -> float:
        return float(np.min(self.losses[:, 1]))


def double_precision() -> AbstractContextManager[Any]:
    """Enable double precision of JAX in a ``with`` block. Raises `InputError` if JAX or Optax is not installed."""
    try:
        import jax

        import_module("optax")
    except ImportError:
        raise not_installed("learning", "JAX or Optax", "'sigmaswarm[learned]'") from None
    return jax.enable_x64(True)


def fit(
    problem: TrainingProblem,
    schedule: Schedule,
    *,
    checkpoint: Path | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> TrainingResult:
    """Minimize the loss by AdamW. Return the weights with the lowest loss on the validation examples.

    A stopped training run continues from the file ``checkpoint``. After each epoch, ``progress`` is called with the
    number of finished epochs and the lowest validation loss so far.
    """
    with double_precision():
        import jax

        optimizer, test, run = _compiled(problem.loss, schedule.learning_rate)
        weights: dict[str, Any] = {name: np.asarray(w, np.float64) for name, w in problem.weights.items()}
        before = [[np.nan, float(test(weights, problem.held_back))]]
        state = _State(weights, optimizer.init(weights), weights, np.array(before))
        saved = load_checkpoint(checkpoint) if checkpoint else None
        if saved:
            try:
                state = state.restored(saved[0])
            except (LookupError, ValueError):
                raise InputError(
                    f"{checkpoint}: does not belong to this training run; delete it to start the training again"
                ) from None
        count = len(problem.examples[0])
        size = min(schedule.batch, count)
        while (epoch := len(state.losses) - 1) < schedule.epochs:
            if epoch - int(np.argmin(state.losses[:, 1])) >= schedule.patience:
                break
            order = np.random.default_rng([schedule.seed, epoch]).permutation(count)
            order = order[: count // size * size].reshape(-1, size)
            batches = tuple(e[order] for e in problem.examples)
            weights, moments, mean = run(state.weights, state.moments, batches)
            losses = float(mean), float(test(weights, problem.held_back))
            weights, moments = jax.tree.map(np.asarray, (weights, moments))
            state = state.after(weights, moments, losses)
            if checkpoint:
                save_checkpoint(checkpoint, state.arrays(), {})
            if progress:
                progress(epoch + 1, float(np.nanmin(state.losses[:, 1])))
    return TrainingResult(state.best, state.losses)


@lru_cache(maxsize=4)
def _compiled(loss: Loss, learning_rate: float) -> tuple[Any, Any, Any]:
    """Return the optimizer, the compiled loss and the compiled epoch. They are cached by loss and learning rate."""
    import jax
    import optax

    adamw = optax.adamw(learning_rate, weight_decay=WEIGHT_DECAY)
    steps = optax.chain(optax.clip_by_global_norm(MAX_GRADIENT_NORM), adamw)
    # Skip updates that are not finite.
    optimizer = optax.apply_if_finite(steps, max_consecutive_errors=np.iinfo(np.int32).max)
    return optimizer, jax.jit(loss), jax.jit(partial(_epoch, loss, optimizer))


def _epoch(loss: Loss, optimizer: Any, weights: Any, moments: Any, batches: Any) -> Any:
    """Run one epoch over the batches, (steps, batch, ...) each."""
    import jax
    import optax

    def step(state: Any, batch: Any) -> Any:
        weights, moments = state
        value, gradient = jax.value_and_grad(loss)(weights, batch)
        change, moments = optimizer.update(gradient, moments, weights)
        return (optax.apply_updates(weights, change), moments), value

    (weights, moments), losses = jax.lax.scan(step, (weights, moments), batches)
    return weights, moments, losses.mean()


@dataclass(frozen=True, eq=False)
class _State:
    weights: dict[str, Any]
    moments: Any
    best: dict[str, Any]
    losses: Array

    def after(self, weights: Any, moments: Any, losses: tuple[float, float]) -> "_State":
        train, test = (value if np.isfinite(value) else np.inf for value in losses)
        best = weights if test < np.min(self.losses[:, 1]) else self.best
        return _State(weights, moments, best, np.vstack([self.losses, [train, test]]))

    def arrays(self) -> dict[str, Any]:
        import jax

        moments = {str(k): np.asarray(leaf) for k, leaf in enumerate(jax.tree.leaves(self.moments))}
        arrays: dict[str, Any] = {}
        for part, content in (("weights", self.weights), ("best", self.best), ("moments", moments)):
            arrays |= {f"{part}/{name}": array for name, array in content.items()}
        return arrays | {"losses": self.losses}

    def restored(self, arrays: dict[str, Any]) -> "_State":
        """Return a saved state. Raises `LookupError` or `ValueError` for the state of another training run."""
        import jax

        for name, now in self.arrays().items():
            saved = arrays[name]
            losses = name == "losses" and len(saved) > 1
            if saved.dtype != now.dtype or saved.shape[losses:] != now.shape[losses:]:
                raise ValueError(f"{name} has the wrong type or shape")
        leaves, structure = jax.tree.flatten(self.moments)
        moments = structure.unflatten([arrays[f"moments/{k}"] for k in range(len(leaves))])
        return _State(part_of(arrays, "weights"), moments, part_of(arrays, "best"), arrays["losses"])


def part_of(arrays: Mapping[str, Any], part: str) -> dict[str, Any]:
    """Return the arrays named ``part/NAME``, by NAME."""
    return {key.split("/")[1]: array for key, array in arrays.items() if key.startswith(f"{part}/")}
