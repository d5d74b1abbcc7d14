"""`sigmaswarm doctor`: output and exit code; the copy is repaired, and the original is unchanged."""

import json
import re
import shlex
import shutil
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sigmaswarm as library
from doctor.faults import FAULTS, flipped_yaw
from sigmaswarm.cli.common import read_datasets
from sigmaswarm.cli.findings import print_diagnosis
from sigmaswarm.cli.output import Output
from sigmaswarm.doctor.findings import Diagnosis, Finding, split_command
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.writer import write_drive
from sigmaswarm.errors import SigmaswarmWarning

pytestmark = pytest.mark.usefixtures("doctored")


@pytest.fixture(scope="module")
def with_truth():
    return library.simulate("urban", duration=40.0, imu_rate=50.0, gps="white-1m")


@pytest.fixture(scope="module")
def good(with_truth):
    """Return a drive without truth, whose diagnosis takes half the time."""
    return replace(with_truth, truth=None)


@pytest.fixture
def sick(good, here: Path) -> Path:
    return write_drive(flipped_yaw(good), here / "sick")


def test_a_good_drive_ends_with_0(sigmaswarm, good, here: Path):
    write_drive(good, here / "fine")
    ended = sigmaswarm("doctor", "fine")
    assert (ended.code, ended.err) == (0, "")
    assert ended.out.startswith("urban-clear-00: no serious fault")
    assert (
        "\ndetails: sigmaswarm doctor fine --verbose    (4 notes)\nnext: sigmaswarm split fine --out parts\n"
        in ended.out
    )
    verbose = sigmaswarm("doctor", "fine", "--verbose").out
    assert "  note     [imu-rate] There are 2000 IMU samples at 50 Hz over 40 s. (imu.csv, t)\n" in verbose
    assert "details: " not in verbose and verbose.endswith("\nnext: ".join(ended.out.split("\nnext: ")[1:]))
    Path("one").mkdir()
    shutil.copytree("fine", "one/fine")  # parent folder of a drive
    assert "\nnext: sigmaswarm split one/fine --out parts\n" in sigmaswarm("doctor", "one").out
    assert "\nor, with another drive for the evaluation: sigmaswarm tune fine --out tuned\n" in ended.out
    for used in ("parts", "tuned", "tuned-2"):
        Path(used).mkdir()
    said = sigmaswarm("doctor", "fine").out
    (split,) = re.findall(r"next: sigmaswarm (split fine --out parts-2)\n", said)
    said = sigmaswarm(*split.split()).out
    assert "\nnext: sigmaswarm tune parts-2/urban-clear-00-train --out tuned-3\n" in said
    assert said.endswith("then: sigmaswarm evaluate tuned-3 parts-2/urban-clear-00-test --out evaluation\n")


def test_a_serious_finding_ends_with_1(sigmaswarm, sick: Path):
    ended = sigmaswarm("doctor", sick)
    assert (ended.code, ended.err) == (1, "")
    fault, what, *consequence, remedy = ended.out.split("\ndetails: ")[0].splitlines()
    assert fault == "urban-clear-00: 1 SERIOUS fault, 0 warnings"
    assert (
        what == "  SERIOUS  [gyro-sign] The yaw rate has the wrong sign: it must be positive in a left turn."
    )
    assert consequence == ["           A filter turns left where the car turns right."]
    assert remedy == "           -> change the sign of gz (or doctor --fix)"
    assert "the integral of gz" not in ended.out
    helps = "    (writes a copy with the repairs that reduce errors)"
    assert f"\nnext: sigmaswarm doctor {sick} --fix mended{helps}\n" in ended.out
    verbose = " ".join(sigmaswarm("doctor", sick, "--verbose").out.split())
    assert (
        "times the integral of gz" in verbose
        and "(imu.csv, gz; t = 0.0 to 40.0 s; confidence 99.9%)" in verbose
    )
    mended = sigmaswarm("doctor", sick, "--fix", "mended")
    again = f"sigmaswarm doctor {sick} mended/urban-clear-00 --verbose"
    assert f"\ndetails: {again}    (the evidence and " in mended.out
    assert sigmaswarm(*again.split()[1:]).out.count("  note     ") >= 2
    assert "\nnext: sigmaswarm split mended/urban-clear-00 --out parts\n" in mended.out


