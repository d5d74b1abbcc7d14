"""Settings that hold for all tests."""

import os

from hypothesis import HealthCheck, settings

# A busy machine is no failure, and the same commit gets the same verdict; ``HYPOTHESIS_PROFILE=search`` looks farther.
patient = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("sigmaswarm", patient, derandomize=True)
settings.register_profile("search", patient, max_examples=1000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "sigmaswarm"))
