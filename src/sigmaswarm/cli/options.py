"""Options of a command that are said elsewhere: made of a TypedDict's types and meanings, and of the defaults."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from types import NoneType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from cyclopts import Parameter
from typing_extensions import Doc


def takes(asked: type, defaults: Mapping[str, Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command with ``**options`` the options of a TypedDict; it gets those that the user gave.

    Parameters
    ----------
    asked : type
        A TypedDict; each of its types carries a `Doc`.
    defaults : mapping
        What the help says of an option that is left out, by its name.
    """
    hints: dict[str, Any] = get_type_hints(asked, include_extras=True)
    added = [
        inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=None,
            annotation=_annotation(name, hint, defaults[name]),
        )
        for name, hint in hints.items()
    ]

    def decorated(command: Callable[..., None]) -> Callable[..., None]:
        own = [p for p in inspect.signature(command).parameters.values() if p.kind is not p.VAR_KEYWORD]
        required = [p for p in own if p.default is p.empty]
        parameters = [*required, *added, *(p for p in own if p not in required)]

        def run(*arguments: Any, **named: Any) -> None:
            command(*arguments, **{k: v for k, v in named.items() if k not in hints or v is not None})

        run.__name__, run.__doc__ = command.__name__, command.__doc__
        run.__annotations__ = {p.name: p.annotation for p in parameters}
        run.__signature__ = inspect.Signature(parameters)  # pyright: ignore[reportFunctionMemberAccess]
        return run

    return decorated


def _annotation(name: str, hint: Any, default: Any) -> Any:
    """What Cyclopts reads: the type, and how an option is given and explained."""
    kind, said = get_args(hint)[0], next(extra for extra in get_args(hint)[1:] if isinstance(extra, Doc))
    look: dict[str, Any] = {"help": said.documentation, "show_default": False}
    if kind is bool:
        look["negative"] = ()
    elif get_origin(kind) is Sequence:
        kind = list[get_args(kind)[0]]
        look |= {"consume_multiple": 1, "negative": f"--{name}-nothing"}
    elif default is not None:
        look["show_default"] = lambda _: str(default)  # pyright: ignore[reportUnknownLambdaType]
    return Annotated[kind if NoneType in get_args(kind) else kind | None, Parameter(**look)]
