"""The formats that can be read, in the order of detection."""

import difflib
import re
from collections.abc import Generator, Sequence
from contextlib import ExitStack, contextmanager
from importlib import import_module
from pathlib import Path
from shlex import quote
from typing import Any

from sigmaswarm.errors import InputError
from sigmaswarm.file_sizes import require_regular, require_text
from sigmaswarm.importing.source import Limits, Log, first_bytes, is_empty, no_log_error
from sigmaswarm.wording import list_names

# For each format (--format): the module in ``readers/``, and a description. The most general format is last. Each
# module has two functions. ``recognizes(path)`` returns True if the name or the first bytes of a file or folder show
# the format; it needs no library. ``open_log(path, limits, stack)`` returns a `Log`; the stack closes its files.
READERS: dict[str, tuple[str, str]] = {
    "mcap": ("mcap", "an MCAP file: ROS 1, ROS 2, JSON or Protobuf messages"),
    "ros": ("ros", "a ROS 1 bag, or a ROS 2 bag's folder or file"),
    "kitti": ("kitti", "a KITTI raw drive: its OXTS text files"),
    "nclt": ("nclt", "an NCLT session"),
    "comma2k19": ("comma2k19", "a comma2k19 segment"),
    "rtklib": ("rtklib", "an RTKLIB solution, .pos: fixes or truth"),
    "ubx": ("ubx", "u-blox UBX with NAV-PVT, or NAV-POSLLH: fixes"),
    "nmea": ("nmea", "NMEA 0183 sentences: fixes"),
    "px4": ("px4", "a PX4 flight log, .ulg"),
    "ardupilot": ("ardupilot", "an ArduPilot dataflash log, .bin or .log"),
    "matlab": ("matlab", "a MATLAB file, .mat"),
    "sensor-logger": ("sensor_logger", "Sensor Logger's export, a folder or .zip"),
    "phyphox": ("phyphox", "phyphox's export as CSV, a folder or .zip"),
    "gnss-logger": ("gnss_logger", "a text file of Android's GnssLogger"),
    "json": ("json_rows", "JSON: a list of objects, or an object on each line; a file or a folder"),
    "csv": ("columns", "CSV or Parquet: a file or a folder of files; a zip of CSV files"),
}
# Formats of a single file
_SINGLE = ("mcap", "rtklib", "ubx", "nmea", "px4", "ardupilot", "matlab", "gnss-logger")
_MIXED = ("nmea", "gnss-logger")  # formats of text with several kinds of lines
_TEXTS = (*_MIXED, "rtklib", "csv")
_LINES_OF_ROW = 10  # largest number of lines per row of a table, in the formats `_MIXED`
_TITLES = 1000  # largest number of lines above a table
# Suffixes of formats that are not supported, and how to convert them
NOT_READ = {
    ".xlsx .xls .ods": "a spreadsheet; save it as CSV",
    ".tlog": "a MAVLink log; import the autopilot's dataflash log (.bin) of the same drive, or the CSV of: "
    "mavlogdump.py --format csv --types SCALED_IMU,GPS_RAW_INT LOG.tlog > log.csv",
    ".bbl .bfl": "a blackbox log; import the CSV that this command writes: blackbox_decode --merge-gps "
    "--unit-acceleration m/s2 --unit-rotation deg/s LOG.BBL",
    ".mf4 .mdf": "an ASAM measurement file; export it as CSV, for example with asammdf",
    ".sbf": "a Septentrio stream; convert it to NMEA with sbfconvert or RxTools",
    ".rtcm .rtcm3 .obs "
    ".rnx": "a file of raw measurements; compute fixes with RTKLIB (convbin, rnx2rtkp), and import the .pos file",
    ".gpx .kml .kmz .fit .tcx .geojson": "a track; convert it to CSV, for example from GPX with: gpsbabel -i gpx "
    "-f FILE -o unicsv -F track.csv",
    ".json .jsonl .ndjson": "JSON without objects; write a list with an object for each sample",
    ".sql": "a database dump; export its tables as CSV, for example with COPY ... TO 'log.csv' CSV HEADER",
    ".npy .npz .pkl .pickle": "a file of Python arrays; make a drive with sigmaswarm.Drive.from_arrays, or save them "
    "as CSV",
    ".active": "a bag that was not closed; run `rosbag reindex`, and remove .active from its name",
    ".nc .cdf": "a NetCDF file; write its variables as CSV, for example with xarray: to_dataframe().to_csv",
    ".tdms": "a LabVIEW measurement file; write its channels as CSV, for example with nptdms",
    ".h5 .hdf5": "an HDF5 file; write its tables as CSV, for example with pandas.read_hdf(...).to_csv",
    ".feather .arrow .orc .avro": "a table in another binary format; save it as Parquet or CSV",
    ".gz .bz2 .xz .zst .7z .tar .tgz .rar": "a compressed file or an archive; unpack it",
    ".db .sqlite": "a database; export its tables as CSV (a ROS 2 bag has the suffix .db3)",
    ".vbo": "a Racelogic file; import new.txt, which this command writes, with latitude and longitude in degrees: awk "
    '\'/^\\[column names/ {getline; print; for (i = 1; i <= NF; i++) n[$i] = i} d && NF > 3 {$n["lat"] = '
    'sprintf("%.9f", $n["lat"] / 60); $n["long"] = sprintf("%.9f", -$n["long"] / 60); print} '
    "/^\\[data/ {d = 1}' FILE > new.txt",
    ".fitcsv": "the messages of a FIT file; import the file that ends in _data.csv, which FitCSVTool writes with the "
    "option --data accelerometer_data,gyroscope_data,gps_metadata",
    ".ld .xrk .drk": "a race car log; export it as CSV with the logger's program (MoTeC i2, Race Studio)",
    ".blf": "a CAN bus log; decode its signals with their DBC file, for example with asammdf, and export CSV",
    ".novatel": "a NovAtel log; convert the fixes to NMEA with NovAtel Convert, and the IMU to CSV",
    ".mtb": "an Xsens recording; export it as text with MT Manager, with UTC time and position",
    ".mp4 .mov .insv": "a video; extract the telemetry of its IMU and GPS as CSV, for example with gopro-telemetry",
    ".echo": "a text printed by rostopic echo or ros2 topic echo; import the bag, or print its messages as CSV: "
    "rostopic echo -b BAG -p TOPIC > imu.csv (ROS 1), ros2 topic echo --csv TOPIC > imu.csv (ROS 2)",
    ".mavtext": "a dataflash log printed by mavlogdump.py; import the log itself (.bin)",
    ".pcap .pcapng": "a capture of network packets; decode them with the sensor's own program, and export CSV",
}
# Patterns of the first bytes of these formats
_MAGIC = {
    **{rb"H Product:Blackbox": ".bbl", rb"MDF  ": ".mf4", rb"\x89HDF": ".h5", rb"\x1f\x8b": ".gz"},
    rb"(?:#BESTPOSA|#INSPVA|[#%]RAWIMU|\xaaD\x12)": ".novatel",
    rb"(?:File created on [^\n]*\s*)?\[header\]": ".vbo",
    rb"Type,Local Number,Message,": ".fitcsv",
    rb"\s*header: *\r?\n +(?:seq|stamp|frame_id):": ".echo",
    rb"CDF[\x01\x02\x05]": ".nc",
    rb"TDSm": ".tdms",
    rb"[^\n]{60}RINEX VERSION": ".obs",
    rb"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d+: [A-Z]\w* \{": ".mavtext",
    rb"\(\d+\.\d+\) +\w*can\w* ": ".blf",
}


