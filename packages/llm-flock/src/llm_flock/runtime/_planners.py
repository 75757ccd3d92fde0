"""One planner per robot: language models, a replayed conversation, or plain geometry."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from llm_flock.errors import InputError
from llm_flock.llm._limits import LONGEST_S, Budget, BudgetMeter, CallLane, CallLimits, Limited, RetryPolicy
from llm_flock.llm._models import ModelPool, check_priced, parse_history, parse_models, parse_settings
from llm_flock.llm._port import Attempt, AttemptSink, LanguageModel
from llm_flock.llm._providers import ModelName, habits_of, parse_base_urls, parse_model, source_of
from llm_flock.planner import PlanAnswer, Planner, PlanQuestion, StepAnswer, StepQuestion
from llm_flock.runtime._config import RunConfig
from llm_flock.runtime._schedule import Stream, stream

if TYPE_CHECKING:
    from llm_flock.llm._own import OwnModel
    from llm_flock.llm._prompting import PromptSet
    from llm_flock.llm._replay import ReplayModel  # each kind of model is imported where a robot asks one
    from llm_flock.protocol._verification.steps import Verdict


class TeamPlanners:
    """The planners of a team, by robot, with the connections, budget and listeners that they share.

    A `lane` is access to limits and connections shared with other runs. `own` are models given as objects, by robot,
    -1 for all robots.

    Raises:
        InputError: a model cannot work, as far as is known before any question.
    """

    def __init__(
        self, config: RunConfig, lane: CallLane | None = None, own: Mapping[int, OwnModel] | None = None
    ) -> None:
        model, limits, n = config.model, config.limits, config.mission.n_robots
        self.names = parse_models(model.model, n)
        self._config = config
        self._lane = lane or CallLane()
        self._pool = self._lane.pool or ModelPool()
        self._replaced: dict[int, str] = {}
        self._sinks: list[AttemptSink] = []
        self._replays: dict[str, ReplayModel] = {}
        self._own: dict[str, OwnModel] = {}
        self._given = dict(own or {})
        self._queues: dict[str, CallLimits] = {}
        self._prompts: dict[str, PromptSet] = {}
        self._around: list[Callable[[int, Planner], Planner]] = []
        self._meter = BudgetMeter(
            Budget(max_calls=limits.max_calls, max_tokens=limits.max_tokens, max_cost_usd=limits.max_cost)
        )
        self._base_urls = parse_base_urls(model.base_url, self.names)
        check_priced(limits.max_cost, self.names, self._base_urls)
        self._settings = parse_settings(
            n,
            temperature=model.temperature,
            seed=model.model_seed,
            reasoning=model.reasoning_effort,
            max_tokens=limits.max_answer_tokens,
        )
        self._wish = model.wish or ""
        if self._wish:
            from llm_flock.llm._letters import check_wish

            self._wish = check_wish(self._wish)
        for text in dict.fromkeys(self.names):
            # Chosen prompts are checked, even if no model is asked.
            if model.prompts or self._wish or parse_model(text).kind != "geometry":
                self._prompts_of(text)
        self._history = parse_history(model.history)
        self._planners = [self._planner_of(robot, text) for robot, text in enumerate(self.names)]

    @property
    def _patient(self) -> bool:
        """Whether nobody said how long an answer may take."""
        return "timeout_s" not in self._config.limits.model_fields_set

    def _prompts_of(self, text: str) -> PromptSet:
        if text in self._prompts:
            return self._prompts[text]
        from llm_flock.llm._prompting import PromptSet

        model, wish = self._config.model, self._wish
        words = model.prompts or habits_of(text).prompts
        prompts = PromptSet.load(words, json=model.answers == "json", wish=wish)
        if wish and words in ("full", "brief", "program", "brief-program") and self._config.protocol.judge == "rule":
            allowed = f"no wish with the prompts {words!r}, which name it in judgements only: use 'letters' or judge"
            raise InputError("wish", wish, allowed)
        if parse_model(text).kind == "simulated":
            from llm_flock.llm._simulated.prompt_reader import check_prompts

            check_prompts(prompts, self._config.mission)
        self._prompts[text] = prompts
        return prompts

    def _queue_of(self, name: ModelName) -> CallLimits:
        """The limits of a model. Questions wait for a plug-in in a queue of its own, before their time-out begins."""
        queue, limits = name.provider if name.kind == "plugin" else "", self._config.limits
        if queue not in self._queues:
            at_once = min(limits.max_concurrent, source_of(queue).at_once) if queue else limits.max_concurrent
            self._queues[queue] = CallLimits(
                max_concurrent=at_once,
                timeout_s=limits.timeout_s,
                patient=self._patient,
                retry=RetryPolicy(max_tries=limits.max_tries),
                meter=self._meter,
                lane=self._lane,
                rng=stream(self._config.trial.seed, Stream.BACKOFF),
            )
        return self._queues[queue]

    def _model_of(self, robot: int, name: ModelName) -> LanguageModel:
        if name.kind == "replay":
            from llm_flock.llm._replay import ReplayModel

            if name.text not in self._replays:
                self._replays[name.text] = ReplayModel(Path(name.model))
            return self._replays[name.text]
        if name.kind == "own" and self._pool.asks:
            return Limited(self._own_model(robot, name.text), self._queue_of(name))
        model = self._pool.model(
            name.text,
            rng=stream(self._config.trial.seed, Stream.MODEL, 0 if "alike" in name.model else robot),
            settings=self._settings[robot],
            base_urls=self._base_urls,
            typed=self._config.model.typed_url is not None,
            timeout_s=2 * (LONGEST_S if self._patient else self._config.limits.timeout_s),
        )
        return Limited(model, self._queue_of(name))

    def _planner_of(self, robot: int, text: str) -> Planner:
        planner = self._asking(robot, parse_model(text))
        for around in self._around:
            planner = around(robot, planner)
        return planner

    def _asking(self, robot: int, name: ModelName) -> Planner:
        from llm_flock.protocol._geometry import GeometryPlanner, KnownPlans

        if name.kind == "geometry":
            return GeometryPlanner(stream(self._config.trial.seed, Stream.MODEL, robot))
        from llm_flock.llm._planner import LanguagePlanner

        config, habits, prompts = self._config, habits_of(name.text), self._prompts_of(name.text)
        model, knows, verify = self._model_of(robot, name), habits.plans, bool(config.protocol.verify)
        if name.kind == "replay" and any(habits_of(asked).plans for asked in self._replays[name.text].models):
            knows = self._replays[name.text].was_asked
        planner = LanguagePlanner(
            robot,
            model,
            prompts,
            max_retries=config.model.max_retries,
            history=self._history,
            on_attempt=self._notify,
            check_plan=_check_plan if verify else None,
            judge=self._judge if verify else None,
            clips=config.protocol.fallback != "hold",
            frame=config.model.frame or habits.frame,
        )
        return planner if knows is None else KnownPlans(planner, knows)

    def _judge(self, question: StepQuestion, answer: StepAnswer) -> Verdict:
        from llm_flock.protocol._verification.steps import judge

        return judge(question, answer, shield_on=bool(self._config.protocol.shield))

    def __getitem__(self, robot: int) -> Planner:
        return self._planners[robot]

    def model_of(self, robot: int) -> str:
        """Name of the model that a robot asks now."""
        return self._replaced.get(robot, self.names[robot])

    def wrap(self, around: Callable[[int, Planner], Planner]) -> None:
        """Replace each planner, also those made later, by `around(robot, planner)`."""
        self._around.append(around)
        self._planners = [around(robot, planner) for robot, planner in enumerate(self._planners)]

    def replace(self, robot: int, model: str) -> None:
        """Give a robot another model from its next question on. InputError if there is no such model."""
        self._replaced[robot] = model
        self._planners[robot] = self._planner_of(robot, model)

    def _own_model(self, robot: int, text: str) -> OwnModel:
        """The object given for the robot, or the one shared by all robots that name its class."""
        given = self._given.get(robot, self._given.get(-1))
        if given is not None and given.name == text:
            return given
        if text not in self._own:
            from llm_flock.llm._own import OwnModel

            self._own[text] = OwnModel.load(text)
        return self._own[text]

    @property
    def simulated(self) -> bool:
        """Whether any answer comes from a simulated stand-in, now or when it was recorded."""
        return (
            any(habits_of(name).simulated for name in self.names)
            or any(replay.simulated for replay in self._replays.values())
            or any(own.simulated for own in self._own_models)
        )

    @property
    def _own_models(self) -> Sequence[OwnModel]:
        return [*self._own.values(), *dict.fromkeys(self._given.values())]

    @property
    def unrepeatable(self) -> list[str]:
        """Sentences on models that a record's configuration cannot repeat."""
        return [own.unrepeatable for own in self._own_models]

    @property
    def weights(self) -> Mapping[str, str]:
        """Digests of the files of plug-ins' models, by name."""
        names = [name for name in map(parse_model, dict.fromkeys(self.names)) if name.kind == "plugin"]
        digests = [source_of(name.provider).versions(name.model) for name in names]
        return {file: digest for files in digests for file, digest in files.items()}

    @property
    def exhausted(self) -> bool:
        """Whether the run's budget, the one that it shares, or that of a recorded run is used up."""
        used_up = self._lane.cut or self._meter.reason is not None
        return used_up or any(replay.exhausted for replay in self._replays.values())

    def listen(self, sink: AttemptSink) -> None:
        """Pass every model call from now on to `sink`."""
        self._sinks.append(sink)

    def _notify(self, attempt: Attempt) -> None:
        for sink in self._sinks:
            sink(attempt)

    async def close(self) -> None:
        """Close connections and cassettes."""
        if self._lane.pool is None:
            await self._pool.aclose()
        for replay in self._replays.values():
            replay.close()
        for own in self._own.values():
            await own.aclose()


def _check_plan(question: PlanQuestion, answer: PlanAnswer) -> str | None:
    from llm_flock.protocol._verification.plans import check_proposal

    return check_proposal(question.mission, answer.plan, question.still, question.position)


def check_planners(config: RunConfig, *, asks: bool = True) -> None:
    """Raise the error of a run whose models cannot work. Call where no event loop runs.

    If its models will not be asked (`asks`), providers need neither a key nor their library, and no class is imported.
    """
    lane = None if asks else CallLane(pool=ModelPool(asks=False))
    asyncio.run(TeamPlanners(config, lane).close())
