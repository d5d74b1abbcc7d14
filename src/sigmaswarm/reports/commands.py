"""Command that repeats a result, from the saved configuration."""

import shlex
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from typing import Any

from pydantic import ValidationError

from sigmaswarm.errors import InputError
from sigmaswarm.scoring.methods import AGAINST, BANK, SMOOTHED
from sigmaswarm.scoring.records import EvaluationRecord
from sigmaswarm.tuning.config import RENAMED, TuneConfig
from sigmaswarm.tuning.defaults import with_default_guards

STATED = ("objective", "particles", "generations", "trials", "seed", "model", "use")
"""Options that the command contains even at their defaults."""
DEFAULTS = {name: field.default for name, field in TuneConfig.model_fields.items()}
GUARDS = ("prior", "inflation")
"""Options of `tune` with a default that depends on the objective."""


def tune_command(
    config: Mapping[str, Any], drives: Sequence[str], validation: Sequence[str]
) -> tuple[str, str]:
    """Return the command of a tuning run and a note. For a custom model the command is empty."""
    if isinstance(config.get("model"), dict):
        return "", "The tuning has a custom model: repeat it in Python with sigmaswarm.tune."
    config = {RENAMED.get(name, name): value for name, value in config.items()}
    options = {name: config[name] for name in STATED if name in config}
    usual = _usual(config)
    config = dict.fromkeys(GUARDS, 0.0) | config  # older versions tuned without a prior and without inflation
    for name in DEFAULTS:
        value = config.get(name)
        if name not in STATED and value is not None:
            same = tuple(value) == usual[name] if isinstance(value, list) else value == usual[name]
            options |= {} if same else {name: value}
    words = ["sigmaswarm", "tune", *drives, "--out", "again"]
    for name, value in options.items():
        words += _option(f"--{name.replace('_', '-')}", value)
    words += ["--validation", *validation] if validation else []
    return shlex.join(words), "Replace the names of the drives by the paths of their folders."


def evaluate_command(
    drives: Sequence[str], setup: EvaluationRecord, *, also: Collection[str] = ()
) -> tuple[str, str]:
    words = ["sigmaswarm", "evaluate", "tuning.toml", *drives, "--out", "again"]
    words += ["--outage-length", f"{setup.outage_length_s:g}", "--outage-seed", str(setup.outage_seed)]
    words += ["--as-recorded"] if setup.as_recorded else []
    options = {AGAINST: ["--against", "against.toml"], SMOOTHED: ["--smooth"], BANK: ["--bank"]}
    words += [word for method in also for word in options.get(method, ())]  # the folder contains a network
    note = "tuning.toml is in the folder of this page. Replace the names of the drives by the paths of their folders."
    return shlex.join(words), note


def _usual(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return the defaults of `tune` for the model and the objective of a configuration."""
    usual = DEFAULTS | dict.fromkeys(GUARDS, 0.0)
    with suppress(ValidationError, KeyError):  # a model of another version
        usual["kind"] = TuneConfig.model_validate({"model": config["model"]}).kind
    asked = {name: config[name] for name in DEFAULTS if name in config and name not in GUARDS}
    with suppress(ValidationError, InputError):  # an objective of another version
        settled = with_default_guards(TuneConfig.model_validate(asked))
        usual |= {name: getattr(settled, name) for name in GUARDS}
    return usual


def _option(name: str, value: Any) -> list[str]:
    if value is True:
        return [name]
    if isinstance(value, list | tuple):
        return [name, *map(str, value)] if value else [f"{name}-nothing"]
    return [name, str(value)]
