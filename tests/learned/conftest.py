"""Call the command line in the process of the tests."""

from cli.conftest import sigmaswarm

__all__ = ["sigmaswarm"]
