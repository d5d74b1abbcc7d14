"""Fit weights by gradients: Adam with early stopping, the same bits each time, resumable after each epoch.

It needs JAX and Optax, the extra ``learned``.
"""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from sigmaswarm.drives.drive import Array
from sigmaswarm.errors import InputError
from sigmaswarm.tuning.store import load_checkpoint, save_checkpoint

Loss = Callable[[Any, tuple[Any, ...]], Any]
"""Mean loss of a batch, given weights and batch."""
DECAY = 1e-4
"""Weight decay of a step, times the learning rate: I. Loshchilov and F. Hutter, ICLR 2019."""
LARGEST_GRADIENT = 1.0
"""Longer ones are shortened: R. Pascanu, T. Mikolov and Y. Bengio, ICML 2013."""


@dataclass(frozen=True, eq=False)
class Lesson:
    """A training to be done: loss, initial weights and examples of `fit`, and weights that stay fixed."""

    loss: Loss
    weights: Mapping[str, Array]
    examples: tuple[Array, ...]
    held_back: tuple[Array, ...]
    fixed: Mapping[str, Array] = field(default_factory=dict[str, Array])


@dataclass(frozen=True, eq=False)
class Fit:
    """The result of a training.

    Attributes
    ----------
    weights : dict of str to ndarray
        Of the epoch with the least loss on the held-back examples.
    losses : ndarray, shape (epochs + 1, 2)
        Mean loss on the training and the held-back examples, before the first epoch and after each.
    """

    weights: dict[str, Array]
    losses: Array

    @property
    def best(self) -> float:
        """The least loss on the held-back examples."""
        return float(np.min(self.losses[:, 1]))


def exact() -> AbstractContextManager[Any]:
    """Use JAX with double precision in a block.

    Raises
    ------
    InputError
        If JAX or Optax is not installed.
    """
    try:
        import jax

        import_module("optax")
    except ImportError:
        raise InputError(
            "learning needs JAX and Optax; install them with pip install 'sigmaswarm[learned]'"
        ) from None
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
    """Find the weights with the least loss on held-back examples, by Adam on the others.

    Parameters
    ----------
    loss : callable
    weights : mapping
        Initial ones.
    examples, held_back : tuple of ndarray
        Each of shape (number of examples, ...).
    learning_rate : float
    epochs, batch, patience : int
        Largest number of passes over the examples, examples a step, and largest number of passes without improvement.
    seed : int
        Shuffles the examples: the same seed gives the same bits on the same machine.
    checkpoint : Path, optional
        File of the state after each epoch, from which a killed training continues.
    progress : callable, optional
        Called with every epoch and the least loss so far.
    """
    with exact():
        import jax

        optimizer = _optimizer(learning_rate)
        state = _State.start(weights, optimizer, float(jax.jit(loss)(dict(weights), held_back)))
        saved = load_checkpoint(checkpoint) if checkpoint else None
        if checkpoint and saved:
            try:
                state = state.restored(saved[0])
            except (LookupError, ValueError):
                raise InputError(
                    f"{checkpoint}: not a checkpoint of this training; delete it to redo the training"
                ) from None
        size = min(batch, len(examples[0]))
        run = jax.jit(partial(_epoch, loss, optimizer))
        test = jax.jit(loss)
        while state.epoch < epochs and state.epoch - int(np.argmin(state.losses[:, 1])) < patience:
            order = np.random.default_rng([seed, state.epoch]).permutation(len(examples[0]))
            order = order[: len(order) // size * size].reshape(-1, size)
            moved, moments, mean = run(state.weights, state.moments, tuple(e[order] for e in examples))
            loss_pair = float(mean), float(test(moved, held_back))
            moved, moments = jax.tree.map(np.asarray, (moved, moments))
            state = state.after(moved, moments, loss_pair)
            if checkpoint:
                save_checkpoint(checkpoint, state.arrays(), {})
            if progress:
                progress(state.epoch, float(np.nanmin(state.losses[:, 1])))
    return Fit(state.best, state.losses)


def _optimizer(learning_rate: float) -> Any:
    """Return Adam with weight decay and clipped gradients; steps that are not finite are skipped."""
    import optax

    steps = optax.chain(
        optax.clip_by_global_norm(LARGEST_GRADIENT), optax.adamw(learning_rate, weight_decay=DECAY)
    )
    return optax.apply_if_finite(steps, max_consecutive_errors=np.iinfo(np.int32).max)


def _epoch(loss: Loss, optimizer: Any, weights: Any, moments: Any, batches: Any) -> Any:
    """Run over the batches, (steps, batch, ...) each; return weights, moments and the mean loss."""
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
    """The state of a training; ``moments`` are the optimizer's."""

    weights: dict[str, Any]
    moments: Any
    best: dict[str, Any]
    losses: Array

    @classmethod
    def start(cls, weights: Mapping[str, Array], optimizer: Any, loss: float) -> "_State":
        own = {name: np.asarray(w, np.float64) for name, w in weights.items()}
        return cls(own, optimizer.init(own), own, np.array([[np.nan, loss]]))

    @property
    def epoch(self) -> int:
        return len(self.losses) - 1

    def after(self, weights: Any, moments: Any, losses: tuple[float, float]) -> "_State":
        train, test = (value if np.isfinite(value) else np.inf for value in losses)
        better = test < np.min(self.losses[:, 1])
        best = weights if better else self.best
        return _State(weights, moments, best, np.vstack([self.losses, [train, test]]))

    def arrays(self) -> dict[str, Any]:
        import jax

        parts = {"weights": self.weights, "best": self.best}
        named = {f"{part}/{name}": array for part, of in parts.items() for name, array in of.items()}
        numbered = {
            f"moments/{k}": np.asarray(array) for k, array in enumerate(jax.tree.leaves(self.moments))
        }
        return {**named, **numbered, "losses": self.losses}

    def restored(self, arrays: dict[str, Any]) -> "_State":
        """Return the saved state of a training that began as this one.

        Raises
        ------
        LookupError, ValueError
            An array is missing, or has another type or shape.
        """
        import jax

        for name, now in self.arrays().items():
            saved = arrays[name]
            losses = name == "losses" and len(saved) > 1
            if saved.dtype != now.dtype or saved.shape[losses:] != now.shape[losses:]:
                raise ValueError(f"{name} has another type or shape")

        def part(name: str) -> dict[str, Any]:
            return {key.split("/")[1]: array for key, array in arrays.items() if key.startswith(f"{name}/")}

        leaves, structure = jax.tree.flatten(self.moments)
        moments = structure.unflatten([arrays[f"moments/{k}"] for k in range(len(leaves))])
        return _State(part("weights"), moments, part("best"), arrays["losses"])
