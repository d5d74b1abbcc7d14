"""The command line, one file per command. Commands import large libraries only when they run, for fast help."""

from sigmaswarm.cli.app import main

__all__ = ["main"]
