"""Reports of results: charts, tables and pages.

`views/` makes charts and tables of result records and `pages/` arranges them; `figures.py` draws charts as PNG and SVG,
`page.py` renders HTML. The other files write the pictures that a command leaves in its folder.
"""
