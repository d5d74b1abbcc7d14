"""Tracks and errors over time on the page, in a real browser: panels that suit the data."""

from pathlib import Path

import pytest

from browsing import Opened
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.reports.evaluation import copy_tuning
from sigmaswarm.reports.page import page as html_page
from sigmaswarm.reports.read import read_report
from sigmaswarm.scoring.evaluation import evaluate
from support import make_drive, quickly

KNOWN = make_drive(duration=30.0, seed=3, name="known")
BLIND = make_drive(duration=30.0, seed=4, name="blind", truth=False)
GOOD = FilterParameters(0.3, 2.0, 0.0, (1e-3, 1e-3, 1e-2, 1e-2, 1e-5), (1.0, 1.0))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of an evaluation on a drive with truth and on one without."""
    root = tmp_path_factory.mktemp("tracks")
    GOOD.save(root / "by-hand.toml")
    out = root / "evaluation"
    out.mkdir()
    found = evaluate([KNOWN, BLIND], GOOD)
    found.save(out)
    copy_tuning(root / "by-hand.toml", out)
    return out


@pytest.fixture(scope="module")
def page(browser, folder: Path) -> Opened:
    (folder / "page.html").write_text(html_page(read_report(folder)))
    return Opened(browser, folder / "page.html", 1280)


@pytest.fixture(autouse=True)
def as_it_was_opened(page: Opened):
    page.page.select_option("#drive", label="known")
    page.page.select_option("#sigma", label="tuned UKF")
    page.page.click("#whole")
    page.settle()
    yield
    page.check_silence()


def axes(page: Opened) -> dict[str, dict]:
    """Return the axes of each panel as plotly.js has drawn them, from top to bottom."""
    found = page.run(
        "Object.fromEntries(Object.entries(document.getElementById('errors')._fullLayout)"
        ".filter(([k, v]) => /^yaxis\\d*$/.test(k) && v.visible)"
        ".map(([k, v]) => [v.title.text, { name: v._id, domain: v.domain, range: v.range, type: v.type }]))"
    )
    return dict(sorted(found.items(), key=lambda item: -item[1]["domain"][0]))


def below_the_lowest_panel(page: Opened) -> bool:
    """Return whether the title and the numbers of the time axis are below everything that is drawn."""
    return page.run(
        "(() => { const inside = (css) => [...document.querySelectorAll('#errors ' + css)]"
        ".map((e) => e.getBoundingClientRect());"
        "const floor = Math.max(...inside('.nsewdrag').map((r) => r.bottom));"
        "return [...inside('.xtitle'), ...inside('.xtick text')].every((r) => r.top > floor - 1); })()"
    )


def test_without_sigma_the_time_axis_is_below_the_lowest_remaining_panel(page: Opened):
    assert list(axes(page)) == ["position, m", "heading, deg", "NIS"]
    height = page.run("document.getElementById('errors').clientHeight")
    assert below_the_lowest_panel(page)
    page.page.select_option("#sigma", label="none")
    page.settle()
    left = axes(page)
    assert list(left) == ["position, m", "heading, deg"]
    assert below_the_lowest_panel(page)
    assert page.run("document.getElementById('errors').layout.xaxis.anchor") == left["heading, deg"]["name"]
    assert left["heading, deg"]["domain"][0] == pytest.approx(0)
    assert left["position, m"]["domain"][1] == pytest.approx(1)
    assert left["position, m"]["domain"][0] - left["heading, deg"]["domain"][1] < 0.05, "there is a gap"
    assert page.run("document.getElementById('errors').clientHeight") < height
    page.page.select_option("#sigma", label="tuned UKF")
    page.settle()
    assert list(axes(page)) == ["position, m", "heading, deg", "NIS"]
    assert below_the_lowest_panel(page)


def test_a_drive_without_truth_shows_3_sigma_and_states_that_truth_is_missing(page: Opened):
    assert not page.page.is_visible("#no-truth")
    page.page.select_option("#drive", label="blind")
    page.settle()
    assert page.page.is_visible("#no-truth")
    assert page.page.inner_text("#over-time") == "3 sigma over time"
    heading = axes(page)["heading 3 sigma, deg"]
    drawn = page.run(
        "document.getElementById('errors').data.filter((t) => t.name === '3 sigma').map((t) => t.y)"
    )
    assert heading["range"][1] == pytest.approx(1.2 * max(drawn[1]), rel=1e-6)
    low, high = (10**v for v in axes(page)["position 3 sigma, m"]["range"])
    assert low < min(drawn[0]) < max(drawn[0]) < high < 2 * max(drawn[0])
    page.page.select_option("#sigma", label="none")
    page.settle()
    assert page.run("document.getElementById('errors').data.length") == 0
    assert "choose a filter" in page.page.inner_text("#errors")


@pytest.mark.long
def test_the_dashes_in_the_legend_are_those_of_the_line(page: Opened):
    for method, name in (
        ("untuned", "baseline"),
        ("imu_only", "IMU only"),
        ("tuned", "tuned UKF"),
    ):
        page.page.check(f"#method-{method}")
        page.settle()
        drawn = page.run(
            "(() => { const map = document.getElementById('map');"
            f"const at = map.data.findIndex((t) => t.name === '{name}');"
            "const line = map.querySelector('.scatterlayer .trace' + map.calcdata[at][0].trace.uid + ' path.js-line');"
            "return getComputedStyle(line).strokeDasharray.match(/[0-9]+/g); })()"
        )
        swatch = page.run(
            f"document.querySelector('#method-{method} + svg line').getAttribute('stroke-dasharray')"
        )
        assert swatch.split() == (drawn or []), name
    assert page.run("document.querySelectorAll('#method-raw_gps + svg circle').length") == 3


@pytest.mark.long
def test_on_a_phone_a_shadow_shows_that_a_table_is_wider(browser, folder: Path, page: Opened):
    phone = Opened(browser, folder / "page.html", 390)
    for table in phone.page.locator(".wide").all():
        attachment = table.evaluate("(t) => getComputedStyle(t).backgroundAttachment")
        assert attachment == "local, local, scroll, scroll"
    assert phone.width() <= 390
    phone.check_silence()


@pytest.mark.parametrize(
    ("field", "typed", "then"),
    quickly(
        [
            ("from", "200", ("0.00", "30.00")),  # after the drive
            ("to", "200", ("0.00", "30.00")),
            ("to", "-5", ("0.00", "30.00")),
            ("from", "-5", ("0.00", "30.00")),
            ("to", "", ("0.00", "30.00")),
            ("from", "12", ("12.00", "30.00")),
        ],
        lambda field, typed, then: typed in ("200", "12") and field == "from",
    ),
)
def test_the_fields_of_time_show_the_drawn_range(page: Opened, field: str, typed: str, then: tuple[str, str]):
    ask(page, field, typed)
    assert fields(page) == then
    assert page.page.is_visible("#limits") == (typed not in ("", "12"))
    shown = page.run("document.getElementById('errors').layout.xaxis.range") or [0, 30]
    assert shown[1] == pytest.approx(30, abs=2)  # an automatic range has margins


def test_a_range_whose_end_is_before_its_start_is_rejected(page: Opened):
    ask(page, "from", "10")
    ask(page, "to", "20")
    ask(page, "to", "5")
    assert fields(page) == ("10.00", "20.00")
    assert "from before to, within 0.00 to 30.00 s" in page.page.inner_text("#limits")
    assert page.run("document.getElementById('errors').layout.xaxis.range") == [10, 20]
    ask(page, "from", "25")  # later in the drive
    assert fields(page)[0] == "25.00"
    ask(page, "to", "28")
    assert fields(page) == ("25.00", "28.00")
    assert not page.page.is_visible("#limits")
    ask(page, "to", "")
    assert fields(page) == ("25.00", "30.00")


def ask(page: Opened, field: str, typed: str) -> None:
    page.page.fill(f"#{field}", typed)
    page.page.locator(f"#{field}").blur()
    page.settle()


def fields(page: Opened) -> tuple[str, str]:
    return page.page.input_value("#from"), page.page.input_value("#to")
