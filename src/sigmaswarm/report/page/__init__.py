"""One self-contained HTML page, made of result files alone.

A folder's adapter (`tuning.py`, `evaluation.py`) reads its files, checked by `schema.py`, into a `Report`
(`record.py`); `html.py` turns any `Report` into a page. `folders.py` says which adapter a folder needs.
"""
