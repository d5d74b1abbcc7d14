"""The filters, compiled: many parameter sets at once.

`lanes` names the rows of the one array that a run works on; `planar5` and `planar8` predict in closed form;
`measurements` absorb; `run` puts them on a time line. `reference/` says the same in the textbook's words.
"""
