"""One file for each format: its detection, its tables, and the recipe of a drive."""
