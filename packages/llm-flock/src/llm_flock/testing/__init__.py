"""Conformance tests for your own rules, shapes, models and drivers. Call them in a test: they raise AssertionError.

from llm_flock.testing import check_assignment_rule, check_consensus_rule, check_model, check_prompts, check_shape

def test_my_rule():
    check_consensus_rule(MyRule())
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
