"""Drives wherever they are held: in this process, or by the workers of a Dask cluster; parameter sets travel there."""
