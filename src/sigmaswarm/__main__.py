"""Run the command line as `python -m sigmaswarm`, which also works if the command `sigmaswarm` is not on the path."""

from sigmaswarm.cli import main

if __name__ == "__main__":
    main()
