"""Settings that hold for all tests."""

from hypothesis import settings

settings.register_profile("sigmaswarm", deadline=None)  # a busy machine is no failure
settings.load_profile("sigmaswarm")
