"""Renders questions as prompts, from templates that an operator may replace.

The paper's messages are the system message (lines 101-113), the plan generation message (115-120) and the position
update (166-171); the wording here is our own, and the plan message also gives the robot's id and the centre.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Self

import jinja2
import jinja2.meta
from jinja2.sandbox import SandboxedEnvironment

from llm_flock.errors import InputError
from llm_flock.llm._choices import options_text
from llm_flock.llm._frame import Q
from llm_flock.llm._letters import NO_WISH, ways_of, ways_text
from llm_flock.llm._prompt_values import (
    MISSION,
    nearer_goal,
    nearest_text,
    place_text,
    plan_text,
    position_decimals,
    position_text,
    positions_text,
    short_text,
)
from llm_flock.mission import Mission, build_mission
from llm_flock.plan import DECIMALS, Plan
from llm_flock.planner import AIMS, JudgementOption, JudgementQuestion, PlanQuestion, StepQuestion

logger = logging.getLogger(__name__)

PACKAGED: Mapping[str, str] = {
    "full": "prompts",
    "brief": "prompts/brief",
    "letters": "prompts/letters",
    "program": "prompts/program",
    "brief-program": "prompts/brief-program",
}
"""Packaged sets of templates, and their folders; templates that are not there are those of `full`.

