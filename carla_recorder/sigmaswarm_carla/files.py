"""Write recording.json and the drive folders."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .drive import Recording
from .geometry import interpolate
from .options import Options, RecorderError


class Journal:
    """File recording.json of an output folder: options, versions, geodesy, physics and measured friction."""

    def __init__(self, options: Options) -> None:
        self._file = options.out / "recording.json"
        self._content: dict[str, Any] = {"options": options.figures()}
        there = sorted(path.parent.name for path in options.out.glob("*/imu.csv"))
        if there and not options.resume:
            raise RecorderError(
                f"{options.out}: contains {there[0]} already; choose another folder, or continue with --resume"
            )
        if self._file.exists():
            self._read(options, there)

    def _read(self, options: Options, there: Sequence[str]) -> None:
        try:
            held = json.loads(self._file.read_text(encoding="utf-8"))
            made = dict(held["options"])
        except (ValueError, KeyError, TypeError):
            raise RecorderError(
                f"{self._file}: is not a file of the recorder; choose another folder"
            ) from None
        for key, value in options.figures().items():
            if there and made.get(key) != value:
                raise RecorderError(
                    f"{self._file}: the existing drives were recorded with {key} {made.get(key)}, not {value}; "
                    "choose another folder, or use the same options"
                )
        if there and options.brake_sweep and not held.get("friction"):
            raise RecorderError(
                f"{self._file}: the existing drives were recorded without --brake-sweep; choose another folder, "
                "or leave out --brake-sweep"
            )
        self._content = {**held, "options": options.figures()}

    @property
    def friction(self) -> list[list[float]]:
        """Pairs of tire_friction and measured friction; empty without --brake-sweep."""
        return self._content.get("friction", [])

    def tire_friction(self, friction: float) -> float | None:
        """Return the tire_friction for a friction of the road; None without --brake-sweep."""
        if not self.friction:
            return None
        table = sorted((measured, tire) for tire, measured in self.friction)
        return interpolate(table, friction)

    def note(self, **entries: Any) -> None:
        """Save entries. Dictionaries are merged with the saved dictionaries."""
        for key, value in entries.items():
            old = self._content.get(key)
            self._content[key] = (
                {**old, **value} if isinstance(old, dict) and isinstance(value, dict) else value
            )
        self._file.parent.mkdir(parents=True, exist_ok=True)
        new = self._file.with_suffix(".new")
        new.write_text(json.dumps(self._content, indent=2) + "\n", encoding="utf-8")
        new.replace(self._file)


def write_drive(folder: Path, recording: Recording, about: dict[str, Any], options: Options) -> None:
    """Write the folder of a drive under a temporary name, and rename the complete folder."""
    new = folder.parent / f".{folder.name}.new"
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir(parents=True)
    rows = recording.rows
    _write_csv(new / "imu.csv", "t,ax,ay,az,gx,gy,gz", ((r.t, *r.force, *r.rate) for r in rows))
    std = (options.gps_noise,) * 2 if options.gps_noise > 0 else ()
    header = "t,x,y,std_x,std_y" if std else "t,x,y"
    _write_csv(new / "gps.csv", header, ((*fix, *std) for fix in recording.fixes))
    _write_csv(
        new / "truth.csv",
        "t,x,y,vx,vy,theta",
        ((r.t, *r.place[:2], *r.velocity[:2], r.heading) for r in rows),
    )
    (new / "drive.toml").write_text(toml(about), encoding="utf-8")
    new.rename(folder)


def _write_csv(path: Path, header: str, rows: Any) -> None:
    lines = [header, *(",".join(repr(float(v)) for v in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def keep_incomplete(recording: Recording, options: Options) -> None:
    """Save an incomplete drive in the folder ``incomplete``, which no command reads."""
    if not recording.rows:
        return
    parent = options.out / "incomplete"
    number = len(list(parent.glob(f"{recording.name}-*"))) if parent.exists() else 0
    about = {"frame": "enu", "source": "CARLA, incomplete"}
    write_drive(parent / f"{recording.name}-{number}", recording, about, options)


def toml(content: dict[str, Any], table: str = "") -> str:
    """Return a dictionary of scalars, lists and tables as TOML."""
    # JSON's numbers, strings and lists are valid TOML.
    values = ((key, v) for key, v in content.items() if not isinstance(v, dict))
    text = "\n".join(f"{key} = {json.dumps(v, ensure_ascii=False)}" for key, v in values) + "\n"
    for key, value in content.items():
        if isinstance(value, dict):
            name = f"{table}{key}"
            text += f"\n[{name}]\n{toml(dict(value), f'{name}.')}"
    return text
