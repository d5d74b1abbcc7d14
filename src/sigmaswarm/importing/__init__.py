"""Import of logs of various formats as drives.

A table of a `Log` becomes part of a drive in these steps:

1. ``readers/`` decodes a format to tables; ``readers/dialect.py`` finds separator, header and units of a text table,
   and ``readers/scanning.py`` reads it.
2. ``names.py`` interprets column names and ``units.py`` their units; ``quantities.py`` and ``coordinates.py`` make
   expressions in SI units.
3. ``guess.py`` assigns columns to IMU, fixes, truth and odometer, and ``kept_rows.py`` finds the rows to read.
   ``times.py`` finds the columns with the time of each table, ``time_units.py`` their unit, and ``clocks.py`` the rate
   of a counter.
4. ``opening.py`` opens the logs of a `Request` as a `Plan`. ``completion.py`` completes its `Recipe`, which contains
   the expressions and which ``--map`` changes. ``faults.py`` describes unknown units and missing sensors.
5. ``gather.py`` evaluates the expressions in batches (``expressions.py``, ``dates.py``).
6. ``timeline.py`` unwraps, spreads and sorts times and chooses a recording; ``joining.py`` joins the tables of a role
   as `Samples`, without repeated fixes (``repeated_fixes.py``). ``synchronization.py`` puts all sensors on one clock.
7. ``positions.py`` checks the columns of fixes and truth, ``truth.py`` compares the tracks of both, ``mounting.py``
   rotates the IMU, and ``assemble.py`` makes the drive. ``imu_units.py`` detects wrong units of the IMU.

``convert.py`` runs all steps. ``inspection.py`` describes a log without importing it; ``proposal.py`` proposes columns
by names (``word_meanings.py``) and values (``unnamed.py``), and ``proposal_check.py`` checks the proposal.
"""
