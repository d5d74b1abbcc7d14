"""The workbench: from a log to a tuned filter in the browser, on the public API.

Its state is an ordinary folder: ``logs`` (dropped files), ``drives``, ``tunings``, ``evaluations``, ``exports``. The
command line continues where the page stopped, and the page where the command line stopped.
"""
