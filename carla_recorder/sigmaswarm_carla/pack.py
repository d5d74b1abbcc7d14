"""Write the recorder as one file for another machine: ``python -m sigmaswarm_carla.pack carla_recorder.pyz``."""

from __future__ import annotations

import shutil
import sys
import tempfile
import zipapp
from pathlib import Path


def pack(file: Path) -> None:
    """Write this package as a zipapp, which Python 3.8 and later run."""
    with tempfile.TemporaryDirectory() as folder:
        package = Path(__file__).parent
        ignore = shutil.ignore_patterns("__pycache__")
        shutil.copytree(package, Path(folder) / package.name, ignore=ignore)
        zipapp.create_archive(
            folder, file, interpreter="/usr/bin/env python3", main=f"{package.name}.__main__:run"
        )


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m sigmaswarm_carla.pack FILE.pyz")
    pack(Path(sys.argv[1]))
    print(
        f"wrote {sys.argv[1]}; run it with the Python in which the server's client is installed: "
        f"python {sys.argv[1]} --help"
    )
