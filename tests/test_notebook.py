"""Output in notebooks: valid HTML, accessible to screen readers, any drive name; conversion to pandas."""

import sys
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

import sigmaswarm as ss
from sigmaswarm import notebook
from support import make_drive

NASTY = "<script>alert(\"1\")</script> & 'x'"
DRIVE = replace(make_drive(duration=15.0), name=NASTY)
SET = ss.FilterParameters(0.1, 2.0, 0.0, [1.0] * 5, [1.0] * 2)


class Page(HTMLParser):
    """A strict HTML parser: each tag must be closed in order. Keeps tags with attributes, and the texts."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)

    def named(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.fixture(scope="module")
def shown() -> dict[str, Page]:
    drives = [DRIVE, replace(make_drive(duration=15.0), name="second")]
    tuning = ss.tune(drives[:1], particles=2, generations=2)
    records = {
        "drive": DRIVE,
        "tuning": tuning,
        "evaluation": ss.evaluate(drives, SET),
        "estimate": ss.run_filter(DRIVE, SET),
    }
    return {name: Page(record._repr_html_()) for name, record in records.items()}


def test_each_is_a_table_that_a_screen_reader_can_read(shown: dict[str, Page]):
    for name, page in shown.items():
        assert page.named("table"), name
        assert len(page.named("caption")) == len(page.named("table"))
        assert {heading.get("scope") for heading in page.named("th")} == {"col", "row"}
        assert not page.named("script")


def test_names_are_shown_as_they_are(shown: dict[str, Page]):
    assert NASTY in shown["drive"].texts
    assert NASTY in shown["evaluation"].texts
    (picture,) = shown["drive"].named("svg")
    assert picture["role"] == "img"
    assert str(picture["aria-label"]).startswith(f"{NASTY} seen from above, ")
    assert not shown["estimate"].named("details")


def test_they_show_the_numbers(shown: dict[str, Page]):
    raw = ss.evaluate(DRIVE, SET).scores[NASTY]["raw_gps"].position_rmse
    assert f"{raw:.4g}" in shown["evaluation"].texts
    assert "Mean over drives" in shown["evaluation"].texts
    assert str(len(DRIVE.imu)) in shown["drive"].texts
    last = ss.run_filter(DRIVE, SET).mean[-1]
    assert [f"{value:.3g}" for value in last if f"{value:.3g}" not in shown["estimate"].texts] == []
    assert {"q_theta", "Warnings:"} <= set(shown["tuning"].texts)


def test_numbers_are_short():
    shown = [notebook.number(value) for value in (5641.7, 12.345, 1.2e-5, -1234.5, 3e8, float("nan"), None)]
    assert shown == ["5642", "12.3", "1.2e-05", "-1234", "3e+08", "-", "-"]


def test_the_track_lies_north_up_and_to_one_scale():
    page = Page(
        notebook.track("a", {"truth": ([0, 300, 300], [0, 0, 100]), "fixes": ([np.nan, 150], [0, 50])})
    )
    (line,) = page.named("polyline")
    a, b, c = (np.array(point.split(","), dtype=float) for point in str(line["points"]).split())
    np.testing.assert_allclose((b - a)[1], 0)
    assert b[0] > a[0]  # east is right
    assert c[1] < b[1]  # north is up
    np.testing.assert_allclose((b[1] - c[1]) / (b[0] - a[0]), 1 / 3, atol=1e-3)
    fix, start = page.named("circle")[-1], page.named("circle")[0]
    np.testing.assert_allclose([float(fix["cx"]), float(fix["cy"])], (a + c) / 2, atol=0.1)
    np.testing.assert_allclose([float(start["cx"]), float(start["cy"])], a, atol=0.1)
    (picture,) = page.named("svg")
    assert picture["aria-label"] == (
        "a seen from above, 300 m from west to east and 100 m from south to north: truth, fixes"
    )


def test_a_long_track_is_thinned_and_keeps_its_ends():
    x = np.linspace(0, 1000, 100_001)
    (line,) = Page(notebook.track("long", {"estimate": (x, 0 * x)})).named("polyline")
    points = str(line["points"]).split()
    assert len(points) == notebook.MAX_POINTS
    low, high = notebook.MARGIN, notebook.WIDTH - notebook.MARGIN
    assert [float(points[i].split(",")[0]) for i in (0, -1)] == [low, high]


def test_where_there_is_nothing_to_show():
    assert notebook.track("nothing", {"truth": ([np.nan], [1.0])}) == ""
    assert "nan" not in notebook.track("one fix", {"fixes": ([1.0], [2.0])})
    estimate = ss.run_filter(DRIVE, replace(SET, process_noise=(1.0, 1.0, -3.0, 1.0, 1.0)))
    page = Page(estimate._repr_html_())
    assert estimate.failure in page.texts
    assert not {"nan", "NaN"} & set(page.texts)
    without = Page(replace(DRIVE, truth=None)._repr_html_())
    assert "truth" not in " ".join(without.texts)


def test_tables_of_pandas_hold_the_same():
    pytest.importorskip("pandas")
    estimate = ss.run_filter(DRIVE, SET)
    table = estimate.to_pandas()
    assert list(table) == [
        *("t", "x", "y", "vx", "vy", "theta"),
        *("std_x", "std_y", "std_vx", "std_vy", "std_theta"),
    ]
    np.testing.assert_array_equal(table["theta"], estimate.mean[:, 4])
    np.testing.assert_array_equal(table["std_y"], np.sqrt(estimate.covariance[:, 1, 1]))
    fixes = DRIVE.gps.to_pandas()
    np.testing.assert_array_equal(fixes["y"], DRIVE.gps.y)
    assert "lat" not in fixes
    evaluation = ss.evaluate(DRIVE, SET)
    scores = evaluation.to_pandas()
    assert list(scores) == evaluation.to_frame().columns
    raw = scores[scores["method"] == "raw GPS"]["position_rmse_m"].item()
    assert raw == evaluation.scores[NASTY]["raw_gps"].position_rmse


def test_without_pandas_one_line_says_so(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ss.InputError, match="pip install pandas"):
        DRIVE.imu.to_pandas()
