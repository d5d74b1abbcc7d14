"""Training: gradients through the same filter, the same bits after any interruption, and the commands."""

import json
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest

from filter_cases import OPTIONS, equipped, parameters
from quick_learners import QuickOutages, square
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.writer import write_drive
from sigmaswarm.errors import InputError
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.run import whole_pass
from sigmaswarm.filters.starts import start_of
from sigmaswarm.geodesy import wrap_angle
from sigmaswarm.learned import noise_training, outage_training
from sigmaswarm.learned.fitting import Schedule, TrainingProblem, double_precision, fit, new_weights
from sigmaswarm.learned.folder import load_learned
from sigmaswarm.learned.learn import LEARNERS, LearnConfig, learn
from sigmaswarm.learned.noise_gru import FEATURES, NoiseRun
from sigmaswarm.learned.noise_training import require_supported
from support import make_drive, quickly, require, sparse

require("optax", "JAX and Optax are not installed (extra learned)")

ALL = OPTIONS["all"] | {"velocity_noise": None}
ONE_STEP = Schedule(0.01, epochs=1, batch=1, patience=5, seed=0)


@pytest.mark.parametrize(
    ("model", "option"),
    quickly([("planar5", {"robust_dof": 4.0}), ("planar8", ALL)], lambda model, _: model == "planar5"),
    ids=["robust", "all"],
)
def test_the_differentiable_filter_agrees_with_the_compiled_filter(model: str, option: dict[str, float]):
    """Compare over a whole drive, with scales of one and with those of a network."""
    import jax

    from sigmaswarm.learned.noise_filter import FilterConstants, columns_of, run

    p, drive_pass = parameters(model, kind="ekf", **option), whole_pass(sparse(equipped()))
    weights = new_weights(np.random.default_rng(0), 3, FEATURES, 5, 2)
    through = jax.jit(partial(run, FilterConstants.of(drive_pass, p)))
    for head in (0.0, 0.5):
        weights["head"] = head * np.random.default_rng(1).normal(size=(5, 2))
        compiled = NoiseRun(drive_pass, p, weights)
        mean = compiled.whole().mean
        with double_precision():
            columns, _ = columns_of(drive_pass, p)
            told = through(weights, *start_of(drive_pass.initial, p), columns)
        said, means = (np.asarray(array) for array in told)
        fixes = said[:, 5] > 0
        np.testing.assert_allclose(said[fixes, :2], compiled.innovations.innovation, atol=1e-9)
        s = compiled.innovations.covariance.reshape(-1, 4)[:, [0, 1, 3]]
        np.testing.assert_allclose(said[fixes, 2:5], s, rtol=1e-9, atol=1e-9)
        off = means[drive_pass.timeline.sampled] - mean
        off[:, THETA] = wrap_angle(off[:, THETA])
        np.testing.assert_allclose(off, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("p", "said"),
    [
        (parameters("tilted12"), "does not support tilted12"),
        (parameters("planar8", kind="adaptive-ukf"), "adapts its noise"),
        (parameters("planar8", velocity_noise=0.1), "velocity_noise"),
    ],
)
def test_filters_that_the_training_does_not_support_are_rejected(p, said: str):
    with pytest.raises(InputError, match=said):
        require_supported(p)


class Stopped(Exception):
    pass


def test_an_interrupted_fit_ends_in_the_same_bits(tmp_path: Path):
    rng = np.random.default_rng(0)
    x = rng.normal(size=(60, 3))
    examples = (x[:40], x[:40] @ [1.0, -2.0, 0.5]), (x[40:], x[40:] @ [1.0, -2.0, 0.5])
    asked = (
        TrainingProblem(square, {"w": np.zeros(3)}, *examples),
        Schedule(0.1, 30, batch=8, patience=30, seed=4),
    )
    whole = fit(*asked)
    assert whole.best < 0.01 * whole.losses[0, 1]

    def stop(epoch: int, loss: float) -> None:
        if epoch == 7:
            raise Stopped

    file = tmp_path / "checkpoint.npz"
    with pytest.raises(Stopped):
        fit(*asked, checkpoint=file, progress=stop)
    again = fit(*asked, checkpoint=file)
    assert again.weights["w"].tobytes() == whole.weights["w"].tobytes()
    assert again.losses.tobytes() == whole.losses.tobytes()


