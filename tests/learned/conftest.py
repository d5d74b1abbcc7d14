"""The command line in the tests' own process."""

from cli.conftest import sigmaswarm

__all__ = ["sigmaswarm"]
