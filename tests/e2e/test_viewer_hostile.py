"""Text from a model, a peer or a file stays text on the viewer's pages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page, expect
from sample_records import FakeRun, llm_entry
from viewer_pages import at, go, page_at, ready, viewer

from llm_flock.record._schema import (
    Entry,
    LlmEntry,
    MissionInfo,
    PlanInfo,
    ProtocolEvent,
    RunInfo,
    State,
    SummaryMessage,
)
from llm_flock.record._writer import RecordWriter

HOSTILE = (
    "<script>window.broken = 1</script><img src=x onerror='window.broken = 2'> {{ 1 + 1 }} ${window.broken = 3} "
    "`${window.broken = 4}` </script><iframe src='//elsewhere.invalid/'></iframe> [a](javascript:window.broken=5) "
    '" onmouseover="window.broken=8" x=\' autofocus onfocus=window.broken=9 --><svg onload=window.broken=10> '
    "<style>*{display:none}</style> &lt;b&gt; \\u003cscript> </title></textarea></noscript> ' + (window.broken=11) + '"
)
TURNED = HOSTILE + " \u202eand turned around\u2066 \u200bhidden\u2028next"
SHOWN = HOSTILE + " \\u202eand turned around\\u2066 \\u200bhidden\\u2028next"


def test_hostile_words_stay_words(tmp_path: Path, browser: Browser) -> None:
    folder = tmp_path / "`${window.broken=6}` <img src=x onerror=window.broken=7>\u202e\" onclick=window.broken=12 '"
    with RecordWriter(folder / "run.mcap") as writer:
        fake = FakeRun(n=3, rounds=2)

        class Hostile:
            """Puts hostile words wherever a model, a peer or the writer of a record can put any."""

            def write(self, entry: Entry) -> None:
                writer.write(self.changed(entry))

            def changed(self, entry: Entry) -> Entry:
                match entry:
                    case RunInfo():
                        return entry.model_copy(update={"config": {"model": {"model": TURNED}}})
                    case MissionInfo():
                        return entry.model_copy(update={"mission": {**entry.mission, "shape": TURNED}})
                    case PlanInfo():
                        return entry.model_copy(update={"plan_id": TURNED + entry.plan_id})
                    case State():
                        return entry.model_copy(update={"phases": [TURNED] * 3, "origins": [TURNED] * 3})
                    case SummaryMessage():
                        said = {"formed": False, "stopped": TURNED, "plan_robot": 1, "plan_by": TURNED}
                        return entry.model_copy(update={"result": said})
                    case ProtocolEvent(robot=0):
                        opened = {"question": TURNED, "state": "open", "refusals": 3, "wait": 2, "reason": TURNED}
                        return entry.model_copy(update={"kind": "breaker", "detail": opened})
                    case ProtocolEvent():
                        return entry.model_copy(update={"kind": TURNED, "detail": {TURNED: TURNED}})
                    case LlmEntry():
                        return self.called(entry.round, entry.robot)
                    case _:
                        return entry

            def called(self, number: int, robot: int) -> LlmEntry:
                changes: dict[str, Any] = {"text": TURNED, "rejected": TURNED, "parsed": None, "model": TURNED}
                if robot == 1:
                    changes = {"text": None, "error": TURNED, "parsed": None, "faults": [TURNED]}
                if robot == 2:
                    changes = {"text": TURNED, "parsed": {"waypoint": TURNED}, "kind": TURNED}
                return llm_entry(number, robot, messages=[{"role": TURNED, "text": TURNED}], **changes)

        fake.write(Hostile())

    def unharmed(page: Page) -> None:
        assert page.evaluate("window.broken") is None
        assert page.locator("iframe, img[src=x], svg[onload], [onmouseover], [onfocus], [onclick]").count() == 0
        assert not set("\u202e\u2066\u200b\u2028") & set(page.title() + page.locator("body").inner_text())

    with viewer(tmp_path, folder.name) as url, page_at(browser, url) as page:
        ready(page)
        unharmed(page)
        expect(page.locator(".flock-headline")).to_have_text(f"Not formed: {SHOWN}")
        expect(page.locator(".flock-why")).to_contain_text(
            f"no usable answer in 4 of 4 calls. The last reason: {SHOWN[:80]}"
        )
        page.keyboard.press("ArrowRight")
        for robot in range(3):
            page.get_by_label("Robot", exact=True).select_option(f"0:{robot}")
            mind = page.locator(".flock-mind").first
            expect(mind).to_contain_text(f"Robot {robot} ·")
            expect(mind.locator(".flock-facts").first).to_contain_text(f"moved by {SHOWN} · {SHOWN}")
            expect(mind.locator(".flock-call")).to_contain_text(SHOWN)
            if robot == 0:  # it stays open
                mind.get_by_text("Prompt (1 message)").click()
            expect(mind.locator(".flock-prompt .flock-said")).to_have_text(SHOWN)
            unharmed(page)
        page.get_by_role("tab", name="Events").click()
        for event in (0, 1):
            expect(page.locator(".flock-event").nth(event)).to_contain_text(SHOWN)
        unharmed(page)
        go(page, at(url, "runs"))
        expect(page.get_by_text(folder.name.replace("\u202e", "\\u202e"))).to_be_visible()
        expect(page.locator(".flock-runs tbody")).to_contain_text(SHOWN)
        unharmed(page)
        page.get_by_label("Compare ").check()
        expect(page.locator(".flock-compared")).to_contain_text(SHOWN)
        unharmed(page)
