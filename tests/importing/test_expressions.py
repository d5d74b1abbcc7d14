import math
import operator

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sigmaswarm.errors import InputError
from sigmaswarm.importing.expressions import compile_expression, integer_scale

FRAME = pl.DataFrame(
    {
        "acc_y": [1.0, -2.0],
        "a b (m/s^2)": ["3", "nan"],
        "v.x": [1, 4],
        "q[0]": [2, 3],
        "kind": ["GPS", "NET"],
        "date": ["2024-02-29T12:00:00.25Z", "2024-02-29 14:00:00.250+02:00"],
        "flag": [1, 0],
        "on": [True, False],
        "gap": [1.0, math.nan],
        "hole": [None, 2.0],
    }
)


def value(text: str) -> list[object]:
    return FRAME.select(compile_expression(text, FRAME.columns).polars.alias("out"))["out"].to_list()


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("-acc_y*9.80665", [-9.80665, 19.6133]),
        ("acc_y/g", [1 / 9.80665, -2 / 9.80665]),
        ("radians(180*v.x)", [math.pi, 4 * math.pi]),
        ("sqrt(v.x) + q[0]**2", [5.0, 11.0]),
        ("atan2(acc_y, v.x)", [math.atan2(1, 1), math.atan2(-2, 4)]),
        ("hypot(3, 4)", [5.0]),
        ("where(acc_y > 0, 1, -1)", [1.0, -1.0]),
        ("0 < acc_y < 2", [True, False]),
        ("kind == 'GPS'", [True, False]),
        ("not (kind == 'GPS') or acc_y == 1", [True, True]),
        ("utc(date)", [1709208000.25, 1709208000.25]),
        ("max(acc_y, 0) - min(acc_y, 0)", [1.0, 2.0]),
        ("-7 % 3", [2.0]),
        ("not flag", [False, True]),
        ("not on", [False, True]),
        ("not acc_y", [False, False]),
        ("flag and v.x", [True, False]),
        ("flag or on", [True, False]),
        ("on and acc_y > 0", [True, False]),
        ("where(flag, 1, 2)", [1.0, 2.0]),
        ("where(on, acc_y, v.x)", [1.0, 4.0]),
        ("where(not flag, 1, 2)", [2.0, 1.0]),
        ("-(acc_y > 0)", [-1.0, 0.0]),
        ("+on", [1.0, 0.0]),
        ("(acc_y > 0) + 1", [2.0, 1.0]),
        ("2*on - 1", [1.0, -1.0]),
        ("abs(acc_y > 0)", [1.0, 0.0]),
        ("sqrt(on)", [1.0, 0.0]),
        ("hypot(acc_y > 0, on)", [math.sqrt(2), 0.0]),
        ("max(on, 0.5)", [1.0, 0.5]),
        ("flag == True", [True, False]),
        ("on == flag", [True, True]),
        ("on < 1", [False, True]),
        ("1 and 2", [True]),
        ("not 0", [True]),
        ("where(True, acc_y, 0)", [1.0, -2.0]),
    ],
)
def test_means_what_it_says(text: str, wanted: list[object]):
    assert value(text) == pytest.approx(wanted)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("48°12'00\"", 48.2),
        ("48.2 s", -48.2),
        ("w 11.6", -11.6),
        ("48d12m36sS", -48.21),
        ("48d12m36s", 48.21),
        ("48°12'36s", None),
        ("11.6 O", None),
        ("S 11.6 E", None),
        ("4812.0 N", 48.2),
        ("00012.0 W", -0.2),
        ("0012.0°", None),
        ("012.0 N", None),
        ("116.5 E", 116.5),
        ("48 75 N", None),
    ],
)
def test_degrees_and_minutes_in_a_text(text: str, wanted: float | None):
    """Null where a text may be two places: other letters, three digits of a latitude, s as seconds or south."""
    frame = pl.DataFrame({"place": [text]})
    got = frame.select(compile_expression("dms(place)", frame.columns).polars.alias("out"))["out"][0]
    assert got == (None if wanted is None else pytest.approx(wanted))


def test_text_is_a_number_or_nothing():
    first, second = value("`a b (m/s^2)` * 2")
    assert first == 6.0
    assert second is None or math.isnan(second)


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')",
        "().__class__.__bases__",
        "open('x')",
        "(lambda: 1)()",
        "[i for i in (1, 2)]",
        "acc_y if acc_y else 1",
        "acc_y := 1",
        "acc_y.__class__",
        "f'{acc_y}'",
        "'text'",
        "acc_y @ acc_y",
        "sin(x=1)",
        "sin(acc_y, x=1)",
        "sin(1, 2)",
        "utc(1 + 2)",
        "acc_y +",
        "",
        "`open",
        "1" * 2000,
        "-" * 990 + "1",
        "nothing",
    ],
)
def test_refuses_all_else_in_one_line(text: str):
    with pytest.raises(InputError) as caught:
        compile_expression(text, FRAME.columns)
    assert "\n" not in str(caught.value)


