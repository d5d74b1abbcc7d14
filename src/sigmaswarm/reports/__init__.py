"""Charts, tables, pictures and pages of results."""
