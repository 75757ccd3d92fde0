"""Conformance tests for your own rules, shapes, models and drivers. Call them in a test: they raise AssertionError.

from llm_flock.testing import check_assignment_rule, check_consensus_rule, check_model, check_prompts, check_shape

def test_my_rule():
    check_consensus_rule(MyRule())
"""

from llm_flock.testing.comparison import check_model, check_prompts, check_shape
from llm_flock.testing.robots import check_emergency_stop, check_robot
from llm_flock.testing.rules import check_assignment_rule, check_consensus_rule, random_message, random_plan

__all__ = [
    "check_assignment_rule",
    "check_consensus_rule",
    "check_emergency_stop",
    "check_model",
    "check_prompts",
    "check_robot",
    "check_shape",
    "random_message",
    "random_plan",
]
