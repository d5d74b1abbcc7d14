"""One file a format: whether it is that, its tables, and how a drive would be made of them."""
