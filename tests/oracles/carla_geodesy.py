"""CARLA's geodesies for comparison: that of 0.9.14 from its source, that of 0.9.16 from the genuine client.

The formula is that of LibCarla/source/carla/geom/GeoLocation.cpp in 0.9.14, for single numbers.
"""

import json
import math
import subprocess
import sys

_CLIENT = """
import json, sys, carla
latitude, longitude, places = json.load(sys.stdin)
georeference = f"+proj=tmerc +lat_0={latitude!r} +lon_0={longitude!r}"
road = '''<road name="" length="100" id="0" junction="-1"><link/><planView>
<geometry s="0" x="0" y="0" hdg="0" length="100"><line/></geometry></planView>
<elevationProfile/><lateralProfile/><lanes><laneSection s="0">
<center><lane id="0" type="none" level="false"/></center><right><lane id="-1" type="driving" level="false">
<width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane></right></laneSection></lanes></road>'''
header = f'<header revMajor="1" revMinor="4"><geoReference><![CDATA[{georeference}]]></geoReference></header>'
world = carla.Map("plane", f'<?xml version="1.0"?><OpenDRIVE>{header}{road}</OpenDRIVE>')
found = [world.transform_to_geolocation(carla.Location(x=x, y=y, z=0.0)) for x, y in places]
print("ANSWER" + json.dumps([[g.latitude, g.longitude] for g in found]), flush=True)
"""


def formula_0914(x: float, y: float, latitude: float, longitude: float) -> tuple[float, float]:
    """Return latitude and longitude of CARLA 0.9.14."""
    radius = 6378137.0
    scale = math.cos(latitude * math.pi / 180.0)
    mx = scale * longitude * math.pi * radius / 180.0
    my = scale * radius * math.log(math.tan((90.0 + latitude) * math.pi / 360.0))
    mx += x
    my -= y
    lon = mx * 180.0 / (math.pi * radius * scale)
    lat = 360.0 * math.atan(math.exp(my / (radius * scale))) / math.pi - 90.0
    return lat, lon


def client_0916(places: list[tuple[float, float]], latitude: float, longitude: float) -> list[list[float]]:
    """Return latitudes and longitudes from the installed client in a separate process, since it may abort at exit."""
    request = json.dumps([latitude, longitude, places])
    done = subprocess.run(
        [sys.executable, "-c", _CLIENT],
        input=request,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    answers = [line for line in done.stdout.splitlines() if line.startswith("ANSWER")]
    assert answers, done.stderr
    return json.loads(answers[0].removeprefix("ANSWER"))
