"""Reading the logs that people have, as drives.

A log is a `Source`: named tables of columns, whatever the file format. A `Recipe` says which expressions over which
table's columns make a drive's columns; each reader guesses one, the user may change it or give another. Batch by
batch the expressions are evaluated, so that only the drive's own columns are ever held in memory.
"""
