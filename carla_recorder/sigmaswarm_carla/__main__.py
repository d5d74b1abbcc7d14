"""Run the recorder: ``python -m sigmaswarm_carla --out FOLDER``."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from typing import Any

from .options import RecorderError, options_of
from .record import record


def main(arguments: Sequence[str]) -> int:
    """Run the command line. Return the exit code: 0 success, 2 error, 130 interrupted."""

    def end(*_: Any) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, end)
    try:
        options = options_of(arguments)
        count = record(options)
    except RecorderError as error:
        print(f"sigmaswarm: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nsigmaswarm: interrupted; repeat the command with --resume to continue", file=sys.stderr)
        return 130
    except OSError as error:
        print(f"sigmaswarm: {error.filename or 'a file'}: {error.strerror or error}", file=sys.stderr)
        return 2
    print(f"recorded {count} drive{'' if count == 1 else 's'} to {options.out}")
    print(f"next: sigmaswarm tune {options.out} --out tuned --objective truth-pose")
    return 0


def run() -> None:
    """Run the command line and exit without the interpreter's shutdown, during which the client of 0.9.16 may abort."""
    code = main(sys.argv[1:])
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


if __name__ == "__main__":
    run()
