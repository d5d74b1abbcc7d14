"""Settings that hold for all tests."""

import os

from hypothesis import settings

# A busy machine is no failure, and the same commit gets the same verdict; ``HYPOTHESIS_PROFILE=search`` looks farther.
settings.register_profile("sigmaswarm", deadline=None, derandomize=True)
settings.register_profile("search", deadline=None, max_examples=1000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "sigmaswarm"))