def test_one_step_of_adam_agrees_with_the_paper():
    x = np.array([[1.0, 2.0]])
    example = x, np.array([1.7])
    found = fit(TrainingProblem(square, {"w": np.array([0.5, 0.5])}, example, example), ONE_STEP)
    gradient = 2 * (1.5 - 1.7) * x[0]
    step = gradient / np.abs(gradient)  # m / sqrt(v) after one step, both with bias correction
    np.testing.assert_allclose(found.weights["w"], 0.5 - 0.01 * (step + 1e-4 * 0.5), rtol=1e-6)


def test_a_step_that_is_not_finite_is_omitted():
    x = np.array([[1.0, 2.0], [np.inf, 0.0]])
    example = (x[:1], np.array([1.7]))
    start = {"w": np.array([0.5, 0.5])}
    both = fit(TrainingProblem(square, start, (x, np.array([1.7, 0.0])), example), ONE_STEP)
    alone = fit(TrainingProblem(square, start, example, example), ONE_STEP)
    np.testing.assert_array_equal(both.weights["w"], alone.weights["w"])


@cache
def drives() -> tuple[Drive, ...]:
    return tuple(make_drive(duration=100.0, seed=s, name=f"drive-{s}") for s in range(2))


class OfBoth(QuickOutages):
    def __init__(self, drives, validation, parameters, seed):
        super().__init__(drives, validation, parameters, seed)
        assert self.seen == ["drive-0", "drive-1"]


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(LEARNERS, "outage-lstm", OfBoth)


def test_an_interrupted_search_ends_in_the_same_bytes(quick, tmp_path: Path):
    p = parameters("planar8", lateral_noise=0.05)
    config = LearnConfig("outage-lstm", p, drives(), search=3)
    learn(config, tmp_path / "whole")

    def stop(told) -> None:
        if (told.trial, told.epoch) == (2, 2):
            raise Stopped

    with pytest.raises(Stopped):
        learn(config, tmp_path / "parts", progress=stop)
    with pytest.raises(InputError, match="add --resume"):
        learn(config, tmp_path / "parts")
    with pytest.raises(InputError, match="seed = 0, but this command has seed = 1"):
        learn(replace(config, seed=1), tmp_path / "parts", resume=True)
    found = learn(config, tmp_path / "parts", resume=True)
    for file in ("learned.toml", "weights.npz", "tuning.toml", "learned_seen.npz"):
        assert (tmp_path / "parts" / file).read_bytes() == (tmp_path / "whole" / file).read_bytes()
    costs = [
        json.loads((tmp_path / "whole" / f"trial-{i:03d}" / "result.json").read_text())["cost"]
        for i in range(4)
    ]
    assert found.record.training.loss == min(costs)
    assert len(set(costs)) > 2


@pytest.mark.long
def test_the_gradient_of_the_noise_network_agrees_with_differences():
    p = parameters("planar5", kind="ekf")
    segments = noise_training.segments_of(drives()[:1], p, 2.0)
    batch = tuple(array[:2] for array in segments.arrays)
    weights = new_weights(np.random.default_rng(0), 3, FEATURES, 2, 2)
    weights["head"] = np.random.default_rng(1).normal(size=(2, 2))
    with double_precision():
        import jax

        loss = jax.jit(jax.value_and_grad(noise_training.loss(p)))
        gradient = loss(weights, batch)[1]
        for name, at in (("head_bias", (1,)), ("input", (0, 1)), ("head", (1, 0))):
            ahead, behind = ({**weights, name: weights[name].copy()} for _ in range(2))
            ahead[name][at] += 1e-5
            behind[name][at] -= 1e-5
            slope = (float(loss(ahead, batch)[0]) - float(loss(behind, batch)[0])) / 2e-5
            assert float(gradient[name][at]) == pytest.approx(slope, rel=1e-4, abs=1e-9)


