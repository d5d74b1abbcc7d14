"""`python -m sigmaswarm`: the command, where its script is not on the path."""

from sigmaswarm.cli import main

if __name__ == "__main__":
    main()