`brief-program` takes them from `brief` first.
"""

PROGRAMS = ("program", "brief-program")  # the packaged sets that ask for a plan as a formation program
LETTERS = "letters"  # the packaged set that asks for the letter of one of the computed ways, and for no plan

COMMON = frozenset({"json", "wish", *MISSION})
OBSERVED: Mapping[str, Callable[[PlanQuestion | StepQuestion], Any]] = {
    "robot": lambda asked: asked.robot,
    "round": lambda asked: asked.round,
    "position": lambda asked: position_text(asked.position, _decimals(asked)),
    "neighbors": lambda asked: positions_text(asked.neighbors, _decimals(asked)),
    "here": lambda asked: short_text(asked.position, _decimals(asked)),
    "near": lambda asked: nearest_text(asked.position, asked.neighbors, asked.mission),
}
PLAN: Mapping[str, Callable[[PlanQuestion], Any]] = {
    **OBSERVED,
    "still": lambda asked: positions_text(asked.still, _decimals(asked)),
    "program_schema": lambda _: _program_schema(),
}
STEP: Mapping[str, Callable[[StepQuestion], Any]] = {
    **OBSERVED,
    "plan": lambda asked: plan_text(asked.plan),
    "slot": lambda asked: asked.slot,
    "cornering": lambda asked: asked.corner is not None,
    "searching": lambda asked: asked.target is not None and asked.slot is not None,
    "waiting": lambda asked: asked.slot is None,
    "goal": lambda asked: place_text(asked.goal),
    "toward": lambda asked: short_text(nearer_goal(asked.position, asked.goal, asked.mission.max_step), DECIMALS),
    "horizon": lambda asked: asked.horizon,
    "ways": lambda asked: ways_text(ways_of(asked)),
}
JUDGEMENT: Mapping[str, Callable[[JudgementQuestion], Any]] = {
    "robot": lambda asked: asked.robot,
    "round": lambda asked: asked.round,
    "event": lambda asked: asked.event,
    "options": lambda asked: options_text(asked.options),
    "choices": lambda asked: ", ".join(option.choice for option in asked.options),
}
"""Variables of a question, with the functions that write them."""

VARIABLES: Mapping[str, frozenset[str]] = {
    "system.j2": COMMON,
    "plan.j2": COMMON.union(PLAN),
    "step.j2": COMMON.union(STEP),
    "judgement.j2": COMMON.union(JUDGEMENT, {"aim"}),
    "retry.j2": frozenset({"json", "reason", "kind", "horizon", "point_format", "plan_format"}),
}
"""The templates, and the variables that each may use."""


AIM = next(iter(AIMS))  # the aim of a judgement where the operator wishes nothing

NOT_FLOWN = "Your last answer is not flown."
"""Begins what is added to the question for a step when it is asked again in the same round."""


_FAILURES = (ArithmeticError, LookupError, TypeError, ValueError, AttributeError, RecursionError, MemoryError)
"""How an expression in a template may fail."""


@lru_cache(maxsize=1)
def _program_schema() -> str:
    from llm_flock.formation import program_schema

    return json.dumps(program_schema(), separators=(",", ":"))


def _decimals(asked: PlanQuestion | StepQuestion) -> int:
    return position_decimals(asked.mission.max_step)


@dataclass(frozen=True, slots=True, kw_only=True)
class PromptSet:
    """Five templates, compiled and checked."""

    json: bool  #: Whether they ask for a JSON object instead of the paper's text forms.
    reasons: bool = True  #: Whether they ask for a reason before the answer.
    letters: bool = False  #: Whether they ask for a letter instead of a position, and for no plan.
    programs: bool = False  #: Whether they ask for a formation program instead of the places of a plan.
    wish: str = ""  #: The operator's wish about the steps, empty without one.
    templates: Mapping[str, tuple[jinja2.Template, frozenset[str]]]  #: Each with the variables that it may use.

    @classmethod
    def load(cls, prompts: str | Path = "full", *, json: bool = False, wish: str = "") -> Self:
        """A packaged set by its name, or the operator's folder, whose templates replace those of `full`.

        Raises:
            InputError: for field `prompts`: no such folder, none of the templates in it, or a template that cannot be
                used (syntax, unknown variable, failure on an example), with its file.
        """
        if isinstance(prompts, str) and prompts in PACKAGED:
            letters = prompts == LETTERS
            if letters and json:
                raise InputError("answers", "json", "text: the prompts 'letters' ask for one letter")
            reasons, programs = prompts in ("full", "program"), prompts in PROGRAMS
            templates = _packaged(prompts)
            return cls(json=json, reasons=reasons, letters=letters, programs=programs, wish=wish, templates=templates)
        folder = Path(prompts)
        try:
            replaced = [name for name in VARIABLES if (folder / name).is_file()]
        except OSError:  # its name is too long for a folder
            replaced = []
        if not replaced:
            raise InputError("prompts", str(folder), f"a folder with at least one of {', '.join(VARIABLES)}")
        logger.info("prompt templates from %s: %s", folder, ", ".join(replaced))
        loaded = cls(json=json, wish=wish, templates=_templates("full", folder))
        loaded._try_out()
        return loaded

    def system(self, mission: Mission) -> str:
        """The system message: the same text for every robot of the team."""
        return self._render("system.j2", _mission_values(mission))

    def plan(self, question: PlanQuestion) -> str:
        """The plan generation message."""
        return self._question("plan.j2", PLAN, question)

    def step(self, question: StepQuestion) -> str:
        """The position update message."""
        return self._question("step.j2", STEP, question)

    def judgement(self, question: JudgementQuestion) -> str:
        """The question what to do about an event; its order or the operator's wish says what counts."""
        if question.words:
            return replace(self, wish=question.words).judgement(replace(question, words=""))
        return self._question("judgement.j2", JUDGEMENT, question)

    def retry(self, reason: str, question: PlanQuestion | StepQuestion | JudgementQuestion) -> str:
        """The message after an unusable answer to this question; `reason` is a sentence."""
        if isinstance(question, JudgementQuestion):
            return f"This answer cannot be used: {reason}\n\n{self.judgement(question)}"
        step = isinstance(question, StepQuestion)
        own = {"reason": reason, "kind": "step" if step else "plan", "horizon": question.horizon if step else 1}
        return self._render("retry.j2", {**_mission_values(question.mission), **own})

    def _question(self, name: str, known: Mapping[str, Callable[[Q], Any]], question: Q) -> str:
        """Write only the variables that the template uses, to save time: every robot asks in every round."""
        uses = self.templates[name][1]
        own = {variable: write(question) for variable, write in known.items() if variable in uses}
        return self._render(name, {**_mission_values(question.mission), **own})

    def _render(self, name: str, variables: Mapping[str, Any]) -> str:
        template = self.templates[name][0]
        try:
            return template.render(variables, json=self.json, wish=self.wish or NO_WISH, aim=self.wish or AIM).strip()
        except (jinja2.TemplateError, *_FAILURES) as error:
            allowed = f"a template that can be rendered: {error}"
            raise InputError("prompts", template.filename or name, allowed) from None

    def _try_out(self) -> None:
        """Render everything once, so that a faulty template fails before a run begins."""
        mission = build_mission(shape="triangle", n_robots=3)
        here, there = (40.0, 40.0), ((45.0, 40.0),)
        plan = Plan.of(mission.ideal or ())
        self.system(mission)
        asked = PlanQuestion(mission=mission, robot=0, round=1, position=here, neighbors=there, still=there)
        self.plan(asked)
        step = StepQuestion(mission=mission, robot=0, round=1, position=here, neighbors=there, plan=plan, slot=0)
        for question in (step, replace(step, horizon=2)):
            self.step(question)
            self.retry("the answer is an example.", question)
        self.retry("the answer is an example.", asked)
        option = JudgementOption(choice="leave", does="Leave it.", rounds=0, distance=0.0, gaps=1)
        self.judgement(JudgementQuestion(mission=mission, robot=0, round=1, event="Wind.", options=(option,)))


