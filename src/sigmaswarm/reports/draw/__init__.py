"""Draw what `reports/views/` says: PNG by matplotlib, charts of pages by plotly, pages as HTML, tables as text."""
