"""The command that repeats a result, from the configuration that was saved with it."""

import shlex
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from pydantic import ValidationError

from sigmaswarm.errors import InputError
from sigmaswarm.scoring.drifts import OWN, SMOOTHED, SWARM
from sigmaswarm.tuning.config import RENAMED, TuneConfig
from sigmaswarm.tuning.defaults import with_guards

STATED = ("objective", "particles", "generations", "trials", "seed", "model", "use")
"""Options that the command names even at their defaults."""
DEFAULTS = {name: field.default for name, field in TuneConfig.model_fields.items()}
OTHERS = tuple(name for name in DEFAULTS if name not in STATED)
"""Options that it names where they are not at their defaults."""
GUARDS = ("prior", "inflation")
"""Those whose default in `tune` depends on the objective."""


def tune_command(
    config: Mapping[str, Any], drives: Sequence[str], validation: Sequence[str]
) -> tuple[str, str]:
    """Return the command of a tuning and its limits; no command for a custom model."""
    if isinstance(config.get("model"), dict):
        return "", "The model is the user's own: repeat the tuning in Python, with sigmaswarm.tune."
    config = {RENAMED.get(name, name): value for name, value in config.items()}
    options = {name: config[name] for name in STATED if name in config}
    told = dict.fromkeys(GUARDS, 0.0) | dict(config)  # versions that had no guards tuned without them
    usual = DEFAULTS | _settled(config) | _usual_kind(config)
    options |= {name: told[name] for name in OTHERS if name in told and not _same(told[name], usual[name])}
    words = ["sigmaswarm", "tune", *drives, "--out", "again"]
    for name, value in options.items():
        words += _option(name.replace("_", "-"), value)
    words += ["--validation", *validation] if validation else []
    return shlex.join(words), "Drives are called by their names: put the ways to your folders instead."


def evaluate_command(
    drives: Sequence[str],
    outage_length: float,
    outage_seed: int,
    *,
    also: Collection[str] = (),
) -> tuple[str, str]:
    """Return the command of an evaluation and its limits."""
    words = ["sigmaswarm", "evaluate", "tuning.toml", *drives, "--out", "again"]
    words += ["--outage-length", f"{outage_length:g}", "--outage-seed", str(outage_seed)]
    options = {OWN: ["--against", "against.toml"], SMOOTHED: ["--smooth"], SWARM: ["--swarm"]}
    words += [word for method in also for word in options.get(method, ())]  # a network is in the folder
    note = (
        "tuning.toml is the one in this page's folder. Drives are called by their names: put the ways to your "
        "folders instead."
    )
    return shlex.join(words), note


def _usual_kind(config: Mapping[str, Any]) -> dict[str, str]:
    """Return the default filter type of the model in `tune`."""
    try:
        return {"kind": TuneConfig.model_validate({"model": config["model"]}).kind}
    except (ValidationError, KeyError):  # of another version
        return {}


def _settled(config: Mapping[str, Any]) -> dict[str, float | None]:
    """Return the default guards of `tune`."""
    asked = {name: config[name] for name in DEFAULTS if name in config and name not in GUARDS}
    try:
        settled = with_guards(TuneConfig.model_validate(asked)).model_dump()
    except (ValidationError, InputError):  # of another version with other objectives
        return dict.fromkeys(GUARDS, 0.0)
    return {name: settled[name] for name in GUARDS}


def _same(value: Any, default: Any) -> bool:
    return value is None or (list(value) == list(default) if isinstance(default, tuple) else value == default)


def _option(name: str, value: Any) -> list[str]:
    if value is True:
        return [f"--{name}"]
    if isinstance(value, list | tuple):
        return [f"--{name}", *map(str, value)] if value else [f"--{name}-nothing"]
    return [f"--{name}", str(value)]
