"""The paper's setting, and options that contradict it."""

import pytest

from sigmaswarm.errors import InputError
from sigmaswarm.tuning.config import paper_options
from sigmaswarm.tuning.tune import tune
from support import make_drive

pytestmark = pytest.mark.usefixtures("undiagnosed")


@pytest.mark.filterwarnings("ignore:gps-rmse compares the filter")
def test_the_setting_equals_that_of_the_paper():
    config = tune(make_drive(duration=12.0), paper=True, seed=4, inertia=0.6).config
    asked = ("optimizer", "scale", "objective", "model", "kind", "particles", "generations", "polish", "seed")
    values = [getattr(config, name) for name in asked]
    assert values == ["pso", "linear", "gps-rmse", "planar5", "ukf", 30, 50, 0, 4]
    assert (config.inertia, config.cognitive, config.social) == (0.6, 1.5, 1.5)


@pytest.mark.parametrize(
    "option",
    [
        *({"optimizer": "de"}, {"scale": "log10"}, {"objective": "truth-rmse"}, {"model": "planar8"}),
        *({"kind": "ekf"}, {"particles": 20}, {"generations": 100}, {"polish": 10}, {"racing": True}),
        *({"use": ["gate"]}, {"worst": 0.5}, {"social": 2.0}, {"patience": 5}),
    ],
    ids=str,
)
def test_options_that_contradict_it_are_rejected(option: dict):
    (name,) = option
    with pytest.raises(InputError, match=f"{name} = .* contradicts the paper's setting"):
        tune(make_drive(duration=12.0), paper=True, **option)


def test_options_that_agree_with_it_are_accepted():
    assert paper_options({"scale": "linear", "use": [], "trials": 20})["trials"] == 20
