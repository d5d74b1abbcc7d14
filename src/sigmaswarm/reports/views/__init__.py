"""Views: numbers of result records for display.

`record.py` is the vocabulary: tables of cells, charts of marks. `reports/draw/` draws them.
"""
