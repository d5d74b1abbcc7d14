"""The wheel's kernels: compiled by Numba when the wheel is built, for machines with the same versions of it.

    python hatch_build.py kernels.zip 8

compiles those for vectors of eight numbers, of the Python that runs it. `make dist` names that in SIGMASWARM_KERNELS,
or several, with colons between them; without, as where pip builds from the sources, a wheel has none, and nothing that
compiles is needed.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
except ImportError:  # the Python that compiles need not be the one that builds
    BuildHookInterface = object

PYTHONS = "SIGMASWARM_KERNELS"
SOURCES = Path(__file__).parent / "src"


class CustomBuildHook(BuildHookInterface):
    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and put the file into the wheel; an editable install has none."""
        if version == "editable" or not os.environ.get(PYTHONS):
            return
        self.scratch = tempfile.TemporaryDirectory()
        file = Path(self.scratch.name) / "kernels.zip"
        for python in os.environ[PYTHONS].split(os.pathsep):
            for width in ("4", "8"):
                subprocess.run([python, __file__, str(file), width], check=True)
        build_data["force_include"][str(file)] = "sigmaswarm/kernels.zip"


def compile_kernels(file: Path, width: int, *models: str) -> None:
    """Compile what filters of some models use, else all, and add it to the file.

    The processor need not have such vectors.
    """
    from zipfile import ZIP_LZMA, ZipFile

    from numba.core.codegen import CPUCodeLibrary

    from sigmaswarm import compilation, shipped

    before: dict[str, bytes] = {}
    optimize, save = CPUCodeLibrary._optimize_final_module, compilation._Cache.save_overload
    shipped.wide = lambda codegen: width == 8

    def noted(library: Any) -> None:
        before[library.name] = library._final_module.as_bitcode()
        optimize(library)

    def packed(cache: Any, sig: Any, result: Any) -> None:
        library, *about = result._reduce()
        about = tuple(
            "" if isinstance(each, str) else each for each in about
        )  # the types of each line, to be read
        content = shipped.packed(library[0], before[library[0]], about)
        with ZipFile(file, "a", ZIP_LZMA) as archive:
            archive.writestr(shipped.key_of(cache.name, sig, result.codegen), content)
        save(cache, sig, result)

    CPUCodeLibrary._optimize_final_module, compilation._Cache.save_overload = noted, packed
    use(*models)


def use(*models: str) -> None:
    """Do with models what people do with filters."""
    import sigmaswarm as ss
    from sigmaswarm.filters.compiled.live import live_calls
    from sigmaswarm.filters.compiled.single import single_step
    from sigmaswarm.filters.compiled.swarm import swarm_step
    from sigmaswarm.filters.models import MODELS

    drive = ss.simulate(duration=30.0)
    live_calls()
    for name in models or MODELS:
        noise = (1e-4,) * len(MODELS[name].states)
        more = {"kind": MODELS[name].kinds[0], "standstill_noise": 1e-3}
        ss.run_filter(drive, ss.FilterParameters(1.0, 2.0, 0.0, noise, (1.0, 1.0), name, **more))
        single_step(name)
        swarm_step(name)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as cache:
        os.environ["NUMBA_CACHE_DIR"] = cache
        sys.path.insert(0, str(SOURCES))
        compile_kernels(Path(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:])
