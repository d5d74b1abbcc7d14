"""Pages: what each kind of result folder tells its reader, as a `Report` of sections.

`folders.py` says which page a folder needs; `reports/draw/html.py` makes one HTML file of any of them.
"""
