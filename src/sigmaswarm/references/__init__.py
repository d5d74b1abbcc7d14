"""Truth for drives that have none: what a good receiver beside the cheap one knows."""