@lru_cache(maxsize=64)
def _mission_values(mission: Mission) -> Mapping[str, Any]:
    """Variables of every message. Cached for 64 missions: a moving centre gives another mission in each round."""
    return {name: write(mission) for name, write in MISSION.items()}


def _templates(packaged: str, folder: Path | None = None) -> Mapping[str, tuple[jinja2.Template, frozenset[str]]]:
    """Every template, compiled and checked: the operator's if there is one, else the packaged one."""
    folders: list[jinja2.BaseLoader] = []
    if folder is not None:
        for name in VARIABLES:  # a link would send a file of the user's to a model
            if not (folder / name).resolve().is_relative_to(folder.resolve()):
                raise InputError("prompts", str(folder / name), "a file of its folder, no link out of it")
        folders = [jinja2.FileSystemLoader(folder)]
    chain = (packaged, "brief", "full") if packaged == "brief-program" else (packaged, "full")
    # Templates may come from strangers. In the sandbox they can only make text.
    environment = SandboxedEnvironment(
        loader=jinja2.ChoiceLoader(
            [*folders, *(jinja2.PackageLoader("llm_flock.llm", PACKAGED[name]) for name in chain)]
        ),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return {name: _compile(environment, name, folder) for name in VARIABLES}


_packaged = lru_cache(maxsize=len(PACKAGED))(_templates)


def _compile(environment: jinja2.Environment, name: str, folder: Path | None) -> tuple[jinja2.Template, frozenset[str]]:
    """A template and the variables that it uses; InputError for wrong syntax or an unknown variable."""
    assert environment.loader is not None
    file = name if folder is None else str(folder / name)
    try:
        source, filename, _ = environment.loader.get_source(environment, name)
        file = filename or file
        template = environment.get_template(name)
        parsed = environment.parse(source, name, filename)
        used = jinja2.meta.find_undeclared_variables(parsed)
        others = list(jinja2.meta.find_referenced_templates(parsed))
    except jinja2.TemplateSyntaxError as error:
        where = f"{error.filename or file}, line {error.lineno}"
        raise InputError("prompts", where, f"a Jinja template: {error.message}") from None
    except (jinja2.TemplateError, OSError, UnicodeDecodeError) as error:
        raise InputError("prompts", file, f"a readable text file in UTF-8: {error}") from None
    unknown = sorted(used - VARIABLES[name])
    if unknown:
        known = ", ".join(sorted(VARIABLES[name]))
        raise InputError("prompts", file, f"a template of the variables {known}; not {', '.join(unknown)}")
    # The variables of included templates are not known.
    return template, VARIABLES[name] if others else frozenset(used)
