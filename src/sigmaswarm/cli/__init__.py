"""The command line, one file per command.

A command imports large libraries only when it runs, so that the help is fast.
"""

from sigmaswarm.cli.app import main

__all__ = ["main"]
