"""One planner per robot: language models, a replayed conversation, or plain geometry."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from llm_flock.errors import InputError
from llm_flock.llm._limits import Budget, BudgetMeter, CallLimits, Limited, RetryPolicy
from llm_flock.llm._models import ModelPool, check_priced, parse_history, parse_models, parse_settings
from llm_flock.llm._port import Attempt, AttemptSink, LanguageModel
from llm_flock.llm._providers import ModelName, parse_base_urls, parse_model
from llm_flock.protocol._planning import PlanAnswer, Planner, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.runtime._config import RunConfig
from llm_flock.runtime._schedule import Stream, stream

if TYPE_CHECKING:
    from llm_flock.llm._own import OwnModel
    from llm_flock.llm._prompting import PromptSet
    from llm_flock.llm._replay import ReplayModel  # each kind of model is imported where a robot asks one
    from llm_flock.llm._sharing import CallLane
    from llm_flock.protocol._verification.steps import Verdict


class TeamPlanners:
    """The planners of a team, by robot, with the connections, budget and listeners that they share.

    A `lane` is access to what this run shares with others; `own` are models that were handed over as objects, by
    robot, -1 for all robots.

    Raises:
        InputError: a model cannot work, as far as that is known before asking it.
    """

    def __init__(
        self, config: RunConfig, lane: CallLane | None = None, own: Mapping[int, OwnModel] | None = None
    ) -> None:
        model, limits, n = config.model, config.limits, config.mission.n_robots
        self.names = parse_models(model.model, n)
        self._replaced: dict[int, str] = {}
        self._sinks: list[AttemptSink] = []
        self._replays: dict[str, ReplayModel] = {}
        self._own: dict[str, OwnModel] = {}
        self._handed = dict(own or {})
        self._meter = BudgetMeter(
            Budget(max_calls=limits.max_calls, max_tokens=limits.max_tokens, max_cost_usd=limits.max_cost)
        )
        base_urls = parse_base_urls(model.base_url, self.names)
        check_priced(limits.max_cost, self.names, base_urls)
        self._lane = lane
        self._shares = lane is not None and lane.pool is not None
        self._pool = (lane and lane.pool) or ModelPool()
        seed = config.trial.seed

        def limits_of(at_once: int) -> CallLimits:
            return CallLimits(
                max_concurrent=min(limits.max_concurrent, at_once),
                timeout_s=limits.timeout_s,
                retry=RetryPolicy(max_tries=limits.max_tries),
                meter=self._meter,
                gate=lane,
                rng=stream(seed, Stream.BACKOFF),
            )

        # A question waits for a plug-in's model before its time-out begins, in a queue that delays no other model.
        self._limits = limits_of(limits.max_concurrent)
        queues: dict[str, CallLimits] = {}

        def limits_for(name: ModelName) -> CallLimits:
            if name.kind != "plugin":
                return self._limits
            from llm_flock.llm._sources import source_of

            if name.provider not in queues:
                queues[name.provider] = limits_of(source_of(name.provider).at_once)
            return queues[name.provider]

        settings = parse_settings(
            n,
            temperature=model.temperature,
            seed=model.model_seed,
            reasoning=model.reasoning_effort,
            max_tokens=limits.max_answer_tokens,
        )

        wish = model.wish or ""
        if wish:
            from llm_flock.llm._letters import check_wish

            wish = check_wish(wish)

        def prompts_of(text: str) -> PromptSet:
            from llm_flock.llm._prompting import PromptSet
            from llm_flock.llm._sources import habits_of

            words = model.prompts or habits_of(text).prompts
            prompts = PromptSet.load(words, json=model.answers == "json", wish=wish)
            if wish and words in ("full", "brief"):
                raise InputError(
                    "wish", wish, f"no wish with the prompts {words!r}, which do not name it: use 'letters'"
                )
            if parse_model(text).kind == "simulated":
                from llm_flock.llm._simulated.prompt_reader import check_prompts

                check_prompts(prompts, config.mission)
            return prompts

        given = bool(model.prompts or wish)  # then they are checked, even if nobody is asked
        asked_by = [text for text in dict.fromkeys(self.names) if given or parse_model(text).kind != "geometry"]
        self._prompts = {text: prompts_of(text) for text in asked_by}
        history = parse_history(model.history)
        shield_on, verify = bool(config.protocol.shield), bool(config.protocol.verify)

        def check_plan(question: PlanQuestion, answer: PlanAnswer) -> str | None:
            from llm_flock.protocol._verification.plans import check_proposal

            return check_proposal(question.mission, answer.plan, question.still, question.position)

        def judged(question: StepQuestion, answer: StepAnswer) -> Verdict:
            from llm_flock.protocol._verification.steps import judge

            return judge(question, answer, shield_on=shield_on)

        def planner_of(robot: int, text: str) -> Planner:
            rng = stream(seed, Stream.MODEL, robot)
            name = parse_model(text)
            if name.kind == "geometry":
                from llm_flock.protocol._geometry import GeometryPlanner

                return GeometryPlanner(rng)
            from llm_flock.llm._sources import habits_of

            knows = habits_of(text).plans
            asked: LanguageModel
            if name.kind == "replay":
                from llm_flock.llm._replay import ReplayModel

                if text not in self._replays:
                    self._replays[text] = ReplayModel(Path(name.model))
                asked = replay = self._replays[text]
                if any(habits_of(model).plans for model in replay.models):
                    knows = replay.was_asked
            elif name.kind == "own":
                asked = Limited(self._own_model(robot, text), self._limits)
            else:
                remote = self._pool.model(
                    text, rng=rng, settings=settings[robot], base_urls=base_urls, timeout_s=2 * limits.timeout_s
                )
                asked = Limited(remote, limits_for(name))
            prompts = self._prompts[text]
            from llm_flock.llm._planner import LanguagePlanner

            kind = LanguagePlanner
            if prompts.letters:
                from llm_flock.llm._letter_planner import LetterPlanner

                kind = LetterPlanner
            planner = kind(
                robot,
                asked,
                prompts,
                max_retries=model.max_retries,
                history=history,
                on_attempt=self._notify,
                check_plan=check_plan if verify else None,
                judge=judged if verify else None,
                clips=config.protocol.fallback != "hold",
                frame=model.frame or habits_of(text).frame,
            )
            if knows is None:
                return planner
            from llm_flock.protocol._geometry import KnownPlans

            return KnownPlans(planner, knows)

        self._planner_of: Callable[[int, str], Planner] = planner_of
        self._prompts_of = prompts_of
        self._planners = [planner_of(robot, text) for robot, text in enumerate(self.names)]

    def __getitem__(self, robot: int) -> Planner:
        return self._planners[robot]

    def model_of(self, robot: int) -> str:
        """Name of the model that a robot asks now."""
        return self._replaced.get(robot, self.names[robot])

    def wrap(self, around: Callable[[int, Planner], Planner]) -> None:
        """Wrap every planner in another one, made from a robot's id and its planner; also planners made later."""
        inner = self._planner_of
        self._planner_of = lambda robot, text: around(robot, inner(robot, text))
        self._planners = [around(robot, planner) for robot, planner in enumerate(self._planners)]

    def replace(self, robot: int, model: str) -> None:
        """Give a robot another model from its next question on; `InputError` if there is no such model."""
        self._replaced[robot] = model
        if model not in self._prompts and parse_model(model).kind != "geometry":
            self._prompts[model] = self._prompts_of(model)
        self._planners[robot] = self._planner_of(robot, model)

    def _own_model(self, robot: int, text: str) -> OwnModel:
        """The object that was handed over, or the one that all robots share which name its class."""
        handed = self._handed.get(robot, self._handed.get(-1))
        if handed is not None and handed.name == text:
            return handed
        if text not in self._own:
            from llm_flock.llm._own import OwnModel

            self._own[text] = OwnModel.load(text)
        return self._own[text]

    @property
    def simulated(self) -> bool:
        """Whether any answer comes from a simulated stand-in, now or when it was recorded."""
        from llm_flock.llm._sources import habits_of

        return (
            any(habits_of(name).simulated for name in self.names)
            or any(replay.simulated for replay in self._replays.values())
            or any(own.simulated for own in self._own_models)
        )

    @property
    def _own_models(self) -> Sequence[OwnModel]:
        return [*self._own.values(), *dict.fromkeys(self._handed.values())]

    @property
    def unrepeatable(self) -> list[str]:
        """What of the models a record's configuration cannot repeat, in sentences."""
        return [own.unrepeatable for own in self._own_models]

    @property
    def weights(self) -> Mapping[str, str]:
        """Digests of the files of plug-ins' models, by name."""
        names = [name for name in map(parse_model, dict.fromkeys(self.names)) if name.kind == "plugin"]
        if not names:
            return {}
        from llm_flock.llm._sources import source_of

        found = [source_of(name.provider).versions(name.model) for name in names]
        return {file: digest for files in found for file, digest in files.items()}

    @property
    def exhausted(self) -> bool:
        """Whether the run's budget, the one that it shares, or that of a recorded run is used up."""
        shared = self._lane is not None and self._lane.cut
        return shared or self._meter.reason is not None or any(replay.exhausted for replay in self._replays.values())

    def listen(self, sink: AttemptSink) -> None:
        """Pass every model call from now on to `sink`."""
        self._sinks.append(sink)

    def _notify(self, attempt: Attempt) -> None:
        for sink in self._sinks:
            sink(attempt)

    async def close(self) -> None:
        """Close connections and cassettes."""
        if not self._shares:
            await self._pool.aclose()
        for replay in self._replays.values():
            replay.close()
        for own in self._own.values():
            await own.aclose()


def check_planners(config: RunConfig, *, asks: bool = True) -> None:
    """Refuse a configuration whose models cannot work, as a run of it would. Call where no event loop runs.

    Args:
        config: the run.
        asks: whether its models will be asked. Without that, providers need neither a key nor their library.

    Raises:
        InputError: a model cannot work, as far as that is known before asking it.
    """
    from llm_flock.llm._sharing import CallLane

    lane = None if asks else CallLane(pool=ModelPool(asks=False))
    asyncio.run(TeamPlanners(config, lane).close())
