"""Whole evaluations of a small model: all that is asked of it, beside all that its recipe teaches."""

from __future__ import annotations

from llm_flock.distill.evaluation import OTHER_TEAMS, Evaluator, PlanFigures
from llm_flock.distill.examples import plan_examples
from llm_flock.distill.taught import distinct_prompts, recipe_examples


def test_an_ideal_stand_in_passes_every_bar() -> None:
    evaluator = Evaluator("simulated:ideal", frame="own")
    steps, paths = evaluator.steps(20, 1), evaluator.steps(5, 20)
    assert steps.asked == 20 and steps.parsed == steps.within == steps.passed == 1.0 and steps.error < 0.1
    assert paths.passed == 1.0 and paths.shielded_error < 0.1
    plans = evaluator.plans(2)
    assert [p.team for p in plans] == ["triangle 3", "square 4", "cross 5", "circle 5", "circle 10"]
    assert all(p.passed == 1.0 and p.asked == 2 for p in plans)
    assert steps.degrees is not None and steps.degrees < 1.0
    far = evaluator.far_steps(3)
    assert list(far) == ["far 14 to 20", "far 20 to 25", "far 25 to 30"]
    assert all(m.passed == 1.0 and m.degrees is not None and m.degrees < 1.0 for m in far.values())
    assert evaluator.plans(1, OTHER_TEAMS[:2]) == [
        PlanFigures(team=team, asked=1, distinct=1, taught=0, passed=1.0) for team in ("line 3", "line 5")
    ]


def test_the_own_frame_leaves_no_held_out_question_for_a_plan() -> None:
    """Centres and spacings of the two splits differ, but not one prompt does: answers can be known by heart."""
    taught = [example for example in recipe_examples() if example.kind == "plan"]
    held_out = [example for seed in range(5) for example in plan_examples(seed, "held-out")]
    assert len(taught) == 60 * 27 and len(distinct_prompts(taught)) == 27
    assert distinct_prompts(held_out) == distinct_prompts(taught)
    found = Evaluator("simulated:ideal", prompts="brief", frame="own").prompts_of_plans(4)
    assert {team: (len(asked), taught) for team, (asked, taught) in found.items()} == {
        "triangle 3": (3, 3),
        "square 4": (4, 4),
        "cross 5": (4, 4),
        "circle 5": (4, 4),
        "circle 10": (4, 4),
    }
    in_world = Evaluator("simulated:ideal", prompts="brief", frame="world").prompts_of_plans(4)
    assert all((len(asked), taught) == (4, 0) for asked, taught in in_world.values())
