"""The workbench: all steps from a log to a tuned filter in the browser, based on the public API.

The state of the workbench is an ordinary folder: ``logs`` (dropped files), ``drives``, ``tunings``, ``evaluations``,
``exports``. Work on the page can be continued on the command line, and conversely.
"""
