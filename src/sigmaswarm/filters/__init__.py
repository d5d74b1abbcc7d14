"""Kalman filters: models, parameters, and runs over drives."""
