"""What commands print with and without `--verbose`."""

import re
from dataclasses import replace
from pathlib import Path

import pytest

import sigmaswarm as library
from sigmaswarm.cli.evaluate import print_evaluation
from sigmaswarm.cli.output import Output, Remark
from sigmaswarm.doctor.findings import CONSEQUENCES
from sigmaswarm.filters.presets import baseline_of
from sigmaswarm.wording import describe_pair, to_do

MAX_LINES = 25


def test_verbose_adds_evidence_and_details_and_the_default_names_them(capsys: pytest.CaptureFixture[str]):
    remark = Remark.of("the clock is late. Fixes are wrong. Its delay is 3 s. All turns show it", "warning")

    def printed(*, verbose: bool) -> str:
        output = Output(verbose=verbose)
        output.show("result", remark)
        output.details("note", "one", "two")
        output.details("the cost", "cost 3")
        output.details("the names")
        output.next("next: tune")
        return capsys.readouterr().out

    what = "result\n  warning  The clock is late.\n           Fixes are wrong.\n"
    assert printed(verbose=False) == (
        f"{what}--verbose adds the evidence, 2 notes and the cost\nnext: tune\n"
    )
    assert printed(verbose=True) == (
        f"{what}           Its delay is 3 s. All turns show it.\none\ntwo\ncost 3\nnext: tune\n"
    )
    output = Output(verbose=False)
    output.show("result", remark)
    output.details("note", "one")
    details = output.text
    output.next("next: tune", place="details.txt")
    named = "details: details.txt    (the evidence and 1 note)"
    assert capsys.readouterr().out == f"{what}{named}\nnext: tune\n"
    assert details == f"{what}           Its delay is 3 s. All turns show it.\none\n"
    silent = Output(verbose=True, silent=True)
    silent.show("result")
    silent.details("note", remark)
    silent.next("next: tune")
    assert capsys.readouterr().out == ""


def test_a_remedy_is_one_line_that_can_be_copied(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("COLUMNS", "40")
    command = f"sigmaswarm tune {'drives/monday ' * 9}--out tuned"
    why = "the accuracy of the fixes of this receiver is unknown. So the result may be wrong. It is"
    Output(verbose=False).show(Remark.of(to_do(command, why)))
    *lines, remedy = capsys.readouterr().out.splitlines()
    assert remedy == f"{'':11}-> {command}"
    assert max(map(len, lines)) <= 40 and lines[0].startswith("  to do    The accuracy")
    assert " ".join(" ".join(lines).split()).endswith(". So the result may be wrong.")


def test_each_fault_of_the_doctor_has_a_consequence():
    page = (Path(__file__).parents[2] / "docs" / "doctor.md").read_text()
    rows = re.findall(r"^\| (`[^|]+) \| [^|]+ \| (serious|warning) \|", page, re.MULTILINE)
    codes = {code for row, _ in rows for code in re.findall(r"`([a-z-]+)`", row)}
    notes = {"unseen-ax", "unseen-ay", "unseen-tilt", "unseen-clock", "gps-rate", "gps-gap"}
    assert len(codes) > 40
    assert codes - notes == {*CONSEQUENCES}


def test_remarks_of_a_tuning_are_printed_by_evaluate_as_by_tune(capsys: pytest.CaptureFixture[str]):
    drive = library.simulate("urban", duration=40.0, imu_rate=50.0, gps="white-1m")
    evaluation = library.evaluate([replace(drive, name="my-drive")], baseline_of(drive, "planar8", []))
    remarks = to_do("tune on more drives", "errors differ"), "on my-drive, R is a compromise. It is 2 m"
    print_evaluation(Output(verbose=False), evaluation, remarks, ["the filter drifts MORE"])
    assert "\nThe filter drifts MORE.\n" in capsys.readouterr().out
    print_evaluation(Output(verbose=True), evaluation, remarks)
    said = capsys.readouterr().out
    assert "\n  to do    Errors differ.\n           -> tune on more drives\n" in said
    assert "\nOn my-drive, R is a compromise. It is 2 m.\n" in said
    assert Remark.of("my-drive: no truth. So there is no error").what == "my-drive: no truth."
    title, *table = said.splitlines()
    assert title.endswith(" (lower is better): my-drive")
    assert not any(line.startswith("my-drive") for line in table[:8])


@pytest.mark.parametrize("truth", [True, False])
def test_evaluate_prints_table_three_sentences_and_the_next_command(
    sigmaswarm, tuned: Path, here: Path, truth: bool
):
    drive = library.simulate("urban", duration=60.0, imu_rate=50.0, gps="white-1m")
    library.write_drive(drive if truth else replace(drive, truth=None), here / "drive")
    ended = sigmaswarm("evaluate", tuned, "drive", "--out", "e")
    assert ended.code == 0
    lines = ended.out.splitlines()
    assert len(lines) <= MAX_LINES
    empty = lines.index("")
    (written,) = (i for i, line in enumerate(lines) if line.startswith("wrote "))
    assert written - empty - 1 == 3, ended.out
    assert lines[written + 1].startswith("details: e/details.txt    (the ")
    assert lines[written + 2].startswith("next: sigmaswarm report e")
    verbose = sigmaswarm("evaluate", tuned, "drive", "--out", "e2", "--verbose").out
    for line in lines[:written]:
        assert line.strip() in verbose
    assert "whiteness" in verbose and "whiteness" not in ended.out
    for folder in ("e", "e2"):
        details = Path(folder, "details.txt").read_text()
        assert details == verbose[: verbose.index("\nwrote ") + 1]


@pytest.mark.parametrize(
    ("value", "other", "text"),
    [
        (0.5, 0.25, "0.5 instead of 0.25 m"),
        (0.38341, 0.38339, "0.38341 instead of 0.38339 m"),
        (0.3834, 0.3831, "0.3834 instead of 0.3831 m"),
        (0.383, 0.383, "both 0.383 m"),
    ],
)
def test_two_numbers_are_written_so_that_they_differ(value: float, other: float, text: str):
    assert describe_pair(value, other, "m") == text
