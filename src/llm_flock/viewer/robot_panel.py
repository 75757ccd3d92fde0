"""What one robot knew and asked in a round. Everything is set as text: no answer of a model can become markup."""

from __future__ import annotations

from nicegui import ui

from llm_flock.record.schema import LlmEntry
from llm_flock.record.words import verdict
from llm_flock.viewer.recording import Recording

MOST_CLAIMS = 30


def show_robot(run: Recording, robot: int, number: int) -> None:
    """Show a robot's plan, its conversation with its model, and the claims it heard in a round."""
    state = run.states[number]
    with ui.element("article").classes("flock-mind"):
        ui.label(f"Robot {robot} · round {number}").classes("flock-subtitle")
        slot = "no place" if state.slots[robot] is None else f"place {state.slots[robot]}"
        ui.label(
            f"plan {run.plan_name(state.plan_ids[robot])} · {slot} · influence {state.influence[robot]:.2f} · "
            f"{state.phases[robot].replace('_', ' ')} · moved by {state.origins[robot]}"
        ).classes("flock-facts")
        _breakers(run, robot, number)
        _conversation(run, robot, number)
        _provenance(run, robot, number)
        _claims(run, robot, number)


def _breakers(run: Recording, robot: int, number: int) -> None:
    for sentence in run.breakers(number, robot):
        with ui.row().classes("flock-verdict"):
            ui.icon("electrical_services", color="warning").props('aria-label="circuit breaker open"')
            ui.label(sentence[0].upper() + sentence[1:]).classes("flock-said")


def _conversation(run: Recording, robot: int, number: int) -> None:
    calls = run.calls(number, robot)
    if not calls:
        before = run.last_call(number, robot)
        ui.label(
            "Its model has not been asked yet." if before is None else f"Its model was last asked in round {before}."
        ).classes("flock-hint")
        if before is not None:
            ui.button(f"Go to round {before}").props("flat dense no-caps").on(
                "click", js_handler=f"() => flockClock('main').seek({before})"
            )
        return
    for entry in calls:
        _call(entry)


def _call(entry: LlmEntry) -> None:
    with ui.element("section").classes("flock-call"):
        probe = " · probe" if entry.probe else ""
        ui.label(f"{entry.kind} · try {entry.attempt + 1}{probe}").classes("flock-call-title")
        ui.label(entry.model.replace(",", ", ")).classes("flock-hint")
        prompt = ui.expansion(f"Prompt ({len(entry.messages)} messages)").props("dense").classes("flock-prompt")

        def unfold(entry: LlmEntry = entry) -> None:
            # Conversations are long: they are sent when they are opened.
            if prompt.value and not prompt.default_slot.children:
                with prompt:
                    for message in entry.messages:
                        ui.label(message.role).classes("flock-role")
                        ui.label(message.text).classes("flock-said")

        prompt.on_value_change(unfold)
        if entry.text is not None:
            ui.label("answer").classes("flock-role")
            ui.label(entry.text).classes("flock-said flock-answer")
        used = entry.rejected is None and entry.error is None
        with ui.row().classes("flock-verdict"):
            ui.icon("check_circle" if used else "cancel", color="positive" if used else "negative").props(
                f'aria-label="{"used" if used else "not used"}"'
            )
            ui.label(verdict(entry)).classes("flock-said")
        ui.label(_price(entry)).classes("flock-hint")


def _provenance(run: Recording, robot: int, number: int) -> None:
    steps = run.provenance(robot, number)
    if not steps:
        return
    ui.label("Provenance of its plan").classes("flock-role")
    words = [
        f"robot {step.robot} {'proposed' if step.source is None else 'took'} it (round {step.round})"
        + (", made by geometry" if step.by == "geometry" else "")
        for step in steps
    ]
    ui.label(" → ".join(words)).classes("flock-facts")


def _claims(run: Recording, robot: int, number: int) -> None:
    found = run.claims_heard(robot, number)
    ui.label(f"Claims within its radio range ({len(found)})").classes("flock-role")
    rows = [
        {
            "robot": claim.robot,
            "plan": claim.plan,
            "place": "-" if claim.slot is None else claim.slot,
            "influence": f"{claim.influence:.2f}",
            "distance": f"{claim.distance:.1f}" + (" · wants the same place" if claim.rival else ""),
        }
        for claim in found[:MOST_CLAIMS]
    ]
    columns = [
        {"name": name, "label": name, "field": name, "align": "left"}
        for name in ("robot", "plan", "place", "influence", "distance")
    ]
    ui.table(rows=rows, columns=columns, row_key="robot").props("dense flat hide-pagination").classes("flock-table")


def _price(entry: LlmEntry) -> str:
    """Tokens, time, money and faults of a call."""
    cached = f" ({entry.usage.cached} cached)" if entry.usage.cached else ""
    cost = f" · ${entry.cost_usd:.4f}" if entry.cost_usd else ""
    faults = f" · {', '.join(entry.faults)}" if entry.faults else ""
    return f"{entry.usage.input} tokens in{cached}, {entry.usage.output} out · {entry.latency_s:.2f} s{cost}{faults}"
