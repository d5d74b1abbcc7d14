"""Fitting weights by gradients: Adam with early stopping, the same bits each time, and resumable after each epoch.

The only file beside the losses that uses JAX: the extra ``learned``.
"""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.errors import InputError
from sigmaswarm.tuning.store import load_checkpoint, save_checkpoint

Loss = Callable[[Any, tuple[Any, ...]], Any]
"""Of weights and of a batch: its mean loss."""
BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-8
"""Of Adam: D. Kingma and J. Ba, ICLR 2015."""
DECAY = 1e-4
"""What weights lose a step, times the learning rate: I. Loshchilov and F. Hutter, ICLR 2019."""
LARGEST_GRADIENT = 1.0
"""Longer ones are shortened: R. Pascanu, T. Mikolov and Y. Bengio, ICML 2013."""


@dataclass(frozen=True, eq=False)
class Fit:
    """What a training found.

    Attributes
    ----------
    weights : dict of str to ndarray
        Of the epoch that was best on the examples held back.
    losses : ndarray, shape (epochs + 1, 2)
        Mean loss on the training examples, and on those held back, before the first epoch and after each.
    """

    weights: dict[str, Array]
    losses: Array

    @property
    def best(self) -> float:
        """The least loss on the examples held back."""
        return float(np.min(self.losses[:, 1]))


def exact() -> AbstractContextManager[Any]:
    """JAX with double precision, for the block only.

    Raises
    ------
    InputError
        Where JAX is not installed.
    """
    try:
        import jax
    except ImportError:
        raise InputError("learning needs JAX; install it with pip install 'sigmaswarm[learned]'") from None
    return jax.enable_x64(True)


def fit(
    loss: Loss,
    weights: Mapping[str, Array],
    examples: tuple[Array, ...],
    held_back: tuple[Array, ...],
    *,
    learning_rate: float,
    epochs: int,
    batch: int,
    patience: int,
    seed: int,
    checkpoint: Path | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> Fit:
    """Find the weights with the least loss on examples held back, by Adam on the others.

    Parameters
    ----------
    loss : callable
    weights : mapping
        To begin with.
    examples, held_back : tuple of ndarray
        Each of shape (number of examples, ...).
    learning_rate : float
    epochs, batch, patience : int
        At most so many passes over the examples, so many examples a step, and so many passes without anything better.
    seed : int
        Shuffles the examples: the same seed gives the same bits on the same machine.
    checkpoint : Path, optional
        Where the state after each epoch is kept until the training ends, and found after a kill.
    progress : callable, optional
        Told of every epoch and of the least loss so far.
    """
    with exact():
        import jax

        state = _State.start(weights, float(jax.jit(loss)(dict(weights), held_back)))
        saved = load_checkpoint(checkpoint) if checkpoint else None
        if saved is not None:
            state = _State.restored(saved[0])
        size = min(batch, len(examples[0]))
        run = jax.jit(partial(_epoch, loss, learning_rate))
        test = jax.jit(loss)
        while state.epoch < epochs and state.epoch - int(np.argmin(state.losses[:, 1])) < patience:
            order = np.random.default_rng([seed, state.epoch]).permutation(len(examples[0]))
            order = order[: len(order) // size * size].reshape(-1, size)
            moving, mean = run(
                (state.weights, state.first, state.second, state.steps), tuple(e[order] for e in examples)
            )
            told = float(mean), float(test(moving[0], held_back))
            weights, first, second, steps = jax.tree.map(np.asarray, moving)
            state = state.after(weights, first, second, steps, told)
            if checkpoint:
                save_checkpoint(checkpoint, state.arrays(), {})
            if progress:
                progress(state.epoch, float(np.nanmin(state.losses[:, 1])))
    return Fit(state.best, state.losses)


def _epoch(loss: Loss, learning_rate: float, state: Any, batches: Any) -> Any:
    """One pass over the batches, (steps, batch, ...) each; the state after it, and the mean loss."""
    import jax
    import jax.numpy as jnp

    def step(state: Any, batch: Any) -> Any:
        weights, first, second, k = state
        value, gradient = jax.value_and_grad(loss)(weights, batch)
        length = jnp.sqrt(sum(jnp.sum(g**2) for g in gradient.values()))
        sound = jnp.isfinite(length)
        shrink = jnp.where(sound, jnp.minimum(1.0, LARGEST_GRADIENT / (length + 1e-30)), 0.0)
        gradient = {name: jnp.where(sound, g * shrink, 0.0) for name, g in gradient.items()}
        k = k + 1.0
        first = {n: BETA1 * first[n] + (1 - BETA1) * g for n, g in gradient.items()}
        second = {n: BETA2 * second[n] + (1 - BETA2) * g**2 for n, g in gradient.items()}
        weights = {
            n: w
            - learning_rate
            * (first[n] / (1 - BETA1**k) / (jnp.sqrt(second[n] / (1 - BETA2**k)) + EPSILON) + DECAY * w)
            for n, w in weights.items()
        }
        return (weights, first, second, k), value

    state, losses = jax.lax.scan(step, state, batches)
    return state, jnp.mean(losses)


@dataclass(frozen=True, eq=False)
class _State:
    """All that a training goes on from."""

    weights: dict[str, Any]
    first: dict[str, Any]
    second: dict[str, Any]
    steps: Any
    best: dict[str, Any]
    losses: Array

    @classmethod
    def start(cls, weights: Mapping[str, Array], loss: float) -> "_State":
        own = {name: np.asarray(w, np.float64) for name, w in weights.items()}
        zero = {name: np.zeros_like(w) for name, w in own.items()}
        return cls(own, zero, zero, np.float64(0.0), own, np.array([[np.nan, loss]]))

    @property
    def epoch(self) -> int:
        return len(self.losses) - 1

    def after(self, weights: Any, first: Any, second: Any, steps: Any, told: tuple[float, float]) -> "_State":
        train, test = (value if np.isfinite(value) else np.inf for value in told)
        better = test < np.min(self.losses[:, 1])
        losses = np.vstack([self.losses, [train, test]])
        return _State(weights, first, second, steps, weights if better else self.best, losses)

    def arrays(self) -> dict[str, Any]:
        parts = {"weights": self.weights, "first": self.first, "second": self.second, "best": self.best}
        named = {f"{part}/{name}": array for part, of in parts.items() for name, array in of.items()}
        return {**named, "steps": self.steps, "losses": self.losses}

    @classmethod
    def restored(cls, arrays: dict[str, Any]) -> "_State":
        def part(name: str) -> dict[str, Any]:
            return {key.split("/")[1]: array for key, array in arrays.items() if key.startswith(f"{name}/")}

        return cls(
            part("weights"), part("first"), part("second"), arrays["steps"], part("best"), arrays["losses"]
        )
