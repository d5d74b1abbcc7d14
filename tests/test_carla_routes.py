"""Routes of the recorder on a real `carla.Map`, checked with the geometry of the town."""

import json
import math
import subprocess
from pathlib import Path

import numpy as np
import pytest

from standin.geodesy import from_geolocation, to_geolocation
from standin.process import python_with, recorder
from standin.town import REACH, WIDTH, write_town

COLUMNS, ROWS, TAIL = (0.0, 130.0, 260.0), (0.0, 120.0), 1100.0
VERSIONS = ("0.9.14", "0.9.15", "0.9.16")

# Executed in a separate process, since the client may abort at exit. No server is needed.
ASK = """
import json, os, random, sys
sys.path.insert(0, sys.argv[1])
import carla
from sigmaswarm_carla import geometry, options, plans
request = json.load(sys.stdin)
town = carla.Map("town", request["town"])
answers = []
for name, friction, seed in request["plans"]:
    try:
        plan = plans.plan_maneuver(name, friction, town, random.Random(seed))
        path = plan.path
        answers.append({"x": path.x, "y": path.y, "heading": path.heading, "length": plan.length,
                        "start": plan.start, "turns": path.turns, "outages": plan.outages})
    except options.RecorderError as error:
        answers.append(str(error))
geodesy = geometry.Geodesy.probe(carla, town)
places = [geodesy.place(lat, lon) for lat, lon in request["fixes"]]
print("ANSWER" + json.dumps([answers, places]), flush=True)
os._exit(0)
"""


