"""Options that several commands have, options made from pydantic fields, and the short help."""

import inspect
import sys
from collections.abc import Callable, Collection, Mapping
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from cyclopts import Group, Parameter, validators
from pydantic.fields import FieldInfo

HELP_ALL = "--help-all"


class _MoreOptions(Group):
    @property
    def show(self) -> bool:
        return HELP_ALL in sys.argv


MORE = Parameter(group=_MoreOptions("More options"))  # annotation of an option that only `--help-all` shows
FIELDS = Parameter(name="*", help="The options of the command line.")  # for a dataclass of options
AT_LEAST_1 = Parameter(validator=validators.Number(gte=1))
AT_LEAST_0 = Parameter(validator=validators.Number(gte=0))
Count = Annotated[int | None, AT_LEAST_1]
Seed = Annotated[int, AT_LEAST_0]
Hyphened = Annotated[str | None, Parameter(allow_leading_hyphen=True)]  # may begin with a minus sign
Places = Annotated[
    list[str], Parameter(name="DRIVE", help="Drive folders or URLs, or folders of drive folders.")
]
Workers = Annotated[
    int | None,
    AT_LEAST_1,
    Parameter(help="Number of threads; by default one per core. The result does not depend on this number."),
]
Cluster = Annotated[
    str | None,
    Parameter(
        help="Dask cluster for the computation: tcp://host:8786, a scheduler file, or local:4 for 4 local processes."
    ),
]
TrustLog = Annotated[bool, Parameter(help="Skip the check of the drives for serious faults.")]
Overwrite = Annotated[bool, Parameter(help="Replace earlier output of this command.")]
AsRecorded = Annotated[
    bool,
    Parameter(
        help="Run without preprocessing, for diagnosis: use stale fixes, and treat IMU gaps as ordinary steps."
    ),
]
Verbose = Annotated[bool, Parameter(help="Also print evidence, notes and details.")]
Json = Annotated[bool, Parameter(help="Print the result as JSON.")]


def options_of(
    fields: Mapping[str, FieldInfo],
    *,
    shown: Collection[str] | None = None,
    omitted: Collection[str] = (),
    by_data: Collection[str] = (),
    renamed: Mapping[str, str] | None = None,
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Add fields as options to a command, which receives the options of the user as ``**options``.

    ``shown`` contains the fields in the short help, by default all. ``omitted`` contains fields that are not options.
    ``by_data`` contains fields with a default that depends on the data. ``renamed`` contains the current name of each
    deprecated name.
    """
    old = {new: name for name, new in (renamed or {}).items()}
    added = {
        name: _annotation(name, field, old.get(name), shown is None or name in shown, name not in by_data)
        for name, field in fields.items()
        if name not in omitted
    }

    def decorated(command: Callable[..., None]) -> Callable[..., None]:
        own = [p for p in inspect.signature(command).parameters.values() if p.kind is not p.VAR_KEYWORD]
        required = [p for p in own if p.default is p.empty]
        parameters = [
            *required,
            *(
                inspect.Parameter(n, own[-1].KEYWORD_ONLY, default=None, annotation=a)
                for n, a in added.items()
            ),
            *(p for p in own if p not in required),
        ]

        def run(*arguments: Any, **named: Any) -> None:
            command(*arguments, **{k: v for k, v in named.items() if k not in added or v is not None})

        run.__name__, run.__doc__ = command.__name__, command.__doc__
        run.__annotations__ = {p.name: p.annotation for p in parameters}
        run.__signature__ = inspect.Signature(parameters)
        return run

    return decorated


def _annotation(name: str, field: FieldInfo, old: str | None, shown: bool, constant: bool) -> Any:
    """Return a field's type, annotated with its `Parameter`.

    For a union, the command line accepts only the first type that is not None.

    ``old`` is the deprecated name. ``shown`` is True for an option in the short help. ``constant`` is False for a
    default that depends on the data.
    """
    kind, option = field.annotation, f"--{name.replace('_', '-')}"
    if get_origin(kind) in (Union, UnionType):
        kind = next(member for member in get_args(kind) if member is not NoneType)
    parameter: dict[str, Any] = {"help": " ".join((field.description or "").split()), "show_default": False}
    if several := get_origin(kind) is tuple:
        kind = list[get_args(kind)[0]]
    if not constant and (several or kind is bool):
        parameter["negative"] = f"{option}-nothing" if several else f"--no-{name}"
    elif not several and kind is not bool and constant and field.default not in (None, ""):
        parameter["show_default"] = lambda _: str(field.default)  # pyright: ignore[reportUnknownLambdaType]
    if old:
        parameter["alias"] = f"--{old.replace('_', '-')}"
    return Annotated[kind | None, Parameter(**parameter), *(() if shown else (MORE,))]
