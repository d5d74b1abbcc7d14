"""`sigmaswarm workbench`."""

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from sigmaswarm.errors import not_installed


def workbench(
    logs: Annotated[list[Path] | None, Parameter(name="LOG")] = None,
    /,
    *,
    out: Path = Path("workbench"),
    port: int = 0,
    no_browser: bool = False,
) -> None:
    """Import, check, tune, evaluate and export in the browser.

    The server accepts connections only from this machine. The page's address contains a secret token. Other commands
    can read the drives, tunings and evaluations in OUT. An interrupted tuning run in OUT can be resumed.

    For example:

        sigmaswarm workbench monday.mcap
        sigmaswarm workbench
        sigmaswarm workbench phone-export --out trial

    Parameters
    ----------
    logs
        Log files or folders to open. You can drop more logs onto the page.
    out
        Folder for drives, tunings, evaluations and exports.
    port
        Port of the server; by default a free port.
    no_browser
        Print the address without opening a browser.
    """
    if find_spec("nicegui") is None:
        raise not_installed("the workbench", "NiceGUI", "'sigmaswarm[workbench]'")
    from sigmaswarm.workbench.server import serve

    serve(out, list(logs or ()), port=port, browse=not no_browser)
