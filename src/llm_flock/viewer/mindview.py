"""A robot's mind on the page. All words are set as text, so that nothing a model says can become markup."""

from __future__ import annotations

from nicegui import ui

from llm_flock.record.schema import LlmEntry
from llm_flock.record.words import verdict
from llm_flock.viewer.mind import claims, price, provenance
from llm_flock.viewer.reel import Reel

MOST_CLAIMS = 30


def show_mind(reel: Reel, robot: int, number: int) -> None:
    """What one robot knew, asked and was answered in a round."""
    state = reel.states[number]
    with ui.element("article").classes("flock-mind").mark(f"mind-{robot}"):
        ui.label(f"Robot {robot} · round {number}").classes("flock-subtitle")
        slot = "no place" if state.slots[robot] is None else f"place {state.slots[robot]}"
        ui.label(
            f"plan {reel.plan_name(state.plan_ids[robot])} · {slot} · influence {state.influence[robot]:.2f} · "
            f"{state.phases[robot].replace('_', ' ')} · moved by {state.origins[robot]}"
        ).classes("flock-facts")
        _conversation(reel, robot, number)
        _provenance(reel, robot, number)
        _claims(reel, robot, number)


def _conversation(reel: Reel, robot: int, number: int) -> None:
    calls = reel.calls(number, robot)
    if not calls:
        before = reel.last_call(number, robot)
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
        ui.label(f"{entry.kind} · try {entry.attempt + 1}").classes("flock-call-title")
        ui.label(entry.model.replace(",", ", ")).classes("flock-hint")
        prompt = ui.expansion(f"Prompt ({len(entry.messages)} messages)").props("dense").classes("flock-prompt")

        def unfold(entry: LlmEntry = entry) -> None:
            # Long conversations are sent when somebody wants to read them.
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
            ui.label(verdict(entry)).classes("flock-said flock-judged")
        ui.label(price(entry)).classes("flock-hint")


def _provenance(reel: Reel, robot: int, number: int) -> None:
    way = provenance(reel, robot, number)
    if not way:
        return
    ui.label("Provenance of its plan").classes("flock-role")
    words = [
        f"robot {step.robot} {'proposed' if step.source is None else 'took'} it (round {step.round})" for step in way
    ]
    ui.label(" → ".join(words)).classes("flock-facts")


def _claims(reel: Reel, robot: int, number: int) -> None:
    found = claims(reel, robot, number)
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
