"""Pages: one `Report` of sections for each type of result folder.

`folders.py` selects the page of a folder; `reports/draw/html.py` makes one HTML file of any of them.
"""
