"""Scores of estimates: errors against truth, drifts in outages, consistency, and evaluations of filters."""
