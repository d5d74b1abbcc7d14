"""Compiled filters for many parameter sets at once.

`layout` numbers the rows of the one array that a run works on; `planar5` and `planar8` predict in closed form;
`measurements` updates; `step` combines both; `run` and `live` take the steps of a time line. `custom` is the filter for
a user's model. `textbook/` contains the same equations in textbook form.
"""
