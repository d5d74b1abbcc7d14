"""Datasets: lists of drives, in this process or on the workers of a Dask cluster."""