@pytest.mark.long
def test_the_outage_network_learns_the_speed_of_the_car():
    """On other parts of the same drives, it is better than the mean; the same seed gives the same bits."""
    p = parameters("planar8", lateral_noise=0.05)
    tracks = outage_training.tracks_of(drives(), p)
    examples = outage_training.examples_of(tracks, ("ax", "ay", "gz"), 6.0)
    network, problem = outage_training.training_problem(
        examples, ("ax", "ay", "gz"), window=6.0, units=6, seed=3
    )
    found, again = (fit(problem, Schedule(0.01, epochs, batch=128, patience=15, seed=3)) for epochs in (8, 2))
    assert found.best < found.losses[0, 1]
    assert again.losses.tobytes() == found.losses[: len(again.losses)].tobytes()
    network = replace(network, weights={**found.weights, **problem.fixed})
    moved, variance = network.displacements(examples.arrays[0])
    assert moved.shape == variance.shape == examples.arrays[1].shape
    assert (variance > 0).all()


def test_truth_is_not_used():
    p = parameters("planar8", lateral_noise=0.05)
    blind = [replace(drive, truth=None) for drive in drives()]
    with_truth, without = (
        outage_training.examples_of(outage_training.tracks_of(of, p), ("ax", "gz"), 4.0)
        for of in (drives(), blind)
    )
    assert with_truth.arrays[1].tobytes() == without.arrays[1].tobytes()
    assert with_truth.held_back.any() and not with_truth.held_back.all()
    segments = [noise_training.segments_of(of, p, 8.0) for of in (drives(), blind)]
    assert [a.tobytes() for a in segments[0].arrays] == [a.tobytes() for a in segments[1].arrays]
    assert segments[0].held_back.any() and not segments[0].held_back.all()


def test_the_commands(quick, sigmaswarm, unpainted: None, tmp_path: Path):
    for drive in drives():
        write_drive(drive, tmp_path / "drives" / drive.name)
    parameters("planar8", lateral_noise=0.05).save(tmp_path / "tuning.toml")
    out, own = tmp_path / "learned", tmp_path / "drives" / "drive-0"
    ended = sigmaswarm(
        "learn", "outage-lstm", tmp_path / "tuning.toml", tmp_path / "drives", "--out", out, "--json"
    )
    assert ended.code == 0, ended.err
    assert json.loads(ended.out)["training"]["labelled_s"] == 0.0
    ended = sigmaswarm("evaluate", out, own, "--out", tmp_path / "evaluation", "--trust-log")
    assert ended.code == 0, ended.err
    assert "tuned, outage-lstm" in ended.out
    assert "the errors on training data are smaller" in " ".join(ended.err.split())  # tested on training data
    assert sigmaswarm("report", tmp_path / "evaluation").code == 0
    ended = sigmaswarm("evaluate", tmp_path / "evaluation" / "tuning.toml", own, "--json", "--trust-log")
    assert "outage-lstm" in json.loads(ended.out)["mean"]
    assert sigmaswarm("run", out, own, "--out", tmp_path / "estimate.csv").code == 0
    (out / "weights.npz").write_bytes(b"PK")
    ended = sigmaswarm("run", out, own, "--out", tmp_path / "estimate.csv")
    assert ended.code == 2
    assert (
        ended.err.strip()
        == f"sigmaswarm: {out / 'weights.npz'}: is not readable; repeat the command that made the folder"
    )
    with pytest.raises(InputError, match="not written by sigmaswarm"):
        (out / "learned.toml").write_text("kind = 3")
        load_learned(out)


@pytest.mark.parametrize("library", ["jax", "optax"])
def test_a_missing_library_is_reported_with_one_line(
    library: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    monkeypatch.setitem(__import__("sys").modules, library, None)
    with pytest.raises(InputError, match=r"pip install 'sigmaswarm\[learned\]'"):
        learn(LearnConfig("noise-gru", parameters("planar8"), drives()), tmp_path / "learned")
