"""The workbench: all steps from a log to a tuned filter in the browser, based on the public API.

The state of the workbench is a folder with ``logs`` (dropped files), ``drives``, ``tunings``, ``evaluations`` and
``exports``, which the command line can also use, and ``workbench.json`` with the user's choices.
"""
