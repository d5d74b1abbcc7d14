"""Write tracks for maps: GeoJSON (RFC 7946), GPX 1.1 and KML 2.2, in degrees on WGS-84, without heights.

Times of 1e9 to 2.5e11 s (years 2001 to 9892) are assumed to be Unix times, and are written as dates in UTC.
"""

import json
import re
from collections.abc import Callable
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.files import nan_to_none, write_atomically

_UNIX_TIMES = (1e9, 2.5e11)  # s, years 2001 to 9892
_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML 1.0 (section 2.2) forbids even if they are escaped. JSON forbids unpaired surrogates."""


_MAX_LONGITUDE = 179.999999999  # deg, largest longitude in GPX, which excludes 180 deg; the error is 0.1 mm


def geojson(time: Array, places: Array, path: Path, name: str) -> None:
    """Write a line, cut at the antimeridian (RFC 7946, 3.1.9). ``places`` (n, 2) contains latitude and longitude, deg.

    The property ``coordTimes`` has the format of togeojson: a list, or a list of lists for a line in parts.
    """
    parts = split_at_antimeridian(time, places)
    lines: list[Any] = [[[round(lon, 9), round(lat, 9)] for lat, lon in part.tolist()] for _, part in parts]
    times: list[Any] = [_stamps(t) or t.tolist() for t, _ in parts]
    kind = "MultiLineString"
    if len(parts) == 1:
        kind, (lines,), (times,) = "LineString", lines, times
    properties = {"name": _NOT_XML.sub("\ufffd", name), "coordTimes" if _stamps(time) else "t": times}
    geometry = {"type": kind, "coordinates": lines}
    feature = {"type": "Feature", "properties": properties, "geometry": geometry}
    write_atomically(path, json.dumps(nan_to_none(feature)) + "\n")


def gpx(time: Array, places: Array, path: Path, name: str) -> None:
    """Write a track, with a new segment at the antimeridian."""
    lines = ['<gpx version="1.1" creator="sigmaswarm" xmlns="http://www.topografix.com/GPX/1/1">']
    start = f"<trk><name>{_escaped(name)}</name><trkseg>"
    for t, part in split_at_antimeridian(time, places):
        stamps = [f"<time>{stamp}</time>" for stamp in _stamps(t)] or [""] * len(t)
        lines += [start]
        lines += [
            f'<trkpt lat="{lat:.9f}" lon="{min(lon, _MAX_LONGITUDE):.9f}">{stamp}</trkpt>'
            for (lat, lon), stamp in zip(part, stamps, strict=True)
        ]
        start = "</trkseg><trkseg>"
    _write_xml(path, [*lines, "</trkseg></trk>", "</gpx>"])


def kml(time: Array, places: Array, path: Path, name: str) -> None:
    """Write a track if the times are Unix times, otherwise a line without times; both are cut at the antimeridian."""
    if _stamps(time[:1]):
        _timed_kml(time, places, path, name)
        return
    parts = split_at_antimeridian(time, places)
    several = ("<MultiGeometry>", "</MultiGeometry>") if len(parts) > 1 else ("", "")
    start, end = "<LineString><tessellate>1</tessellate><coordinates>", "</coordinates></LineString>"
    lines = ['<kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark>']
    begin = f"<name>{_escaped(name)}</name>{several[0]}{start}"
    for _, part in parts:
        lines += [begin, *(f"{lon:.9f},{lat:.9f}" for lat, lon in part)]
        begin = end + start
    _write_xml(path, [*lines, f"{end}{several[1]}", "</Placemark></Document></kml>"])


def _timed_kml(time: Array, places: Array, path: Path, name: str) -> None:
    """Write a track in Google's extension of KML 2.2. Each part lists all times, then all positions."""
    lines = [
        '<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2"><Document>',
        f"<Placemark><name>{_escaped(name)}</name><gx:MultiTrack>",
    ]
    for t, part in split_at_antimeridian(time, places):
        lines += ["<gx:Track>", *(f"<when>{stamp}</when>" for stamp in _stamps(t))]
        lines += [*(f"<gx:coord>{lon:.9f} {lat:.9f} 0</gx:coord>" for lat, lon in part), "</gx:Track>"]
    _write_xml(path, [*lines, "</gx:MultiTrack></Placemark></Document></kml>"])


def split_at_antimeridian(time: Array, places: Array) -> list[tuple[Array, Array]]:
    """Cut a track at the antimeridian. Return the times (k,) in s and places (k, 2) in deg of each part.

    At each cut, a new point on the antimeridian ends one part and starts the next part.
    """
    turned = np.unwrap(places[:, 1], period=360.0)
    if (turned == places[:, 1]).all():
        return [(time, places)]
    track = np.column_stack([time, places[:, 0], turned])
    low, high = np.minimum(turned[:-1], turned[1:]), np.maximum(turned[:-1], turned[1:])
    edge = 360.0 * np.floor((low + 180.0) / 360.0) + 180.0
    at = np.flatnonzero(edge < high)
    fraction = (edge - turned[:-1])[at] / np.diff(turned)[at]
    on_it = track[at] + fraction[:, np.newaxis] * (track[at + 1] - track[at])
    on_it[:, 2] = edge[at]
    track = np.insert(track, at + 1, on_it, axis=0)
    turn = np.floor((0.5 * (track[:-1, 2] + track[1:, 2]) + 180.0) / 360.0)  # full turns
    ends = [0, *(np.flatnonzero(np.diff(turn)) + 1), len(turn)]
    parts: list[tuple[Array, Array]] = []
    for first, last in pairwise(ends):
        part = track[first : last + 1]
        parts.append((part[:, 0], part[:, 1:] - [0.0, 360.0 * turn[first]]))
    return parts


def _write_xml(path: Path, lines: list[str]) -> None:
    write_atomically(path, "\n".join(['<?xml version="1.0" encoding="UTF-8"?>', *lines]) + "\n")


def _escaped(text: str) -> str:
    return escape(_NOT_XML.sub("\ufffd", text))


def _stamps(time: Array) -> list[str]:
    """Return the times in UTC as text, or an empty list if they are not Unix times."""
    if not (len(time) and _UNIX_TIMES[0] <= time[0] and time[-1] <= _UNIX_TIMES[1]):
        return []
    return [
        datetime.fromtimestamp(float(t), UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        for t in time
    ]


MAPS: dict[str, Callable[[Array, Array, Path, str], None]] = {".geojson": geojson, ".gpx": gpx, ".kml": kml}
"""Writers by file extension. Arguments: times (n,), s; places (n, 2), deg; path; name of the track."""