def test_a_rejected_repair_is_not_proposed_again(sigmaswarm, sick: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("sigmaswarm.scoring.verified_repair._rejected", lambda *_: {"gyro-sign"})
    ended = sigmaswarm("doctor", sick, "--fix", "mended")
    assert ended.code == 0 and "since with the repairs, a filter predicts the fixes less" in ended.out
    assert "\nnext: sigmaswarm split mended/urban-clear-00 --out parts\n" in ended.out
    ended = sigmaswarm("doctor", "mended/urban-clear-00", "--verbose")
    assert ended.code == 0 and "warning  [gyro-sign]" in ended.out
    assert "-> no action is needed: the repair was tried, but with it a filter predicts" in ended.out
    assert "repair it yourself: change the sign of gz" in " ".join(ended.out.split())
    remedies: list[tuple[str, Path | None]] = []
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # no warning, since no action is needed
        read_datasets(["mended/urban-clear-00"], remedies=remedies)
    assert not remedies


def test_a_held_out_part_is_evaluated_and_never_tuned_on(sigmaswarm, good, here: Path):
    write_drive(good, here / "log")
    assert sigmaswarm("split", "log", "--out", "parts", "--train-fraction", "0.5").code == 0
    held = sigmaswarm("doctor", "parts/urban-clear-00-test").out
    assert "\nnext: sigmaswarm evaluate TUNING parts/urban-clear-00-test --out evaluation\n" in held
    assert "sigmaswarm tune" not in held and "Tune uses" not in held and "split" not in held
    other = sigmaswarm("doctor", "parts/urban-clear-00-train").out
    assert "\nnext: sigmaswarm tune parts/urban-clear-00-train --out tuned\n" in other
    assert "split" not in other
    copied = sigmaswarm("doctor", "parts/urban-clear-00-test", "--fix", "mended").out
    assert "sigmaswarm evaluate TUNING mended/urban-clear-00-test" in copied


def test_a_part_is_repaired_only_with_the_whole_drive(sigmaswarm, sick: Path):
    assert sigmaswarm("split", sick, "--out", "parts", "--train-fraction", "0.5").code == 0
    part = f"{read_drive(sick).name}-test"
    assert read_drive(f"parts/{part}").metadata["cut_from"].keys() == {"drive", "sha256", "start_s", "end_s"}
    said = sigmaswarm("doctor", f"parts/{part}").out
    assert (
        "if the whole drive urban-clear-00 has this fault, repair that drive and split it again (change"
        in " ".join(said.split())
    )
    assert "--fix tests" not in said and f"parts/{part} --fix" not in said
    refused = sigmaswarm("doctor", "parts", "--fix", "alone")
    assert (refused.code, refused.err.count("\n"), Path("alone").exists()) == (2, 1, False)
    assert refused.err.endswith(
        "; sigmaswarm doctor sick --fix mended, then sigmaswarm split mended/urban-clear-00 --out parts-2\n"
    )
    repair, split = re.findall(r"(?:next|then): sigmaswarm (.*?)(?:    \(.*)?\n", said)
    assert repair == "doctor sick --fix mended" and split.endswith("--out parts-2")
    for command in (repair, split):
        assert sigmaswarm(*shlex.split(command)).code == 0
    assert sigmaswarm("doctor", f"parts-2/{part}").code == 0
    with pytest.warns(SigmaswarmWarning, match="run sigmaswarm doctor sick --fix mended-2,"):
        read_datasets([f"parts/{part}"], remedies=[])
    sick.rename("elsewhere-with-another-name")
    (sick.parent / "elsewhere-with-another-name" / "imu.csv").unlink()
    assert "next: repair the whole drive urban-clear-00 (" in sigmaswarm("doctor", f"parts/{part}").out
    assert (
        "; repair the whole drive urban-clear-00 (" in sigmaswarm("doctor", f"parts/{part}", "--fix", "x").err
    )


def test_a_fault_of_a_part_alone_is_not_repaired(sigmaswarm, good, here: Path):
    write_drive(good, here / "log")
    assert sigmaswarm("split", "log", "--out", "parts", "--train-fraction", "0.5").code == 0
    write_drive(flipped_yaw(read_drive("parts/urban-clear-00-test")), here / "sick-test")
    refused = sigmaswarm("doctor", "sick-test", "--fix", "mended")
    assert refused.code == 2 and "log needs no repair; use this part as it is" in refused.err


def test_split_of_a_faulty_drive_proposes_its_repair(sigmaswarm, sick: Path):
    said = sigmaswarm("split", sick, "--out", "parts", "--train-fraction", "0.4").out
    *_, repair, split = said.splitlines()
    assert (
        repair == f"next: sigmaswarm doctor {sick} --fix mended    (repair the whole drive, then split again)"
    )
    assert split == "then: sigmaswarm split mended/urban-clear-00 --out parts-2 --train-fraction 0.4"
    for command in (repair.split("    ")[0], split):
        assert sigmaswarm(*shlex.split(command)[2:]).code == 0
    assert sigmaswarm("doctor", "parts-2").code == 0


def test_no_tuning_is_proposed_if_no_filter_can_start(sigmaswarm, good, here: Path):
    parked = replace(good.gps, x=0 * good.gps.x, y=0 * good.gps.y)
    write_drive(replace(good, gps=parked, truth=None), here / "parked")
    ended = sigmaswarm("doctor", "parked")
    assert "[no-start]" in ended.out and "tune" not in ended.out.splitlines()[-1]
    assert "\nnext: use a longer or a faster drive (" in ended.out
    assert "urban-clear-00: NO FILTER CAN START, " in ended.out
    imu = replace(good.imu, az=-good.imu.az)
    write_drive(replace(good, imu=imu, gps=parked, truth=None), here / "down")
    ended = sigmaswarm("doctor", "down")
    assert ": NO FILTER CAN START, " in ended.out
    assert ended.out.endswith(
        "\nnext: sigmaswarm doctor down --fix mended\n      (then a filter may be able to start)\n"
    )


def test_the_remedies_of_start_and_bias_name_neither_doctor_nor_a_chosen_model(sigmaswarm, good, here: Path):
    scattered = replace(good.gps, x=good.gps.x + 30 * np.cos(7 * np.arange(len(good.gps))))
    drive = replace(good, gps=scattered, truth=None)
    write_drive(drive, here / "scattered")
    found = json.loads(sigmaswarm("doctor", "scattered", "--json").out)["drives"][0]["findings"]
    (start,) = (one["remedy"] for one in found if one["code"] == "no-start")
    assert (
        "sigmaswarm doctor" not in start and "heading_deg = 90" in start and "--heading-from-north" in start
    )
    write_drive(replace(drive, metadata={"heading_deg": 0.0}), here / "stated")
    found = json.loads(sigmaswarm("doctor", "stated", "--json").out)["drives"][0]["findings"]
    assert "no-start" not in [one["code"] for one in found]  # the remedy works
    biased = replace(good.imu, gz=good.imu.gz + np.radians(2.0))
    write_drive(replace(good, imu=biased), here / "biased")
    found = json.loads(sigmaswarm("doctor", "biased", "--json").out)["drives"][0]["findings"]
    (bias,) = (one["remedy"] for one in found if one["code"] == "gyro-bias")
    (use,) = (one["what"] for one in found if one["code"] == "use")
    assert bias.startswith("no action is needed") and re.search(r"--model \w+", bias)[0] in use


def test_unused_fixes_are_named_by_tune_once_and_not_by_later_commands(
    sigmaswarm, good, tuned: Path, here: Path
):
    write_drive(replace(good, imu=good.imu.select(good.imu.time < 25.0), truth=None), here / "early")
    for command in ("run {} early --out e.csv", "export {} --to c99 --out c --replay early"):
        said = sigmaswarm(*command.format(tuned).split())
        assert (said.code, said.err) == (0, "")
    with pytest.warns(SigmaswarmWarning) as caught:
        read_datasets(["early"], ["early"], gaps=True)
    assert ["lie outside of the IMU" in str(warning.message) for warning in caught] == [True]


def test_tune_names_a_gap_once(sigmaswarm, good, here: Path):
    kept = (good.imu.time < 20.0) | (good.imu.time > 21.5)
    write_drive(replace(good, imu=good.imu.select(kept)), here / "log")
    with pytest.warns(SigmaswarmWarning) as caught:
        read_datasets(["log"], remedies=[], gaps=True)
    (warning,) = (str(warning.message) for warning in caught)
    assert "a gap of" in warning and warning.endswith("split the drive")
    with pytest.warns(SigmaswarmWarning, match=r"less accurate \(imu-gap\)"):
        read_datasets(["log"], remedies=[])
    remedy = sigmaswarm("doctor", "log").out.split("-> ")[1]
    assert remedy.startswith("if the car maneuvered during a gap, split the drive there; otherwise")


def test_exchanged_fixes_with_truth_are_corrected_by_the_proposed_command(sigmaswarm, with_truth, here: Path):
    mirrored = replace(with_truth.gps, x=with_truth.gps.y, y=with_truth.gps.x)
    write_drive(replace(with_truth, gps=mirrored), here / "mirrored")
    ended = sigmaswarm("doctor", "mirrored")
    assert "[mirrored-fixes]" in ended.out
    name = with_truth.name
    command = f"import mirrored --out mended/{name} --map gps.x=y gps.y=x"
    assert f"\nnext: sigmaswarm {command}\nthen: sigmaswarm split mended/{name} --out parts\n" in ended.out
    assert sigmaswarm(*command.split()).code == 0
    assert sigmaswarm("doctor", f"mended/{name}").code == 0


def test_tune_and_evaluate_print_serious_findings_in_one_line_unless_trust_log(
    sigmaswarm, sick: Path, tuned: Path
):
    quick = ("--particles", 2, "--generations", 1, "--model", "planar5")
    for command in (("evaluate", tuned, sick, "--json"), ("tune", sick, "--out", "t", *quick, "--json")):
        ended = sigmaswarm(*command)
        (line,) = [said for said in ended.err.splitlines() if "SERIOUS" in said]
        assert line.startswith(f"warning: {sick}: the doctor finds SERIOUS faults")
        assert (
            f"(gyro-sign), which distort the result; run sigmaswarm doctor {sick} --fix mended, or suppress this "
            "warning with --trust-log" in line
        )
    ended = sigmaswarm("tune", sick, "--out", "u", *quick, "--json", "--trust-log")
    assert ended.code == 0
    assert "SERIOUS" not in ended.err


def test_warnings_of_the_doctor_are_named_too(sigmaswarm, good, tuned: Path, here: Path):
    imu = good.imu
    write_drive(replace(good, imu=replace(imu, ax=1.6 * imu.ax)), here / "scaled")
    codes = {
        f.code for f in library.diagnose(read_drive(here / "scaled")).findings if f.severity == "warning"
    }
    assert codes
    ended = sigmaswarm("evaluate", tuned, "scaled", "--json")
    (line,) = [said for said in ended.err.splitlines() if "the log makes" in said]
    assert line.startswith("warning: scaled: the log makes the filter less accurate (")
    assert all(code in line for code in codes)
    assert line.endswith("; sigmaswarm doctor scaled describes the faults")
    assert "doctor" not in sigmaswarm("evaluate", tuned, "scaled", "--json", "--trust-log").err


def test_a_warning_that_needs_no_action_is_not_named_again(sigmaswarm, good, tuned: Path, here: Path):
    write_drive(good, here / "short")
    rows = (here / "short" / "imu.csv").read_text().splitlines()
    (here / "short" / "imu.csv").write_text("\n".join(rows[: 4 * len(rows) // 10]) + "\n")
    (checked,) = json.loads(sigmaswarm("doctor", "short", "--json").out)["drives"]
    codes = [f["code"] for f in checked["findings"] if f["severity"] == "warning"]
    assert codes == ["gps-outside", "unseen-yaw"]
    assert "less accurate (unseen-yaw)" in sigmaswarm("evaluate", tuned, "short", "--json").err


def test_a_repaired_copy_is_proposed_in_a_free_folder(sigmaswarm, good, sick: Path, here: Path):
    def told(folder: Path) -> str:
        with pytest.warns(SigmaswarmWarning) as warned:
            read_datasets([folder], remedies=[])
        (line,) = [str(one.message) for one in warned if "SERIOUS" in str(one.message)]
        return line

    assert f"; run sigmaswarm doctor {sick} --fix mended, or" in told(sick)
    write_drive(read_drive(sick), here / "mended" / good.name)  # not repaired
    (here / "mended-2").mkdir()  # contains a different drive
    command = re.search(r"; run (sigmaswarm doctor .* --fix mended-2), or", told(here / "mended" / good.name))
    assert command
    assert sigmaswarm(*shlex.split(command[1])[1:]).code == 0
    assert read_drive(here / "mended-2" / good.name).imu.gz.tobytes() == good.imu.gz.tobytes()
    write_drive(replace(good, imu=replace(good.imu, ax=good.imu.ax + 9.81)), here / "on its nose")
    assert (
        "(gravity-axis), which distort the result; run sigmaswarm doctor 'on its nose', or suppress"
        in told(Path("on its nose"))
    )


def test_a_remedy_can_be_pasted(here: Path, capsys: pytest.CaptureFixture[str]):
    command = split_command(-3.0, 40.0)
    about = "gps-disturbed", "warning", "multipath", "gps.csv", (3.0, 40.0), 0.99
    found = Finding(*about, f"cut this part out of the drive: {command}", command=command)
    (here / "parts").mkdir()
    (here / "parts" / "a").touch()
    print_diagnosis(Output(verbose=False), Diagnosis("monday", (found,)), Path("my drives/monday"))
    assert "sigmaswarm split 'my drives/monday' --at -3 40 --out parts-2\n" in capsys.readouterr().out


def test_json(sigmaswarm, sick: Path):
    ended = sigmaswarm("doctor", sick, "--json")
    assert ended.code == 1
    told = json.loads(ended.out)
    assert told["serious"] is True
    first = told["drives"][0]["findings"][0]
    assert (first["code"], first["severity"], first["repairable"]) == ("gyro-sign", "serious", True)
    assert 0.99 < first["confidence"] < 1
    assert first["span"] == [0.0, 39.98]


def test_the_copy_is_repaired_and_the_original_is_not(sigmaswarm, good, sick: Path, here: Path):
    before = {file.name: file.read_bytes() for file in sick.iterdir()}
    ended = sigmaswarm("doctor", sick, "--fix", "mended")
    assert ended.code == 0  # no serious finding remains
    assert "wrote mended/urban-clear-00, a repaired copy (gyro-sign)\n" in ended.out
    assert {file.name: file.read_bytes() for file in sick.iterdir()} == before
    copy = read_drive(here / "mended" / good.name)
    assert copy.imu.gz.tobytes() == good.imu.gz.tobytes()
    assert copy.gps.x.tobytes() == good.gps.x.tobytes()
    assert copy.metadata["repaired"] == ["gyro-sign"]


def test_json_of_a_copy(sigmaswarm, sick: Path):
    told = json.loads(sigmaswarm("doctor", sick, "--fix", "mended", "--json").out)
    assert told["serious"] is False
    assert told["drives"][0]["serious"] is True
    copy = told["drives"][0]["copy"]
    assert copy["mended"] == ["gyro-sign"]
    assert copy["serious"] is False


def test_warnings_of_reading_are_printed_once(sigmaswarm, good, here: Path):
    write_drive(FAULTS["deg/s"][0](good), here / "degrees")
    header, rest = (here / "degrees" / "imu.csv").read_text().split("\n", 1)
    (here / "degrees" / "imu.csv").write_text(header.replace("gx", "temperature") + "\n" + rest)
    ended = sigmaswarm("doctor", "degrees")
    assert ended.code == 1
    assert ended.err.count("warning:") == 1  # the unknown column, which is not a finding
    assert "temperature" in ended.err
    assert "gyro-unit" in ended.out


def test_microseconds_in_both_files_end_with_1(sigmaswarm, with_truth, here: Path):
    tables = {n: replace(t := getattr(with_truth, n), time=1e6 * t.time) for n in ("imu", "gps", "truth")}
    write_drive(replace(with_truth, **tables), here / "us")
    ended = sigmaswarm("doctor", "us")
    assert (ended.code, ended.err) == (1, "")
    assert "as if t were in us in both files" in " ".join(ended.out.split())


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["nowhere"], "nowhere does not exist"),
        ([], "DRIVE"),
        (["sick", "--fix"], "--fix"),
        (["sick", "sick", "--fix", "mended"], "2 drives are named 'urban-clear-00'"),
        (["sick", "--fix", "taken"], "urban-clear-00 exists and is not empty; add --overwrite"),
        (["sick", "--fix", "foreign", "--overwrite"], "which is not part of a drive"),
        (["sick", "--fix", "file"], "file"),
        (["sick", "--mend", "x"], "--mend"),
    ],
)
def test_mistakes(sigmaswarm, sick: Path, here: Path, arguments: list[str], expected: str):
    for folder, file in (("taken", "imu.csv"), ("foreign", "notes.txt")):
        (here / folder / "urban-clear-00").mkdir(parents=True)
        (here / folder / "urban-clear-00" / file).write_text("")
    (here / "file").write_text("")
    ended = sigmaswarm("doctor", *arguments)
    assert ended.code == 2
    assert expected in ended.err
    assert (ended.err.count("\n"), "Traceback" in ended.err) == (1, False)
    assert not (here / "mended").exists()


def test_the_lever_arm_is_one_line_and_goes_into_the_copy(sigmaswarm, good, here: Path):
    place = write_drive(good, here / "fine")
    ended = sigmaswarm("doctor", place, "--lever-arm-within", 3.0, "--fix", "mended")
    assert (ended.code, ended.err) == (0, "")
    (line,) = [said for said in ended.out.splitlines() if said.startswith("lever arm: ")]
    copy = read_drive(here / "mended" / good.name)
    forward, left = (f"{abs(v):.2f}" for v in copy.lever_arm)
    assert line.startswith(f"lever arm: antenna {forward} m ")
    assert f") and {left} m " in line
    assert copy.metadata["repaired"] == ["lever-arm"]
    assert "a repaired copy (lever-arm)\n" in ended.out


@pytest.mark.long
def test_a_lever_arm_that_the_turns_do_not_show_is_not_written(sigmaswarm, good, here: Path):
    place = write_drive(good, here / "fine")
    ended = sigmaswarm("doctor", place, "--lever-arm-within", 0.01, "--fix", "mended", "--json")
    found = json.loads(ended.out)
    assert found["lever_arm"]["observable"] == [False, False]
    assert found["drives"][0]["copy"]["mended"] == []
    assert "gps_lever_arm_m" not in read_drive(here / "mended" / good.name).metadata


def test_copies_replace_earlier_ones_only_on_request_and_never_the_drive(
    sigmaswarm, sick: Path, here: Path, monkeypatch: pytest.MonkeyPatch
):
    commands = (
        ("doctor", sick, "--fix", "copies"),
        ("split", sick, "--out", "copies"),
        ("convert", sick, "--to", "csv", "copies"),
    )
    for command in commands:
        assert sigmaswarm(*command, "--overwrite").code in (0, 1)
        before = {file: file.read_bytes() for file in sorted((here / "copies").rglob("*.*"))}
        with monkeypatch.context() as patched:
            patched.setattr(library, "diagnose", None)  # the folder is checked before the work
            ended = sigmaswarm(*command)
        assert (
            ended.code == 2
            and "exists and is not empty; add --overwrite, or specify another folder, for example copies-2\n"
            in ended.err
        )
        assert {file: file.read_bytes() for file in sorted((here / "copies").rglob("*.*"))} == before
        assert sigmaswarm(*command, "--overwrite").code in (0, 1)
    drive = here / "own" / "urban-clear-00"
    assert sigmaswarm("convert", sick, "--to", "csv", drive.parent).code == 0
    for command in (("doctor", drive, "--fix", drive.parent), ("convert", drive, drive.parent)):
        ended = sigmaswarm(*command, "--overwrite")
        assert ended.code == 2 and "is a drive that this command reads; specify another folder" in ended.err


def test_a_fault_without_repair_leads_to_no_split(sigmaswarm, here: Path):
    drive = library.simulate("urban", duration=60.0, imu_rate=50.0, gps="white-1m")
    slow = {
        name: replace(table, time=1000 * table.time)
        for name, table in (("imu", drive.imu), ("gps", drive.gps))
    }
    sigmaswarm_drive = replace(drive, name="ms", truth=None, **slow)
    write_drive(sigmaswarm_drive, here / "ms")
    for command in (("doctor", "ms"), ("doctor", "ms", "--fix", "mended")):
        said = sigmaswarm(*command).out
        assert "next: correct the serious faults in the log, then check it again" in said
        assert "sigmaswarm split" not in said
