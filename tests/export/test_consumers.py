"""The exported C code in other projects: CMake, the manifest of PlatformIO, C++, Python, and an Arm compiler."""

import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from fnmatch import fnmatch
from itertools import product
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import yaml

import sigmaswarm
from exported import needs_gcc, tuned, write
from filter_cases import WEIGHED, equipped, parameters, straying
from microcontroller import COMPILER, M4F, WARNINGS, needs_arm
from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError
from sigmaswarm.exports import check
from sigmaswarm.exports.check import check_export
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.geodesy import geodetic_to_enu
from support import quickly

needs_cmake = pytest.mark.skipif(shutil.which("cmake") is None, reason="cmake is not installed")
needs_cpp = pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed")

MAIN = """
#include "ins_gps.h"
#include "ins_gps_align.h"
static InsGps filter;
int main(void)
{
    const ins_gps_real mean[5] = {1, 2, 3, 4, 5};
    ins_gps_real covariance[25] = {0};
    for (int i = 0; i < 25; i += 6) {
        covariance[i] = 1;
    }
    InsGpsState state;
    ins_gps_init(&filter, 0.0, mean, covariance, 0);
    ins_gps_predict(&filter, 0.01, 0, 0, 0);
    ins_gps_state(&filter, &state);
    return state.failed || sizeof(ins_gps_real) != SIZE || INS_GPS_FIXES != 32;
}
"""
CONSUMER = """
cmake_minimum_required(VERSION 3.13)
project(consumer LANGUAGES C)
if(ADD)
  add_subdirectory(${ADD} ins_gps)
else()
  find_package(ins_gps REQUIRED)
endif()
add_executable(app main.c)
target_link_libraries(app PRIVATE ins_gps::ins_gps)
"""
EVERY = [
    tuned("planar8", "ukf", 0.01),
    tuned("tilted12", "ekf", 0.01),
    tuned("planar5", "adaptive-ukf", 0.01),
]


def run(*command: str | Path) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, re.sub(r"(?s)^\s*$", "", done.stderr)) == (0, ""), done.stderr


@needs_gcc
@needs_cmake
@pytest.mark.parametrize("installed", quickly([(False,), (True,)], lambda installed: installed))
def test_a_cmake_project_uses_it(tmp_path: Path, installed: bool):
    export, consumer, prefix = tmp_path / "export", tmp_path / "consumer", tmp_path / "prefix"
    write(export, EVERY[0])
    options = ("-DINS_GPS_FLOAT=ON", "-DINS_GPS_FIXES=32")
    consumer.mkdir()
    (consumer / "CMakeLists.txt").write_text(CONSUMER)
    (consumer / "main.c").write_text(MAIN.replace("SIZE", "4"))
    how = f"-DCMAKE_PREFIX_PATH={prefix}" if installed else f"-DADD={export}"
    if installed:
        run("cmake", "-S", export, "-B", tmp_path / "a", *options)
        run("cmake", "--build", tmp_path / "a")
        run("cmake", "--install", tmp_path / "a", "--prefix", prefix)
        options = ()
    run("cmake", "-S", consumer, "-B", tmp_path / "b", how, *options)
    run("cmake", "--build", tmp_path / "b")
    run(tmp_path / "b" / "app")


# The rules of PlatformIO's schema (platformio/assets/schema/library.json) for the fields of the export, and the rules
# of its documentation: names contain a-z, digits and dashes, and versions follow SemVer.
_TEXT = {"type": "string", "maxLength": 255}
_TEXTS = {"anyOf": [_TEXT, {"type": "array", "items": _TEXT}]}
MANIFEST = {
    "type": "object",
    "required": ["name", "version", "description", "keywords"],
    "additionalProperties": False,
    "properties": {
        "name": {"type": "string", "maxLength": 50, "pattern": "^[a-z0-9]+(-[a-z0-9]+)*$"},
        "version": {"type": "string", "maxLength": 20, "pattern": r"^\d+\.\d+\.\d+$"},
        "description": _TEXT,
        "keywords": _TEXTS,
        "headers": _TEXTS,
        "frameworks": _TEXTS,
        "platforms": _TEXTS,
        "build": {
            "type": "object",
            "additionalProperties": False,
            "properties": {"srcDir": _TEXT, "includeDir": _TEXT, "srcFilter": _TEXTS},
        },
    },
}


