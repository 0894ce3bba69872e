"""What holds for all tests."""

from hypothesis import settings

# The same examples on every run, and no clock: a slow machine is no failure.
settings.register_profile("earshot", deadline=None, derandomize=True)
settings.load_profile("earshot")
