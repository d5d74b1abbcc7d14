"""Compiled filters for many parameter sets at once; `textbook/` contains the same equations in textbook form."""
