"""Views: what is shown of result records, as numbers, said once.

`record.py` is the vocabulary: tables of cells, charts of marks. `reports/draw/` draws them.
"""
