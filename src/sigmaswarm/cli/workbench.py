"""`sigmaswarm workbench`."""

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from sigmaswarm.errors import InputError


def workbench(
    logs: Annotated[list[Path] | None, Parameter(name="LOG")] = None,
    /,
    *,
    out: Path = Path("workbench"),
    port: int = 0,
    no_browser: bool = False,
) -> None:
    """Import, check, tune, evaluate and export in the browser.

    The page is served on this machine only, at an address with a secret token. OUT is an ordinary folder of drives,
    tunings and evaluations, which the other commands can also read. An interrupted tuning is resumed in OUT.

    For example:

        sigmaswarm workbench monday.mcap
        sigmaswarm workbench
        sigmaswarm workbench phone-export --out trial

    Parameters
    ----------
    logs
        Logs to open; more can be dropped into the page.
    out
        Folder for drives, tunings, evaluations and exports; created if missing.
    port
        Port of the server; by default a free one.
    no_browser
        Print the address without opening a browser.
    """
    if find_spec("nicegui") is None:
        raise InputError(
            "the workbench needs NiceGUI, which is not installed; run: pip install 'sigmaswarm[workbench]'"
        )
    from sigmaswarm.workbench.server import serve

    serve(out, list(logs or ()), port=port, browse=not no_browser)
