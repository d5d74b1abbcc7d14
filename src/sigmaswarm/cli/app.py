"""Subcommands, exit codes and error messages of the `sigmaswarm` command."""

import logging
import re
import sys
import traceback
import warnings
from collections import Counter
from importlib import import_module
from tempfile import NamedTemporaryFile
from typing import Any, Literal, NoReturn

from cyclopts import (
    App,
    CycloptsError,
    MissingArgumentError,
    Parameter,
    UnknownOptionError,
    UnusedCliTokensError,
)

import sigmaswarm
from sigmaswarm.cli import terminal
from sigmaswarm.cli.options import HELP_ALL, MORE
from sigmaswarm.errors import SigmaswarmError, SigmaswarmWarning
from sigmaswarm.wording import count_of, printable

app = App(
    name="sigmaswarm",
    version=sigmaswarm.__version__,
    help="""Tune the Kalman filter that fuses a vehicle's IMU and GPS.

A drive is a folder with imu.csv, gps.csv, drive.toml and, if known, truth.csv. The usual commands:

    sigmaswarm doctor drives/monday drives/tuesday
    sigmaswarm tune drives/monday drives/tuesday --out tuned
    sigmaswarm evaluate tuned drives/friday --out evaluation
    sigmaswarm report evaluation
    sigmaswarm run tuned drives/friday --out estimate.csv

Logs of other formats: `sigmaswarm import LOG --show` shows the content of a log. `sigmaswarm import LOG --out DRIVE`
writes a drive.

`sigmaswarm workbench LOG` runs all these steps in the browser.

If you have no logs: `sigmaswarm simulate --out drives` simulates drives. `sigmaswarm demo` runs a small version of the
paper's experiment.
""",
    help_flags=("--help", "-h", HELP_ALL),
    help_format="markdown",
    suppress_keyboard_interrupt=False,
)
PLAIN = Parameter(negative=(), consume_multiple=1)
# Each command is a function in a file of the same name in this folder.
COMMANDS = (
    *("doctor", "noise", "tune", "learn", "compare", "evaluate", "report", "study", "run", "export"),
    *("split", "convert", "reference", "simulate", "record-carla", "plot", "demo", "import", "workbench"),
)
SHORTENED = ("tune", "compare", "simulate", "import")  # commands with options that the short help omits
for name in COMMANDS:
    function = "import_" if name == "import" else name.replace("-", "_")
    command = getattr(import_module(f"sigmaswarm.cli.{function}"), function)
    more = f"`sigmaswarm {name} {HELP_ALL}` shows all options." if name in SHORTENED else None
    app.command(command, name=name, default_parameter=PLAIN, help_epilogue=more)


def completion(shell: Literal["bash", "zsh", "fish", "powershell"], /) -> None:
    """Print a shell script that completes commands, options and values.

    The command installs nothing and writes no file.

    For example:

        source <(sigmaswarm --completion bash)
        sigmaswarm --completion bash > ~/.local/share/bash-completion/completions/sigmaswarm
        sigmaswarm --completion fish > ~/.config/fish/completions/sigmaswarm.fish

    Parameters
    ----------
    shell
        Name of the shell.
    """
    print(app.generate_completion(shell=shell))


app.command(completion, name="--completion")


def main() -> NoReturn:
    """Run the command line and exit.

    Exit codes: 0 success, 1 serious faults found in a drive (doctor), 2 wrong input, 3 unexpected error,
    130 interrupted.
    """
    warnings.showwarning = _show_warning
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # suppress the message about its cache folder
    terminal.prepare()
    terminal.report_compilation()
    _warned.clear()
    code = _run()
    for message, count in _warned.items():
        if count > 1:
            print(f"warning ({count} times): {printable(message, 80)}", file=sys.stderr)
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError as error:  # closed output, or full disk
        terminal.mute()
        if not isinstance(error, BrokenPipeError):
            code = _fail(2, f"the output can't be written: {error.strerror or error}")
    sys.exit(code)


