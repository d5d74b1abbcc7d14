"""`sigmaswarm demo`."""

from pathlib import Path

from sigmaswarm.cli.options import Json, Seed


def demo(
    *,
    out: Path = Path("demo"),
    seed: Seed = 0,
    json: Json = False,
) -> None:
    """Simulate drives, tune on some and evaluate on the others, in a minute.

    Example:

        sigmaswarm demo --out demo

    Parameters
    ----------
    out
        Folder for drives, tuning and pictures; the results of an earlier demo are replaced.
    seed
        Seed of the drives and the tuning.
    """
    import shutil

    import sigmaswarm
    from sigmaswarm.cli.common import print_evaluation, print_json, print_remarks, stdout
    from sigmaswarm.cli.progress import tuning_progress
    from sigmaswarm.errors import InputError
    from sigmaswarm.reports.evaluation import save_evaluation
    from sigmaswarm.reports.pages.folders import save_page
    from sigmaswarm.reports.tuning import save_tuning_figures
    from sigmaswarm.scoring.tracks import compared, picture_of
    from sigmaswarm.tuning.defaults import with_filter

    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: is a file; choose another --out")
    if out.exists() and any(out.iterdir()) and not (out / "tuning" / "config.json").exists():
        raise InputError(f"{out}: is not empty, and no earlier demo made it; choose another --out")
    shutil.rmtree(out, ignore_errors=True)
    console = stdout()
    # A car's IMU, shaken, and fixes whose noise a filter can average.
    drives = list(
        sigmaswarm.simulate_many(
            ("urban",), ("clear",), 8, seed=seed, duration=90.0, gps="white-1m", vibration=1.0
        )
    )
    for drive in drives:
        sigmaswarm.write_drive(drive, out / "drives" / drive.name)
    training, held_out = drives[:5], drives[5:]
    if not json:
        console.print(f"1. simulated {len(drives)} drives of 90 s through a town: {out / 'drives'}")
        console.print(f"2. tuning on {len(training)} of them (30 particles, 50 generations) ...")
        console.print(f"   model: {with_filter({}, training)[1]}")
    with tuning_progress("   tuning") as progress:
        tuning = sigmaswarm.tune(training, seed=seed, out=out / "tuning", progress=progress)
    if not json:
        print_remarks(tuning.remarks, indent="   ")
    filters = compared(training[0], tuning.parameters)
    save_tuning_figures(tuning, picture_of(training[0], filters, training[0].name), out / "tuning")
    evaluation = sigmaswarm.evaluate(held_out, tuning.parameters)
    save_evaluation(evaluation, out / "evaluation", out / "tuning")
    written = save_page(out / "evaluation")
    if json:
        print_json(evaluation.to_dict())
        return
    console.print(f"3. evaluated on {len(held_out)} drives that the tuning never saw")
    print_evaluation(evaluation)
    console.print(f"tuned filter: {out / 'tuning' / 'tuning.toml'}")
    console.print(f"pictures:     {out / 'tuning'} and {out / 'evaluation'} (*.png)")
    console.print(f"page:         {written}: open it in a browser")
    console.print("next:         sigmaswarm tune YOUR_DRIVE... --out tuned")
