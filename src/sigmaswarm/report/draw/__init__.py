"""Drawing of what `report/views/` says: charts by plotly (pages) and matplotlib (PNG), tables as text."""
