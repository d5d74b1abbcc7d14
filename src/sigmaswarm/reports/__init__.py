"""Reports: results for people.

`views/` makes tables and charts of result records, as numbers; `pages/` puts them in the order in which they are read;
`draw/` draws them. The files here say what a command leaves in its folder.
"""
