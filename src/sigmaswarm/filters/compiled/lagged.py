"""Process the last samples of a live filter again, and log every step for the smoother."""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

from sigmaswarm.compilation import call_once
from sigmaswarm.filters.compiled.live import N_ALL, replay
from sigmaswarm.filters.compiled.run import cached_by_sources

N_LOGGED = N_ALL
"""Index of the number of logged steps, after the state of a live filter; the log follows this number."""
STEP_LOG = N_ALL + 1


def _again(sources):
    def again(step, v, counts, fixes, speeds, history, checkpoints, first, corrects):
        if sources == "":  # never true; makes ``sources`` a part of the closure
            return
        replay(step, v, counts, fixes, speeds, history, checkpoints, first, corrects)

    return again


@call_once
def again_call():
    """Return `live.replay` as a compiled function.

    For a smoother, pass as ``step`` a `single_step` whose log begins at N_LOGGED.
    """
    return cached_by_sources(_again, "live again")
