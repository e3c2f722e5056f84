"""Settings of Hypothesis: reproducible examples, a second or two per property."""

import sys
from pathlib import Path

from hypothesis import HealthCheck, settings
from hypothesis.internal.conjecture import providers

sys.path.insert(0, str(Path(__file__).parent))

# Numbers and words in the sources of whatever is imported by then would be tried too: others in
# each process that shares the tests with others, and three seconds to find them.
providers._get_local_constants = lambda: providers._local_constants

settings.register_profile(
    "repeatable", derandomize=True, database=None, deadline=None, max_examples=60,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)  # fmt: skip
settings.load_profile("repeatable")
