"""The checks: one file a subject, each with a function ``check`` from the evidence to findings."""
