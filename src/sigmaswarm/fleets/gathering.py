"""Drives as they are given, in any form, brought to where they are held."""

import warnings
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sigmaswarm.drives.drive import Drive, listed
from sigmaswarm.errors import InputError
from sigmaswarm.fleets.connection import Cluster
from sigmaswarm.fleets.fleet import Fleet, fleet_groups
from sigmaswarm.fleets.held import Held, Here

if TYPE_CHECKING:
    from distributed import Client


def held_drives(
    *groups: Any,
    cluster: "Client | None" = None,
    executor: Executor | None = None,
    takes: str = "Drives are needed",
) -> list[Held]:
    """Groups of drives where they are held: by a cluster's workers, all read at once, or here.

    ``takes`` tells who gives something else what is needed.

    Raises
    ------
    InputError
        If something is no drive, or both an executor and a cluster are given.
    """
    if cluster is not None and executor is not None:
        raise InputError(
            "both an executor and a cluster were given; a cluster's workers share the work already"
        )
    each = [group if isinstance(group, Fleet | Here) else _drives(group, cluster, takes) for group in groups]
    if cluster is None:
        return [group if isinstance(group, Fleet | Here) else Here(group) for group in each]
    fresh = fleet_groups(Cluster(cluster), [group for group in each if isinstance(group, list)])
    for warning in (warning for fleet in fresh for warning in fleet.warned):
        warnings.warn(warning, stacklevel=3)
    coming = iter(fresh)
    return [next(coming) if isinstance(group, list) else group for group in each]


def _drives(given: Any, cluster: "Client | None", takes: str) -> list[Any]:
    """What was given, one or many: drives, and for a cluster places of drives."""
    drives = [given] if isinstance(given, str | Path) else listed(given)
    allowed = Drive if cluster is None else Drive | str | Path
    stray = [type(thing).__name__ for thing in drives if not isinstance(thing, allowed)]
    if stray:
        paths = any(isinstance(thing, str | Path) for thing in drives)
        raise InputError(
            f"got a {stray[0]}; {takes}"
            + (", and with a cluster their paths and URLs" if cluster else "")
            + ("; sigmaswarm.read_drive(path) reads one" if paths and not cluster else "")
        )
    return drives
