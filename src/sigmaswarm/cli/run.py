"""`sigmaswarm run`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def run(
    tuning: Annotated[Path, Parameter(name="TUNING")],
    drive: Annotated[Path, Parameter(name="DRIVE")],
    /,
    *,
    out: Path,
    json: Annotated[bool, Parameter(negative=())] = False,
) -> None:
    """Run a tuned filter over a drive and write its estimates.

    Examples:

        sigmaswarm run tuned drives/friday --out estimate.csv
        sigmaswarm run tuned drives/friday --out estimate.tum

    Parameters
    ----------
    tuning
        A tuning.toml, or the folder that holds it.
    drive
        A drive folder.
    out
        NAME.csv (t, x, y, vx, vy, theta and their standard deviations) or NAME.tum (t x y z qx qy qz qw).
    json
        Print a summary for machines.
    """
    import sigmaswarm
    from sigmaswarm.cli.common import print_json, stdout
    from sigmaswarm.errors import SigmaswarmError
    from sigmaswarm.export.trajectory import check_target, write_estimate

    check_target(out)
    parameters = sigmaswarm.FilterParameters.load(tuning)
    estimate = sigmaswarm.run_filter(sigmaswarm.read_drive(drive), parameters)
    if estimate.failure:
        raise SigmaswarmError(estimate.failure)
    write_estimate(estimate, out)
    first, last = float(estimate.time[0]), float(estimate.time[-1])
    if json:
        print_json({"out": str(out), "estimates": len(estimate.time), "start_s": first, "end_s": last})
    else:
        stdout().print(f"wrote {len(estimate.time)} estimates from {first:.2f} s to {last:.2f} s to {out}")
