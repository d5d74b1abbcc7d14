"""The command line, one file per command. Commands import large libraries when they run."""

from sigmaswarm.cli.app import main

__all__ = ["main"]
