"""Import of logs of various formats as drives.

A table of a `Log` becomes part of a drive in these steps:

1. ``readers/`` decodes a format to tables; ``readers/dialect.py`` finds separator, header and units of a text table.
2. ``names.py`` interprets column names and ``units.py`` their units; ``quantities.py`` and ``coordinates.py`` make
   expressions in SI units.
3. ``guess.py`` assigns columns to IMU, fixes, truth and odometer. ``times.py`` finds the columns with the time of each
   table, and ``time_units.py`` their unit.
4. ``gather.py`` evaluates the expressions in batches (``expressions.py``, ``dates.py``).
5. ``timeline.py`` unwraps, spreads and sorts times and chooses a recording; ``joining.py`` joins the tables of a role.
6. ``positions.py`` and ``velocities.py`` check the columns of fixes and truth, ``mounting.py`` rotates the IMU, and
   ``assemble.py`` makes the drive. ``rates.py`` compares the IMU with the course of the fixes, and ``shared_frame.py``
   compares the tracks of truth and fixes.

A `Recipe` contains the expressions; ``--map`` changes them. ``opening.py`` opens the logs, ``convert.py`` runs all
steps, and ``inspection.py`` describes a log without importing it.
"""
