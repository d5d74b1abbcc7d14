"""A small town as an OpenDRIVE text: a grid of two-lane streets with junctions; one street is a kilometer long."""

import math
from dataclasses import dataclass

REACH = 10.0
"""Distance (m) from a junction's center to its streets; left turns have a radius of 11.75 m, right turns of 8.25 m."""
WIDTH = 3.5
"""Width of a lane, m."""
_FIRST_JUNCTION = 1001  # CARLA's client requires that no road has the number of a junction


@dataclass(frozen=True)
class Street:
    """A straight street from junction `a` to junction `b`, both (column, row); None for a dead end."""

    number: int
    x: float
    y: float
    heading: float
    length: float
    a: tuple[int, int] | None
    b: tuple[int, int] | None

    @property
    def end(self) -> tuple[float, float]:
        return self.x + self.length * math.cos(self.heading), self.y + self.length * math.sin(self.heading)


def write_town(
    columns: tuple[float, ...] = (0.0, 130.0, 260.0),
    rows: tuple[float, ...] = (0.0, 120.0),
    tail: float = 1100.0,
    origin: tuple[float, float] = (49.0, 8.0),
) -> str:
    """Return the OpenDRIVE text of a grid; streets of 150 m lead out of the grid, those to the west have `tail` m."""
    streets = _streets(columns, rows, tail)
    crossings = [(i, j) for i in range(len(columns)) for j in range(len(rows))]
    roads = [_street(s, {c: k for k, c in enumerate(crossings, _FIRST_JUNCTION)}) for s in streets]
    junctions, number = [], len(streets) + 1
    for k, crossing in enumerate(crossings, _FIRST_JUNCTION):
        joined, links = _crossing(crossing, k, streets, number)
        number += len(joined)
        roads += joined
        junctions.append(f'<junction id="{k}" name="">{"".join(links)}</junction>')
    place = f"<![CDATA[+proj=tmerc +lat_0={origin[0]!r} +lon_0={origin[1]!r}]]>"
    header = f'<header revMajor="1" revMinor="4"><geoReference>{place}</geoReference></header>'
    return f'<?xml version="1.0"?><OpenDRIVE>{header}{"".join(roads)}{"".join(junctions)}</OpenDRIVE>'


def _streets(columns: tuple[float, ...], rows: tuple[float, ...], tail: float) -> list[Street]:
    streets: list[Street] = []

    def add(x: float, y: float, heading: float, length: float, a, b) -> None:
        streets.append(Street(len(streets) + 1, x, y, heading, length, a, b))

    for j, y in enumerate(rows):
        add(columns[0] - REACH - tail, y, 0.0, tail, None, (0, j))
        for i in range(len(columns) - 1):
            add(columns[i] + REACH, y, 0.0, columns[i + 1] - columns[i] - 2 * REACH, (i, j), (i + 1, j))
        add(columns[-1] + REACH, y, 0.0, 150.0, (len(columns) - 1, j), None)
    for i, x in enumerate(columns):
        add(x, rows[0] - REACH - 150.0, math.pi / 2, 150.0, None, (i, 0))
        for j in range(len(rows) - 1):
            add(x, rows[j] + REACH, math.pi / 2, rows[j + 1] - rows[j] - 2 * REACH, (i, j), (i, j + 1))
        add(x, rows[-1] + REACH, math.pi / 2, 150.0, (i, len(rows) - 1), None)
    return streets


def _lane(number: int, link: str = "") -> str:
    width = f'<width sOffset="0" a="{WIDTH}" b="0" c="0" d="0"/>'
    return f'<lane id="{number}" type="driving" level="false"><link>{link}</link>{width}</lane>'


def _road(number: int, junction: int, links: str, x, y, heading, length, shape: str, lanes: str) -> str:
    geometry = f'<geometry s="0" x="{x!r}" y="{y!r}" hdg="{heading!r}" length="{length!r}">{shape}</geometry>'
    center = '<center><lane id="0" type="none" level="false"/></center>'
    left, right = lanes.split("|")
    section = f'<laneSection s="0"><left>{left}</left>{center}<right>{right}</right></laneSection>'
    return (
        f'<road name="" length="{length!r}" id="{number}" junction="{junction}"><link>{links}</link>'
        f"<planView>{geometry}</planView><elevationProfile/><lateralProfile/><lanes>{section}</lanes></road>"
    )


def _street(s: Street, numbers: dict[tuple[int, int], int]) -> str:
    links = ""
    if s.a is not None:
        links += f'<predecessor elementType="junction" elementId="{numbers[s.a]}"/>'
    if s.b is not None:
        links += f'<successor elementType="junction" elementId="{numbers[s.b]}"/>'
    return _road(s.number, -1, links, s.x, s.y, s.heading, s.length, "<line/>", f"{_lane(1)}|{_lane(-1)}")


def _crossing(crossing, junction: int, streets: list[Street], number: int) -> tuple[list[str], list[str]]:
    """Return the roads within a junction, one for each way through it, and the junction's connections."""
    arms = [(s, "end") for s in streets if s.b == crossing] + [
        (s, "start") for s in streets if s.a == crossing
    ]
    roads, links = [], []
    for come, at in arms:
        x, y = come.end if at == "end" else (come.x, come.y)
        heading = come.heading if at == "end" else come.heading + math.pi
        for go, to in arms:
            if go is come:
                continue
            away = go.heading if to == "start" else go.heading + math.pi
            turn = (away - heading + math.pi) % (2 * math.pi) - math.pi
            length, shape = 2 * REACH, "<line/>"
            if abs(turn) > 0.1:
                length, shape = REACH * math.pi / 2, f'<arc curvature="{math.copysign(1 / REACH, turn)!r}"/>'
            lane_in, lane_out = (-1 if at == "end" else 1), (-1 if to == "start" else 1)
            road_links = (
                f'<predecessor elementType="road" elementId="{come.number}" contactPoint="{at}"/>'
                f'<successor elementType="road" elementId="{go.number}" contactPoint="{to}"/>'
            )
            lane = _lane(-1, f'<predecessor id="{lane_in}"/><successor id="{lane_out}"/>')
            roads.append(_road(number, junction, road_links, x, y, heading, length, shape, f"|{lane}"))
            links.append(
                f'<connection id="{len(links)}" incomingRoad="{come.number}" connectingRoad="{number}" '
                f'contactPoint="start"><laneLink from="{lane_in}" to="-1"/></connection>'
            )
            number += 1
    return roads, links
