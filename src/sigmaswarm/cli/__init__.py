"""The command line: one thin file a command; heavy imports happen inside the commands."""

from sigmaswarm.cli.app import main

__all__ = ["main"]
