"""Networks that assist a tuned filter, trained on the user's drives without truth.

- outage-lstm: a network that estimates the vehicle's displacements in outages; after X. Li et al., Sci. Rep. 15, 11817,
  2025, and Y. Yang et al., Sci. Rep. 14, 13905, 2024
- noise-gru: a network that scales Q and R depending on the latest innovations; after Q. Chen et al., IEEE TIM 71, 2022

Training needs JAX (the extra ``learned``). A trained network needs only NumPy.
"""
