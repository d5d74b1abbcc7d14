"""Sound logs of every format, broken by chance: no traceback, no hang, no flood, and no value changed unsaid."""