def test_suggests_the_column_that_was_meant():
    with pytest.raises(InputError, match="perhaps `acc_y`"):
        compile_expression("-accy", FRAME.columns)


def test_a_name_in_another_case_is_suggested_first():
    with pytest.raises(InputError, match=r"perhaps `Linear\.y`"):
        compile_expression("-Linear.Y", ["Linear.x", "Linear.z", "Linear.y", "Angular.Y"])


numbers = st.floats(-1e3, 1e3).map(lambda v: f"({v!r})")
trees = st.recursive(
    numbers | st.just("acc_y"),
    lambda inner: st.tuples(inner, st.sampled_from("+-*"), inner).map(lambda t: f"({t[0]}{t[1]}{t[2]})"),
    max_leaves=8,
)


@given(trees)
def test_arithmetic_is_pythons(text: str):
    wanted = [eval(text, {"__builtins__": {}}, {"acc_y": v}) for v in (1.0, -2.0)]
    got = value(f"{text} + 0*acc_y")
    assert got == pytest.approx(wanted, rel=1e-12, abs=1e-6)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("stamp", ("stamp", 1.0)),
        ("stamp*1e-9", ("stamp", 1e-9)),
        ("stamp/1000", ("stamp", 0.001)),
        ("stamp+1", None),
        ("other*2", None),
        ("stamp*0", None),
    ],
)
def test_knows_a_scaled_column(text: str, wanted: tuple[str, float] | None):
    assert integer_scale(text, ["stamp"]) == wanted


def test_every_operator_is_tested_against_pythons():
    for symbol in ("<", "<=", ">", ">=", "==", "!="):
        python = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}
        python |= {"==": operator.eq, "!=": operator.ne}
        assert value(f"acc_y {symbol} 1") == [python[symbol](v, 1) for v in (1.0, -2.0)]


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("gap >= 0", [True, None]),
        ("gap == gap", [True, None]),
        ("not hole", [None, False]),
        ("where(hole, 1, 2)", [None, 1.0]),
        ("where(gap, 1, 2)", [1.0, None]),
        ("max(hole, 1)", [None, 2.0]),
        ("min(gap, 5)", [1.0, None]),
        ("hole + 1", [None, 3.0]),
    ],
)
def test_what_comes_of_an_empty_cell_is_empty(text: str, wanted: list[object]):
    """NaN is greater than all in polars, and a mean or a minimum passes empty cells over: none of it here."""
    assert value(text) == wanted


@pytest.mark.parametrize(
    "text", ["1" + "0" * 400, "acc_y*" + "9" * 400, "0x" + "f" * 900, "acc_y < 1" + "0" * 400]
)
def test_a_number_beyond_floats_is_told(text: str):
    with pytest.raises(InputError, match=r"a number above 1\.8e308") as caught:
        compile_expression(text, FRAME.columns)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    "text", ["stamp*1" + "0" * 400, "stamp/1" + "0" * 400, "stamp*1e999", "stamp/1e-400"]
)
def test_a_scale_beyond_floats_is_no_scale(text: str):
    assert integer_scale(text, ["stamp"]) is None


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("not " * 240 + "flag", [True, False]),
        ("(" * 45 + "flag" + " and on)" * 45, [True, False]),
        ("where(flag, 1, " * 9 + "0" + ")" * 9, [True, False]),
        ("max(" * 6 + "flag" + ", 0)" * 6, [True, False]),
        ("abs(" * 90 + "flag" + ")" * 90, [True, False]),
    ],
)
def test_a_deep_expression_takes_a_moment(text: str, wanted: list[bool]):
    """Each of them took twice as long as the one a level below it."""
    assert FRAME.select(compile_expression(text, FRAME.columns).truth.alias("out"))["out"].to_list() == wanted


@pytest.mark.parametrize("name", ["min", "max", "hypot"])
def test_an_expression_that_would_take_years_is_refused(name: str):
    with pytest.raises(InputError, match="nested too deeply; simplify it"):
        compile_expression(f"{name}(" * 60 + "flag" + ", 0)" * 60, FRAME.columns)


booleans = st.recursive(
    st.sampled_from(["flag", "on", "acc_y", "v.x", "0", "1", "acc_y > 0"]),
    lambda inner: st.one_of(
        inner.map(lambda a: f"(not {a})"),
        st.tuples(inner, st.sampled_from(["and", "or"]), inner).map(lambda t: f"({' '.join(t)})"),
    ),
    max_leaves=8,
)


@given(booleans)
def test_logic_is_pythons(text: str):
    rows = [{"flag": 1, "on": True, "acc_y": 1.0, "vx": 1}, {"flag": 0, "on": False, "acc_y": -2.0, "vx": 4}]
    wanted = [bool(eval(text.replace("v.x", "vx"), {"__builtins__": {}}, row)) for row in rows]
    got = FRAME.select(compile_expression(f"{text} and 1 + 0*acc_y", FRAME.columns).truth.alias("out"))["out"]
    assert got.to_list() == wanted
