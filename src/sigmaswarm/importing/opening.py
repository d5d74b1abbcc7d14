"""Settings of an import; open the logs, and guess or choose the tables of each role."""

from collections.abc import Generator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from shlex import quote
from typing import Any

from sigmaswarm.errors import InputError
from sigmaswarm.importing.formats import open_log
from sigmaswarm.importing.guess import guess_roles, magnetometer_part
from sigmaswarm.importing.recipe import Recipe, mapped_columns, mapped_roles
from sigmaswarm.importing.source import ROLES, Guess, Limits, Log, Part, Role, TableChoice
from sigmaswarm.wording import list_names


@dataclass(frozen=True)
class Request:
    source: Path  # the log with the IMU
    gps: Path | None = None  # another log, with fixes
    truth: Path | None = None  # another log, with truth
    odometer: Path | None = None  # another log, with wheel speed
    form: str | None = None  # the source's format
    recipe: Recipe = field(default_factory=Recipe)  # settings, and parts that replace guessed ones
    maps: Sequence[str] = ()  # ``column=expression``
    time: str | None = None  # expression of the time, for each table of the source
    choice: TableChoice = field(default_factory=TableChoice)
    limits: Limits = field(default_factory=Limits)
    part: int | None = None  # number of the recording, counted from 1, if a clock restarts within a table
    # Files or folders with .msg definitions of ROS messages, for bags
    definitions: Sequence[Path] = ()

    @property
    def log(self) -> str:
        """The name of the source; for ".", the name of the current folder."""
        return self.source.name or self.source.resolve().name

    def home(self, role: str) -> Path:
        """Return the log of a role; the role "velocity" has the log of the fixes."""
        other: Path | None = getattr(self, "gps" if role == "velocity" else role, None)
        return other if role not in ("imu", "mag") and other else self.source


@dataclass(frozen=True)
class Plan:
    """The open logs of a request, the guess for each, and the recipe with which they become a drive."""

    request: Request
    logs: Mapping[Path, Log]
    guesses: Mapping[Path, Guess]
    recipe: Recipe

    def parts(self, role: Role) -> tuple[Part, ...]:
        return self.recipe.roles.get(role, ())

    @property
    def imu_time(self) -> str:
        """The expression of the IMU's time; "" if the recipe has none."""
        return next((part.columns.get("t", "") for part in self.parts("imu")), "")

    def log(self, role: Role) -> Log:
        return self.logs[self.request.home(role)]

    def guess(self, role: Role) -> Guess:
        """Return the guess of the log that contains a role."""
        return self.guesses[self.request.home(role)]

    def with_roles(self, roles: Mapping[Role, tuple[Part, ...]]) -> "Plan":
        return replace(self, recipe=replace(self.recipe, roles=roles))

    def is_stated(self, role: Role, column: str) -> bool:
        """Return True if the user specified a column."""
        request = self.request
        timed = column == "t" and request.time is not None and request.home(role) == request.source
        return (role, column) in mapped_columns(request.maps) or timed or role in request.recipe.roles


def request_of(log: str | Path, settings: Mapping[str, Any]) -> Request:
    """Make a request from keywords that are fields of `Request` and `Recipe`. ``recipe`` may be a file."""
    settings = dict(settings)
    recipe = settings.pop("recipe", None)
    recipe = recipe if isinstance(recipe, Recipe) else Recipe.load(Path(recipe)) if recipe else Recipe()
    if "format" in settings:
        settings["form"] = settings.pop("format")
    if "tables" in settings:
        settings["choice"] = TableChoice(settings.pop("tables"))
    if isinstance(maps := settings.get("maps"), Mapping):
        settings["maps"] = [f"{column}={expression}" for column, expression in maps.items()]
    own = {f.name for f in fields(Request)} - {"source", "recipe"}
    known = own | {f.name for f in fields(Recipe)}
    if unknown := [key for key in settings if key not in known]:
        there = sorted(known - {"form", "choice", "roles"} | {"format", "tables", "recipe"})
        raise InputError(f"the import has no setting {unknown[0]!r}; choose from {', '.join(there)}")
    logs = {key: Path(settings[key]) for key in ("gps", "truth", "odometer") if settings.get(key)}
    given: dict[str, Any] = {key: value for key, value in settings.items() if key in own} | logs
    changed: dict[str, Any] = {key: value for key, value in settings.items() if key not in own}
    return Request(source=Path(log), recipe=replace(recipe, **changed), **given)


@contextmanager
def opened(request: Request) -> Generator[Plan]:
    """Open the logs of a request. The recipe is still that of the request."""
    with ExitStack() as stack:
        logs: dict[Path, Log] = {}
        for path in dict.fromkeys(map(request.home, ROLES)):
            form = request.form if path == request.source else None
            log = open_log(path, form, request.limits, request.definitions)
            logs[path] = stack.enter_context(log)
        guesses = {path: _guess(log, request) for path, log in logs.items()}
        yield Plan(request, logs, guesses, request.recipe)


def _guess(log: Log, request: Request) -> Guess:
    """Return the reader's guess, with the chosen tables of this log's roles.

    If a log named with --truth or --odometer has only one table, this table has the role.
    """
    tables = {role: t for role, t in request.choice.tables.items() if request.home(role) == log.path}
    for role, path in (("truth", request.truth), ("odometer", request.odometer)):
        if log.path == path and len(log.tables) == 1:
            tables[role] = next(iter(log.tables))
    chosen, mapped = tables.pop("mag", None), mapped_roles(request.maps)
    for role, table in tables.items():
        if table not in log.tables:
            _refuse_file(log, role, Path(table), log.path.parent / table)
    guess = log.guess(replace(request.choice, mapped=mapped, tables=tables))
    for role in ROLES:
        if role in tables and role not in mapped:
            guess = _with_chosen(guess, log, role, tables[role])
    if chosen is None:
        return guess
    part = magnetometer_part(chosen, log.tables[chosen].columns if chosen in log.tables else ())
    return replace(guess, roles={**guess.roles, "mag": (part,)})


def _with_chosen(guess: Guess, log: Log, role: Role, table: str) -> Guess:
    """Return a guess with the chosen table of a role, since readers of formats with fixed tables ignore the choice."""
    if table.lstrip("/") in (part.table.lstrip("/") for part in guess.roles.get(role, ())):
        return guess
    if table not in log.tables:
        _refuse_file(log, role, log.path / table)
        raise InputError(
            f"{log.path}: has no table {table!r} for --{role}-table; choose from {list_names(log.tables)}"
        )
    other = guess_roles({table: log.first_rows(table)}, {role: table})
    if len(columns := other.roles.get(role, (Part(table, {}),))[0].columns) < 2:
        raise InputError(
            f"{log.path}: {table} has no columns with recognized names for --{role}-table; specify them with --map"
        )
    return replace(
        guess, roles={**guess.roles, role: (Part(table, columns),)}, notes=guess.notes + other.notes
    )


def _refuse_file(log: Log, role: str, *files: Path) -> None:
    """Raise `InputError` if a chosen table is a file that the log does not contain."""
    if role in ("gps", "truth", "odometer") and (file := next(filter(Path.is_file, files), None)):
        raise InputError(f"{log.path}: has no table {file.name!r}; write --{role} {quote(str(file))}")