@needs_gcc
def test_platformio_builds_the_files_of_the_manifest(tmp_path: Path):
    write(tmp_path, EVERY[1])
    manifest = json.loads((tmp_path / "library.json").read_text())
    jsonschema.validate(manifest, MANIFEST)
    sources = set[Path]()
    for rule in manifest["build"]["srcFilter"]:  # each rule adds or removes files
        sign, pattern = rule[0], rule[2:-1]
        chosen = {path for path in tmp_path.glob("*.c") if fnmatch(path.name, pattern)}
        sources = sources | chosen if sign == "+" else sources - chosen
    (tmp_path / "project").mkdir()
    main = tmp_path / "project" / "main.c"
    headers = "".join(f'#include "{name}"\n' for name in manifest["headers"])
    main.write_text(
        headers + "int main(void) { static InsGps f; InsGpsState s; ins_gps_state(&f, &s); return 0; }\n"
    )
    include = f"-I{tmp_path / manifest['build']['includeDir']}"
    run("gcc", *WARNINGS, include, main, *sorted(sources), "-lm", "-o", tmp_path / "app")
    run(tmp_path / "app")


def test_the_zephyr_module_names_existing_files(tmp_path: Path):
    """Zephyr is not run, since its source tree is too large for a test."""
    write(tmp_path, EVERY[0])
    module = yaml.safe_load((tmp_path / "zephyr" / "module.yml").read_text())
    assert set(module) == {"name", "build"}
    assert (tmp_path / module["build"]["kconfig"]).is_file()
    build = (tmp_path / module["build"]["cmake"] / "CMakeLists.txt").read_text()
    sources = re.findall(r"[./\w]+\.c\b", build)
    assert len(sources) == 2 and all((tmp_path / "zephyr" / source).is_file() for source in sources)
    options = set(re.findall(r"CONFIG_(\w+)", build))
    assert options == set(re.findall(r"config (\w+)", (tmp_path / "zephyr" / "Kconfig").read_text()))


@needs_cpp
@pytest.mark.parametrize(
    ("p", "flags"),
    quickly(
        product(EVERY, ((), ("-DINS_GPS_FLOAT",))),
        lambda p, flags: p is EVERY[0] and not flags,
    ),
)
def test_cpp_compiles_and_links_the_headers(tmp_path: Path, p: FilterParameters, flags: tuple[str, ...]):
    write(tmp_path, p)
    (tmp_path / "main.cpp").write_text(
        '#include "ins_gps.h"\n#include "ins_gps_align.h"\n'
        "int main() { static InsGps f; static InsGpsAlign a; InsGpsState s; ins_gps_state(&f, &s);\n"
        "    ins_gps_align_init(&a, nullptr); return s.failed; }\n"
    )
    strict = [flag for flag in WARNINGS if not flag.startswith("-std")]
    for name in ("ins_gps", "ins_gps_align"):
        run("gcc", *WARNINGS, *flags, "-c", tmp_path / f"{name}.c", "-o", tmp_path / f"{name}.o")
    objects = (tmp_path / "ins_gps.o", tmp_path / "ins_gps_align.o")
    run("g++", "-std=c++11", *strict, *flags, tmp_path / "main.cpp", *objects, "-o", tmp_path / "app")
    run(tmp_path / "app")


@pytest.mark.long
@needs_arm
@pytest.mark.parametrize(
    ("p", "flags"),  # test_microcontroller compiles other cases
    quickly(
        product(EVERY, ((), ("-DINS_GPS_FLOAT", "-DINS_GPS_HISTORY=0"))),
        lambda p, flags: p is EVERY[0] and not flags,
    ),
)
def test_an_arm_compiler_gives_no_warning(tmp_path: Path, p: FilterParameters, flags: tuple[str, ...]):
    write(tmp_path, p)
    for source in ("ins_gps.c", "ins_gps_align.c"):
        command = (COMPILER, *M4F.flags, *WARNINGS, "-O2", *flags, "-c", tmp_path / source)
        run(*command, "-o", tmp_path / "object.o")


@needs_gcc
@pytest.mark.parametrize(
    ("p", "mounting"),
    quickly(
        product(EVERY, (None, (1.0, 2.0, 90.0))),
        lambda p, mounting: (p.model == "planar8") == (mounting is None),
    ),
    ids=lambda v: getattr(v, "model", "turned" if v else ""),
)
def test_the_readme_contains_c_that_compiles(
    tmp_path: Path, p: FilterParameters, mounting: tuple[float, float, float] | None
):
    sigmaswarm.export(p, "c99", tmp_path, mounting=mounting)
    (code,) = re.findall(r"```c\n(.*?)```", (tmp_path / "README.md").read_text(), re.DOTALL)
    (tmp_path / "loop.c").write_text(code)
    flags = [flag for flag in WARNINGS if flag != "-pedantic"]
    run("gcc", *flags, "-c", tmp_path / "loop.c", "-o", tmp_path / "loop.o")