def ask(version: str, town: str, plans: list, fixes: list | None = None) -> tuple[list, list]:
    """Return plans and places from the real client."""
    done = subprocess.run(
        [python_with(version), "-c", ASK, str(recorder())],
        input=json.dumps({"town": town, "plans": plans, "fixes": fixes or []}),
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    answers = [line for line in done.stdout.splitlines() if line.startswith("ANSWER")]
    assert answers, done.stderr
    found, places = json.loads(answers[0].removeprefix("ANSWER"))
    return found, places


def off_lane(x: float, y: float) -> float:
    """Return the distance from the middle of the nearest lane, m; 0 within a crossing."""
    column = min(COLUMNS, key=lambda c: abs(x - c))
    row = min(ROWS, key=lambda r: abs(y - r))
    if abs(x - column) < REACH + 0.5 and abs(y - row) < REACH + 0.5:
        return 0.0
    return min(abs(abs(x - column) - WIDTH / 2), abs(abs(y - row) - WIDTH / 2))


def check_drivable(plan: dict) -> None:
    """Check that the path follows lanes on the right-hand side without jumps, and is long enough for its legs."""
    x, y, heading = (np.array(plan[key]) for key in ("x", "y", "heading"))
    steps = np.hypot(np.diff(x), np.diff(y))
    assert np.all((steps > 0.4) & (steps < 0.51))
    course = np.arctan2(np.diff(y), np.diff(x))
    assert np.abs(np.angle(np.exp(1j * (course - heading[:-1])))).max() < math.radians(8)
    assert max(off_lane(*place) for place in zip(x, y, strict=True)) < 0.01
    assert plan["length"] + 25.0 < 0.5 * (len(x) - 1)
    assert 0 < plan["start"] < plan["length"]
    for i in range(0, len(x), 50):  # right of the middle of the street
        column, row = min(COLUMNS, key=lambda c: abs(x[i] - c)), min(ROWS, key=lambda r: abs(y[i] - r))
        if abs(math.sin(heading[i])) < 0.01 and abs(x[i] - column) > REACH + 0.5:
            assert (y[i] - row) * math.cos(heading[i]) < 0
        elif abs(math.cos(heading[i])) < 0.01 and abs(y[i] - row) > REACH + 0.5:
            assert (x[i] - column) * math.sin(heading[i]) > 0


@pytest.mark.parametrize("version", VERSIONS)
def test_every_maneuver_finds_its_way(version: str):
    names = ("cruise", "turns", "accelerate", "brake", "outages")
    asked = [(name, *at) for name in names for at in ((0.85, 0), (0.85, 1), (0.25, 2))]
    plans, _ = ask(version, write_town(COLUMNS, ROWS, TAIL), asked)
    begins = set()
    for (name, _, _), plan in zip(asked, plans, strict=True):
        assert isinstance(plan, dict), plan
        check_drivable(plan)
        begins.add((name, round(plan["x"][0]), round(plan["y"][0])))
        heading = np.array(plan["heading"])
        if name in ("turns", "outages"):
            (start, end, first), (_, _, second) = plan["turns"][:2]
            assert abs(math.degrees(first)) == pytest.approx(90, abs=2)
            assert second == pytest.approx(-first, abs=0.05)
            # The turn is at the crossing: the town's arcs have radii of 11.75 m (left) and 8.25 m (right).
            radius = REACH + math.copysign(WIDTH / 2, first)
            assert end - start == pytest.approx(radius * math.pi / 2, abs=3.0)
            assert start > 55.0
        else:
            assert np.ptp(heading) < math.radians(3)
    assert len(begins) > len(names) * 2  # routes differ
    assert all(3.0 <= long <= 4.8 for plan in plans for _, long in plan["outages"])


@pytest.mark.long
@pytest.mark.parametrize("version", VERSIONS)
def test_a_map_without_a_long_straight_says_how_long_its_longest_is(version: str):
    small = write_town(COLUMNS, ROWS, tail=150.0)
    (said, turns), _ = ask(version, small, [("cruise", 0.85, 0), ("turns", 0.85, 0)])
    assert isinstance(turns, dict)
    # Straight through three crossings: 150 + 20 + 110 + 20 + 110 + 20 + 150 m.
    longest = int(said.split("the longest straight stretch is ")[1].split(" m")[0])
    assert 565 <= longest <= 582
    assert "the map town has no straight stretch of" in said
    assert "--map Town06" in said


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("origin", [(0.0, 0.0), (49.0, 8.0), (-33.0, 151.0)])
def test_fixes_come_back_to_meters_through_any_geodesy(version: str, origin: tuple[float, float]):
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-3000, 3000, (2, 20))
    formula = "0.9.16" if version == "0.9.16" else "0.9.14"
    lat, lon = to_geolocation(x, y, *origin, formula)
    _, places = ask(version, write_town(origin=origin), [], np.column_stack([lat, lon]).tolist())
    np.testing.assert_allclose(places, np.column_stack([x, -y]), atol=1e-4)
    np.testing.assert_allclose(from_geolocation(lat, lon, *origin, formula), [x, y], atol=1e-6)


def test_the_recorder_needs_only_the_standard_library_and_the_syntax_of_38():
    import ast
    import sys

    from sigmaswarm_carla import pack

    imported = set[str]()
    for file in Path(pack.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(), feature_version=(3, 8))):
            if isinstance(node, ast.Import):
                imported |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                imported.add(str(node.module).split(".")[0])
    assert "argparse" in imported and imported <= set(sys.stdlib_module_names)


def test_figures_are_the_simulators():
    from sigmaswarm.simulation import ENVIRONMENTS, PAPER_MANEUVERS
    from sigmaswarm.simulation.dynamics import GRAVITY
    from sigmaswarm.simulation.gps import METERS_PER_DEGREE
    from sigmaswarm_carla import geometry, options

    assert options.MANEUVERS == PAPER_MANEUVERS
    mine = {name: (e.friction, e.physics) for name, e in options.ENVIRONMENTS.items()}
    assert mine == {name: (e.friction, e.physics) for name, e in ENVIRONMENTS.items()}
    assert (options.GRAVITY, geometry.METERS_PER_DEGREE) == (GRAVITY, METERS_PER_DEGREE)