@contextmanager
def open_log(
    path: Path, form: str | None = None, limits: Limits | None = None, definitions: Sequence[Path] = ()
) -> Generator[Log]:
    """Open a log in a named or detected format.

    ``definitions`` are files or folders with .msg definitions of ROS messages, for bags.
    """
    if not path.exists():
        raise InputError(f"{path} does not exist; specify a log file or its folder")
    if is_empty(path):
        raise InputError(f"{path} is empty; copy the log again")
    if path.is_dir() and not any(path.iterdir()):
        raise no_log_error(path)
    require_regular(path)
    form = form or format_of(path)
    if path.is_dir() and form in _SINGLE:
        raise InputError(f"{path}: is a folder; specify the {form} file in it")
    limits = limits or Limits()
    for text in _texts(path, form):
        _, lines = require_text(text)
        limits.check_rows(lines // (_LINES_OF_ROW if form in _MIXED else 1) - _TITLES, path, text.name)
    more = (definitions,) if form == "ros" else ()
    with ExitStack() as stack:
        yield _reader(form).open_log(path, limits, stack, *more)


def _texts(path: Path, form: str) -> list[Path]:
    """List the text files whose size and line count must be checked here; empty if the format's reader checks them."""
    if path.is_file():
        return [path] if form in _TEXTS and first_bytes(path, 4) not in (b"PAR1", b"PK\3\4") else []
    tables = _reader("csv")
    inside = (
        path.rglob("*")
        if form in ("kitti", "comma2k19")
        else (*path.iterdir(), *tables.files_of_sensors(path))
    )
    texts = (".csv", ".tsv", ".txt", *(tables.OTHER_SUFFIXES if form == "csv" else ()))
    for file in (files := sorted(file for file in inside if file.suffix.lower() in texts)):
        require_regular(file)
    return [file for file in files if file.is_file() and first_bytes(file, 4) != b"PAR1"]


def format_of(path: Path) -> str:
    for name in READERS:
        if name == "csv" and (what := unsupported_format(path)):
            raise InputError(f"{path}: can't be imported, since it is {what}")
        if _reader(name).recognizes(path):
            return name
    below = [*path.glob("*/[!.]*.csv"), *path.glob("*/*/[!.]*.csv")] if path.is_dir() else []
    if below:
        folders = [*dict.fromkeys(file.parent for file in sorted(below))]
        there = list_names(folder.relative_to(path) for folder in folders)
        several = [folder for folder in folders if sum(file.parent == folder for file in below) > 1]
        remedy = f"import one file, such as {min(below)}, and specify the others with --gps, --truth and --odometer"
        remedy = f"import each log, for example {quote(str(several[0]))}" if several else remedy
        raise InputError(f"{path}: contains no log, but folders with tables ({there}); {remedy}")
    if path.is_dir():
        raise no_log_error(path)
    others = "if it has another format, save it as CSV with the program that wrote it"
    raise InputError(
        f"{path}: has an unknown format; choose one with --format: {', '.join(READERS)}; {others}"
    )


def unsupported_format(path: Path) -> str:
    """Return a description of a known but unsupported format, found by suffix or first bytes; otherwise ""."""
    if not path.is_file():
        return ""
    head = first_bytes(path, 256)
    kinds = {path.suffix.lower(), *(end for magic, end in _MAGIC.items() if re.match(magic, head))}
    return next((what for endings, what in NOT_READ.items() if kinds & {*endings.split()}), "")


def _reader(name: str) -> Any:
    if name not in READERS:
        near = difflib.get_close_matches(name, READERS, 1)
        hint = f"perhaps {near[0]}" if near else f"choose from {', '.join(READERS)}"
        raise InputError(f"--format {name!r} is unknown; {hint}")
    return import_module(f"sigmaswarm.importing.readers.{READERS[name][0]}")
