"""`sigmaswarm noise`."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from sigmaswarm.cli.common import print_json, require_result_folder
from sigmaswarm.cli.options import FIELDS, Json, Overwrite
from sigmaswarm.cli.terminal import print_lines
from sigmaswarm.errors import InputError

if TYPE_CHECKING:
    from sigmaswarm.noise import Noise


RESULT_KIND = "IMU noise analysis"  # name of the result in its folder and in messages, after "an"


@dataclass(frozen=True, kw_only=True)
class NoiseOptions:
    """Options of `sigmaswarm noise`.

    Attributes
    ----------
    tuned
        Show the process noise Q of this tuning instead of the noise of a log.
    to
        Print the noise in the formats and units of these packages; with --out, write it to files.
    out
        Folder for the files of --to and, for a log, noise.png, noise.svg and noise.json.
    recipe
        Use the recipe in a file that `sigmaswarm import --save-recipe` wrote.
    map
        Columns of the IMU as column=expression, as in `sigmaswarm import`: "ax=acc_x*9.80665".
    time
        Expression for the time in s, as in `sigmaswarm import`.
    imu_topic
        Topic or table of the IMU.
    """

    tuned: Path | None = None
    to: list[Literal["sigmaswarm", "kf-gins", "kalibr", "robot_localization", "matlab"]] | None = None
    out: Path | None = None
    recipe: Path | None = None
    map: list[str] | None = None
    time: str | None = None
    imu_topic: Annotated[str | None, Parameter(alias="--imu-table")] = None
    overwrite: Overwrite = False
    json: Json = False


def noise(
    log: Annotated[
        Path | None, Parameter(name="LOG", help="A drive folder, or a log that `sigmaswarm import` can read.")
    ] = None,
    /,
    *,
    options: Annotated[NoiseOptions, FIELDS] = NoiseOptions(),
) -> None:
    """Measure the noise of an IMU at rest, and convert it for other software.

    The log needs no fixes. From an hour at rest, white noise, bias instability and rate random walk can be estimated.
    The standstills of a drive are short, so usually only the white noise can be estimated.

    For example:

        sigmaswarm noise static.csv
        sigmaswarm noise static.bag --imu-topic /imu/data --to kalibr --out noise
        sigmaswarm noise drives/friday --to sigmaswarm kf-gins
        sigmaswarm noise --tuned tuned --to kf-gins
    """
    from sigmaswarm.exports.imu_noise import noise_texts

    if options.out is not None:
        require_result_folder(options.out, [log, options.tuned], RESULT_KIND, overwrite=options.overwrite)
    measured = _noise_of(log, options)
    texts = {
        file: text for target in options.to or () for file, text in noise_texts(measured, target).items()
    }
    written = [] if options.out is None else _write(measured, texts, options.out, figure=log is not None)
    if options.json:
        print_json(measured.to_dict() | {"written": [str(path) for path in written], "texts": texts})
        return
    print_lines(measured.table().to_rich(grouped=True), *(f"note: {remark}" for remark in measured.remarks))
    if options.out is None:
        print_lines(*(line for file, text in texts.items() for line in ("", f"{file}:", text.rstrip("\n"))))
    print_lines(*(f"wrote {path}" for path in written))


def _noise_of(log: Path | None, options: NoiseOptions) -> "Noise":
    from sigmaswarm.filters.parameters import FilterParameters
    from sigmaswarm.noise import filter_noise, imu_noise

    if (log is None) == (options.tuned is None):
        raise InputError("specify either a LOG or --tuned TUNING")
    if options.tuned is not None:
        return filter_noise(FilterParameters.load(options.tuned), str(options.tuned))
    settings: dict[str, Any] = {"recipe": options.recipe, "maps": options.map, "time": options.time}
    if options.imu_topic:
        from sigmaswarm.importing.source import TableChoice

        settings["choice"] = TableChoice({"imu": options.imu_topic})
    return imu_noise(log or "", **{key: value for key, value in settings.items() if value})


def _write(noise: "Noise", texts: dict[str, str], out: Path, *, figure: bool) -> list[Path]:
    import json

    from sigmaswarm.files import nan_to_none, staged_files, write_atomically
    from sigmaswarm.reports.figures import save_both
    from sigmaswarm.reports.noise import noise_figure

    if figure:
        texts = {**texts, "noise.json": json.dumps(nan_to_none(noise.to_dict()), indent=1)}
    with staged_files(out, RESULT_KIND) as new:
        for file, text in texts.items():
            write_atomically(new / file, text)
        drawn = save_both(noise_figure(noise), new / "noise") if figure else []
    return [out / name for name in (*texts, *(path.name for path in drawn))]
