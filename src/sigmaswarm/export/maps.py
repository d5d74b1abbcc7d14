"""Tracks for maps: GeoJSON (RFC 7946), GPX 1.1 and KML 2.2, in degrees on WGS-84, without heights.

A clock that counts from 1970 can be told by its size; only then are times written, in UTC.
"""

import json
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from sigmaswarm.drives.drive import Array
from sigmaswarm.files import write_whole

Origin = tuple[float, float, float]
"""Latitude (deg), longitude (deg), altitude (m) of x = y = 0."""

_IS_UNIX_TIME = 1e9
"""s: a clock beyond it counts from 1970 (it was passed in 2001), not from a start."""


def geojson(time: Array, places: Array, path: Path) -> None:
    """One LineString; places (n, 2) are latitude and longitude, deg. ``coordTimes`` is as togeojson writes it."""
    line = [[_rounded(lon), _rounded(lat)] for lat, lon in places]
    stamps = _stamps(time)
    properties = {"name": path.stem} | ({"coordTimes": stamps} if stamps else {"t": time.tolist()})
    feature = {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": "LineString", "coordinates": line},
    }
    write_whole(path, json.dumps(feature) + "\n")


def gpx(time: Array, places: Array, path: Path) -> None:
    """One track of one segment."""
    stamps = [f"<time>{stamp}</time>" for stamp in _stamps(time)] or [""] * len(time)
    points = [
        f'<trkpt lat="{lat:.9f}" lon="{lon:.9f}">{stamp}</trkpt>'
        for (lat, lon), stamp in zip(places, stamps, strict=True)
    ]
    head = '<gpx version="1.1" creator="sigmaswarm" xmlns="http://www.topografix.com/GPX/1/1">'
    _write_xml(
        path, [head, f"<trk><name>{_escaped(path.stem)}</name><trkseg>", *points, "</trkseg></trk>", "</gpx>"]
    )


def kml(time: Array, places: Array, path: Path) -> None:
    """One line on the ground."""
    points = [f"{lon:.9f},{lat:.9f}" for lat, lon in places]
    head = '<kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark>'
    name = f"<name>{_escaped(path.stem)}</name><LineString><tessellate>1</tessellate><coordinates>"
    _write_xml(path, [head, name, *points, "</coordinates></LineString>", "</Placemark></Document></kml>"])


def _write_xml(path: Path, lines: list[str]) -> None:
    write_whole(path, "\n".join(['<?xml version="1.0" encoding="UTF-8"?>', *lines]) + "\n")


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;")


def _stamps(time: Array) -> list[str]:
    """Times in UTC, or none where the clock has no date."""
    if not len(time) or time[0] < _IS_UNIX_TIME:
        return []
    return [
        datetime.fromtimestamp(float(t), UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        for t in time
    ]


def _rounded(degrees: float) -> float:
    return round(float(degrees), 9)


MAPS: dict[str, Callable[[Array, Array, Path], None]] = {".geojson": geojson, ".gpx": gpx, ".kml": kml}
"""By the file's ending: from times (n,) s and places (n, 2) deg to a file."""
