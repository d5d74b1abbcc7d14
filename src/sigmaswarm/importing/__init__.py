"""Import of logs of other formats as drives.

The steps of a table of a `Log`:

bytes -> table        `readers/` decode a format; of text, `readers/dialect.py` finds separator, header and units table
-> columns      `names.py` reads names, `units.py` units, `quantities.py` makes expressions in SI units columns -> roles
`guess.py` finds IMU, fixes, truth and odometer; `times.py` finds the time of each expressions -> rows   `gather.py`
evaluates them by batches (`expressions.py`, `dates.py`) rows -> time line     `timeline.py` unwraps, chooses a
recording, spreads and sorts; `joining.py` joins a role's tables time line -> drive    `places.py` checks positions,
`mounting.py` turns the IMU, `assemble.py` makes the drive

A `Recipe` has the expressions; the user may change it with `--map`. `convert.py` runs all steps, `look.py` shows all.
"""
