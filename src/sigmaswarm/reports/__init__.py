"""Reports of results: charts, tables, pictures and pages."""