@needs_gcc
def test_the_readme_s_conversion_to_meters_agrees_with_the_library(tmp_path: Path):
    write(tmp_path, EVERY[0])
    (code,) = re.findall(r"```c\n(.*?)```", (tmp_path / "README.md").read_text(), re.DOTALL)
    asked = [(44.25, -76.5), (44.2, -76.3), (44.31, -76.61)]
    lines = "".join(
        f'    east_north({lat}, {lon}, 44.2312, -76.486, &x, &y); printf("%.6f %.6f\\n", x, y);\n'
        for lat, lon in asked
    )
    main = f"#include <stdio.h>\n{code}\nint main(void)\n{{\n    double x, y;\n{lines}    return 0;\n}}\n"
    (tmp_path / "loop.c").write_text(main)
    sources = [tmp_path / f"{name}.c" for name in ("loop", "ins_gps", "ins_gps_align")]
    run("gcc", "-std=c99", *sources, "-lm", "-o", tmp_path / "loop")
    told = subprocess.run([tmp_path / "loop"], capture_output=True, text=True, check=True).stdout
    found = np.array([line.split() for line in told.splitlines()], float)
    lat, lon = np.transpose(asked)
    assert np.abs(found - geodetic_to_enu(lat, lon, 0.0, (44.2312, -76.486, 0.0))[:, :2]).max() < 1e-5


CHECKED: dict[str, tuple[FilterParameters, Drive]] = {
    "every option": (tuned("planar8", "ukf", 0.01), equipped()),
    "tilted": (tuned("tilted12", "ekf", 0.01), equipped()),
    "accuracy": (
        parameters("planar5", kind="ekf", nominal_interval=0.01, **WEIGHED["accuracy"]),
        straying(),
    ),
}


@needs_gcc
@pytest.mark.parametrize(
    "case", quickly([(case,) for case in CHECKED], lambda case: case not in ("tilted", "every option"))
)
def test_the_python_module_calls_the_same_c(tmp_path: Path, case: str, request: pytest.FixtureRequest):
    if case != "every option":
        request.getfixturevalue("unoptimized")
    p, drive = CHECKED[case]
    write(tmp_path, p)
    (found,) = check_export(tmp_path, p, [drive])
    assert found.drive == drive.name
    assert found.double.state < 1e-11
    assert found.single is not None
    assert 1e-9 < found.single.position < 5e-3 and found.single.heading < 1e-4
    if case == "accuracy":
        (other,) = check_export(tmp_path, replace(p, accuracy_scale=0.5), [drive])
        assert other.double.state > 1e-6  # the check detects a difference


@needs_gcc
@pytest.mark.usefixtures("unoptimized")
def test_the_python_module_needs_no_sigmaswarm(tmp_path: Path):
    p, _ = CHECKED["every option"]
    write(tmp_path, p)
    check_export(tmp_path, p, [])
    code = "import sys; sys.modules['sigmaswarm'] = sys.modules['numpy'] = None; import ins_gps\n"
    code += "f = ins_gps.Filter(0.0, [0, 0, 10, 0, 0], [1.0 if i % 6 == 0 else 0.0 for i in range(25)])\n"
    code += "assert f.predict(0.01, [0.0, 0.0, 0.0]) and not f.predict(0.01, [0.0, 0.0, 0.0])\n"
    code += "assert not f.failed and f.time == 0.01 and abs(f.mean[0] - 0.1) < 1e-12\n"
    code += "assert f.update(0.015, [0.1, 0.0]) and len(f.covariance) == len(ins_gps.STATES) == 8\n"
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True)


@needs_gcc
def test_a_missing_or_failing_compiler_is_reported_with_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    p, drive = CHECKED["every option"]
    write(tmp_path, p)
    for compiler, said in (("no-such-cc", "no-such-cc does not run"), ("false", "false could not build")):
        monkeypatch.setenv("CC", compiler)
        with pytest.raises(InputError, match=said):
            check_export(tmp_path, p, [drive])
    monkeypatch.delenv("CC")
    monkeypatch.setattr(check, "COMPILERS", ("no-such-cc",))
    with pytest.raises(InputError, match="no C compiler was found"):
        check_export(tmp_path, p, [drive])