def _run() -> int:
    try:
        app(exit_on_error=False, print_error=False, console=terminal.console())
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 0
    except (SigmaswarmError, CycloptsError) as error:
        hint = "; see --help" if isinstance(error, CycloptsError) else ""
        explanation = _missing_out(error) or _other_name(error) or _too_many(error)
        message = explanation or terminal.one_line(error).removesuffix(".")
        return _fail(2, f"{message}{hint or _hidden_option(message)}")
    except KeyboardInterrupt:
        resumable = sys.argv[1:2] in (["tune"], ["compare"], ["simulate"], ["study"], ["learn"])
        print(file=sys.stderr)
        return _fail(130, "interrupted" + "; repeat the command with --resume to continue" * resumable)
    except BrokenPipeError:  # `sigmaswarm ... | head` is not a mistake
        terminal.mute()
    except OSError as error:  # for example no permission, or a lost network drive
        if not error.filename:  # an error of stdout
            terminal.mute()
        what = error.filename or "the output can't be written"
        return _fail(2, f"{what}: {error.strerror or error}")
    except Exception as error:
        return _unforeseen(error)
    return 0


def _fail(code: int, message: str) -> int:
    print(f"sigmaswarm: {terminal.one_line(message)}", file=sys.stderr)
    return code


def _unforeseen(error: Exception) -> int:
    """Write the traceback of an unexpected error to a temporary file, and report the error on one line."""
    what = "not enough memory" if isinstance(error, MemoryError) else f"{type(error).__name__}: {error}"
    try:
        with NamedTemporaryFile("w", prefix="sigmaswarm-", suffix=".txt", delete=False) as file:
            file.writelines(traceback.format_exception(error))
        where = f"; the traceback is in {file.name}"
    except OSError:
        where = ""
    return _fail(3, f"unexpected error: {terminal.one_line(what)}{where}")


def _missing_out(error: Exception) -> str | None:
    """Return the message for a missing --out, or None if --out is not missing."""
    if not isinstance(error, MissingArgumentError) or error.keyword or "Did you mean" in str(error):
        return None
    if error.argument is None or error.argument.name != "--out" or error.argument.tokens:
        return None
    what = "file" if "run" in (error.command_chain or ()) else "folder"
    return f"--out is missing: specify a {what} for the result"


def _other_name(error: Exception) -> str | None:
    """Suggest sigmaswarm's option if the user gave another library's name for this option."""
    if not isinstance(error, UnknownOptionError):
        return None
    from sigmaswarm.tuning.config import SYNONYMS

    given = (error.token.keyword or error.token.value).partition("=")[0]
    name = SYNONYMS.get(given.strip("-").replace("-", "_"))
    known = {name for argument in error.argument_collection for name in argument.names}
    return f"Unknown option: {given}. Did you mean --{name}?" if f"--{name}" in known else None


def _too_many(error: Exception) -> str | None:
    """Return the message for surplus arguments, for example several files that match a shell pattern."""
    if not isinstance(error, UnusedCliTokensError) or not error.unused_tokens:
        return None
    first, *more = error.unused_tokens
    message = (
        f"{first} and {count_of(len(more), 'more argument')} are" if more else f"{first} is one argument"
    )
    name = " ".join(error.command_chain or ())
    arguments = app[name].assemble_argument_collection() if name else ()
    places = [argument.name for argument in arguments if argument.name[0].isupper()]
    if not places:
        return f"{message} too many: `sigmaswarm {name}` takes only options"
    files = {"SOURCE", "LOG"} & {*places}
    remedy = (
        "to pass several files, specify their folder" if files else "run the command once for each argument"
    )
    if "SOURCE" in files:
        remedy += ", or specify the other files with --gps, --truth or --odometer"
    return f"{message} too many: `sigmaswarm {name}` takes one {' and one '.join(places)}; {remedy}"


def _hidden_option(message: str) -> str:
    """Return a reference to the long help if a message names an option that the short help omits, otherwise ""."""
    command = sys.argv[1] if len(sys.argv) > 1 else ""
    named = [word for word in re.findall(r"--[a-z][a-z-]*", message) if word not in sys.argv]
    if not named or command not in app:
        return ""
    hidden = {
        name
        for argument in app[command].assemble_argument_collection()
        if argument.parameter.group == MORE.group
        for name in argument.names
    }
    first = next((word for word in named if word in hidden), None)
    return f" (`sigmaswarm {command} {HELP_ALL}` describes {first})" if first else ""


_warned: Counter[str] = Counter()
_default_showwarning = warnings.showwarning


def _show_warning(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
    if issubclass(category, SigmaswarmWarning):
        message = terminal.one_line(message)
        _warned[message] += 1
        if _warned[message] == 1:
            print(f"warning: {message}", file=sys.stderr)
    else:
        _default_showwarning(message, category, *where, **more)
