"""Damage sound logs of every format at random: no traceback, no endless run, and no unreported change of a value."""
