"""Learned rivals of a tuned filter: networks that help it, trained on the user's own drives.

Two schools, each built from its principle (the papers' texts were not at hand, so what they decided may differ):

outage-lstm
    a network that stands in for the receiver during outages: it forecasts displacements, which the filter absorbs;
    after the idea of X. Li et al., Sci. Rep. 15, 11817, 2025, and Y. Yang et al., Sci. Rep. 14, 13905, 2024
noise-gru
    a network that scales Q and R by what the innovations were lately; after the idea of Q. Chen et al., IEEE TIM 71,
    2022

Training takes JAX (the extra ``learned``) and no truth. What is trained runs with NumPy alone: `cells` are written once
for both.
"""
