"""The command line: one thin file per command. Heavy imports happen inside the commands."""

from sigmaswarm.cli.app import main

__all__ = ["main"]
