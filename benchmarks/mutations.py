"""Deliberate faults, each of which breaks one invariant; `python -m benchmarks.mutants` tries them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Mutant:
    """One deliberate fault.

    Attributes:
        name: for the command line.
        invariant: what it breaks.
        change: the fault in words.
        file: where, below src/llm_flock.
        snippet: text that stands there exactly once.
        instead: what takes its place.
        test: the test that has to fail, below tests.
    """

    name: str
    invariant: str
    change: str
    file: str
    snippet: str
    instead: str
    test: str

    @property
    def row(self) -> str:
        """This mutant's row in the table of docs/explanation/testing.md."""
        path, _, function = self.test.partition("::")
        return f"| `{self.name}` | {self.invariant} | {self.change} | `{Path(path).name}`: `{function}` |"


TALKS, JUDGE = "protocol/agreement/agreement.py", "protocol/verification/validator.py"
AUCTION, CONSENSUS = "protocol/agreement/auction.py", "protocol/agreement/consensus.py"
LEDGER, SIGNING, ENVELOPE = "protocol/signed/evidence.py", "protocol/signed/signing.py", "trust/envelope.py"
T_SIGNED, T_TALK = "unit/test_signed_claims.py", "unit/test_signed_talk.py"
T_ENVELOPE = "unit/test_envelope.py"
SHIELD, PROJECTION, ASYNC = (
    "protocol/motion/shield.py",
    "protocol/motion/projection.py",
    "protocol/motion/shield_async.py",
)
T_AUCTION, T_THEORY = "unit/test_auction.py", "property/test_theory.py"
T_AGENT, T_PLACES, T_VERIFIED = "unit/test_agent.py", "unit/test_agent_places.py", "unit/test_agent_verification.py"
SPEECH, LIVENESS, PILOT = (
    "protocol/messages/dissemination.py",
    "protocol/membership/liveness.py",
    "protocol/motion/pilot.py",
)
T_TALKS, T_SPEECH, T_SURVEY = "unit/test_negotiation.py", "unit/test_speech.py", "unit/test_survey.py"
T_SEARCH, T_CONSENSUS, T_SHIELD = "unit/test_search.py", "unit/test_consensus.py", "property/test_shield.py"

MUTANTS: Sequence[Mutant] = (
    # ---------------------------------------------------------------- one plan
    Mutant(
        *("proposer", "Plans are ordered by their proposer", "the proposer is left out of the order"),
        *(CONSENSUS, "origin.proposer,", "0,"),
        f"{T_CONSENSUS}::test_among_equals_the_proposer_decides_and_then_the_digest",
    ),
    Mutant(
        *("digest", "The order of plans is total", "the digest is left out of the order"),
        *(CONSENSUS, "        plan.digest,\n", '        "",\n'),
        f"{T_CONSENSUS}::test_among_equals_the_proposer_decides_and_then_the_digest",
    ),
    Mutant(
        *("class", "A better class beats influence", "plans are compared without their class"),
        *(CONSENSUS, "        plan_class,\n", "        0,\n"),
        f"{T_VERIFIED}::test_an_exact_plan_beats_a_crude_one_of_higher_influence",
    ),
    Mutant(
        *("influence", "Influence belongs to the plan", "the proposer's influence is left out of the order"),
        *(CONSENSUS, "origin.neighbors,", "0,"),
        f"{T_CONSENSUS}::test_pedigree_is_decided_by_the_proposer_not_the_carrier",
    ),
    Mutant(
        *("readopting", "Only a higher plan is adopted", "a plan is adopted again and again"),
        *(CONSENSUS, "key > best_key", "key >= best_key"),
        f"{T_CONSENSUS}::test_rules_keep_the_contract",
    ),
    Mutant(
        *("strictly", "The literal rule needs strictly more influence", "equal influence is enough"),
        *(CONSENSUS, "k.neighbors <= own.neighbors", "k.neighbors < own.neighbors"),
        "unit/test_counterexamples.py::test_equal_influences_never_resolve",
    ),
    Mutant(
        *("rounding", "Equal plans are equal everywhere", "coordinates are not rounded"),
        *("protocol/plan.py", ".round(DECIMALS) + 0.0", ""),
        "unit/test_messages.py::test_equal_plans_are_equal_after_rounding",
    ),
    Mutant(
        *("heard-plans", "No refused plan is followed or forwarded", "plans that are heard are not verified"),
        *(TALKS, "objection = self._validator.objection(plan)", "objection = None"),
        f"{T_VERIFIED}::test_a_received_plan_that_fails_dies_with_its_author",
    ),
    Mutant(
        *("own-plans", "No refused plan is proposed", "a robot's own plan is not verified"),
        *(JUDGE, "if not isinstance(answer, PlanAnswer) or not self.verify:", "if True:"),
        f"{T_VERIFIED}::test_an_own_plan_that_fails_is_not_followed",
    ),
    Mutant(
        *("residual", "A plan resembles its shape", "the limit of the residual is a thousand times larger"),
        *("protocol/verification/plans.py", "RESIDUAL_LIMIT = 0.05", "RESIDUAL_LIMIT = 50.0"),
        "unit/test_verification.py::test_the_right_spacing_in_another_shape_is_refused",
    ),
    # ---------------------------------------------------------------- distinct places
    Mutant(
        *("version", "A higher version wins", "one with a lower bid does not"),
        *(AUCTION, "if their[0] > my[0] or (", "if ("),
        f"{T_AUCTION}::test_merge_is_a_join",
    ),
    Mutant(
        *("owner", "No two entries are of equal rank", "entries are ranked without their owner"),
        *(AUCTION, "return (version, owner != NO_OWNER, bid, -owner)", "return (version, owner != NO_OWNER, bid)"),
        f"{T_THEORY}::test_entries_of_equal_rank_are_equal",
    ),
    Mutant(
        *("two-places", "A robot owns at most one place in its table", "it keeps all that it finds itself on"),
        *(AUCTION, "for a in owned if a != keep", "for a in owned[:0]"),
        f"{T_AUCTION}::test_all_but_one_slot_are_released_with_a_raised_version",
    ),
    Mutant(
        *("release", "A released place stays released", "it is released without raising the version"),
        *(AUCTION, "(table[a][0] + 1, 0.0, NO_OWNER)", "(table[a][0], 0.0, NO_OWNER)"),
        f"{T_AUCTION}::test_all_but_one_slot_are_released_with_a_raised_version",
    ),
    Mutant(
        *("outbidding", "An exchanged place cannot be outbid", "a higher bid takes it all the same"),
        *(AUCTION, "(version == 0 and owner != BLOCKED and", "("),
        f"{T_AUCTION}::test_a_slot_with_a_raised_version_cannot_be_outbid",
    ),
    Mutant(
        *("fixed-bids", "Bids are fixed when the plan is taken up", "they follow the robot's position"),
        *(AUCTION, "table, bids = claim.table, claim.bids\n"),
        "table, bids = claim.table, tuple(-math.dist(now.position, point) for point in now.plan.points)\n",
        f"{T_AUCTION}::test_bids_stay_as_they_were_when_the_plan_was_taken_up",
    ),
    Mutant(
        *("other-plans", "Tables of different plans never merge", "all tables that are heard are merged"),
        *(TALKS, "heard = [m for m in heard if m.plan is self.plan or m.plan == self.plan]", "heard = list(heard)"),
        f"{T_PLACES}::test_claims_on_another_plan_are_not_merged",
    ),
    Mutant(
        *("worthless-offer", "An offer lowers the sum of squares", "any exchange with a sensed robot is offered"),
        *(AUCTION, "if worth >= SWAP_GAIN * now.spacing**2 and (", "if worth > -math.inf and ("),
        f"{T_AUCTION}::test_an_exchange_that_gains_nothing_or_with_a_robot_out_of_sight_is_neither_offered_nor_accepted",
    ),
    Mutant(
        *("worthless-acceptance", "An exchange lowers the sum of squares", "every offer is accepted"),
        *(AUCTION, "if worth >= SWAP_GAIN * now.spacing**2:\n", "if True:\n"),
        f"{T_AUCTION}::test_an_exchange_that_gains_nothing_or_with_a_robot_out_of_sight_is_neither_offered_nor_accepted",
    ),
    Mutant(
        *("bound", "A robot bound by its offer accepts no other", "it does"),
        *(AUCTION, "if claim.offer is not None and not crossing:", "if False:"),
        f"{T_AUCTION}::test_a_bound_robot_accepts_nothing_else_and_is_free_again_after_some_ticks",
    ),
    Mutant(
        *("unending-offer", "An offer expires", "an unanswered offer binds for ever"),
        *(AUCTION, "(bound <= 0 or _ended(", "(_ended("),
        f"{T_AUCTION}::test_a_bound_robot_accepts_nothing_else_and_is_free_again_after_some_ticks",
    ),
    Mutant(
        *("crossing", "Of two crossing offers one is accepted", "both are"),
        *(AUCTION, "claim.offer.to == message.sender and message.sender < now.robot", "True"),
        f"{T_AUCTION}::test_of_two_crossing_offers_the_lower_ids_stands",
    ),
    Mutant(
        *("stale-offer", "An offer is about the present versions", "an offer about other versions is accepted"),
        *(AUCTION, "if table[offer.give][::2] != (offer.give_version, message.sender) or ", "if False and "),
        f"{T_AUCTION}::test_an_offer_about_something_else_is_not_accepted",
    ),
    Mutant(
        *("exchange-version", "An exchange beats every earlier claim", "the given place keeps its version"),
        *(AUCTION, "(offer.give_version + 1, ", "(offer.give_version, "),
        f"{T_AUCTION}::test_an_exchange_from_offer_to_acceptance",
    ),
    Mutant(
        *("search", "A frozen partition ends", "the search never begins"),
        *("protocol/membership/search.py", "way=tour if looks < LOOKS // 2 else (*tour, center)", "way=()"),
        f"{T_SEARCH}::test_the_robot_next_to_a_vacant_place_goes_first",
    ),
    Mutant(
        *("endless-search", "A search is bounded", "tours never end"),
        *("protocol/membership/search.py", "if table[a][1] < most]", "if True]"),
        f"{T_SEARCH}::test_looks_in_vain_are_followed_by_longer_waits_and_end_with_the_centre_then_for_good",
    ),
    # ---------------------------------------------------------------- in flight
    Mutant(
        *("silent-places", "The place of a silent robot is free", "it stays the silent robot's"),
        *(AUCTION, "elif owner in now.silent or (", "elif ("),
        f"{T_SURVEY}::test_the_place_of_who_falls_silent_is_free_with_a_raised_version",
    ),
    Mutant(
        *("taken-back", "A robot wrongly suspected takes its place back", "it leaves it to others"),
        *(
            AUCTION,
            "table = observed_occupancy(reclaimed(now.robot, claim, table), now)",
            "table = observed_occupancy(table, now)",
        ),
        f"{T_SURVEY}::test_who_was_taken_for_dead_takes_its_place_back",
    ),
    Mutant(
        *("former-life", "A robot that begins again counts on", "it counts from one"),
        *(LIVENESS, "if mine > self._beats[self._robot]:", "if False:"),
        "unit/test_liveness.py::test_who_starts_again_counts_on_from_its_former_life",
    ),
    Mutant(
        *("blocked", "A place under a still body is nobody's", "such places are not noted"),
        *("protocol/membership/occupancy.py", "return under(still), ", "return frozenset[int](), "),
        f"{T_SURVEY}::test_a_place_under_a_body_without_a_mind_is_nobodys_until_it_has_moved_off",
    ),
    Mutant(
        *("unblocked", "A place without a body is free again", "only who met bodies itself looks"),
        *(TALKS, "if self.bodies or self._told_of_bodies:", "if self.bodies:"),
        f"{T_SURVEY}::test_a_robot_that_begins_again_where_its_body_blocked_a_place_says_so",
    ),
    Mutant(
        *("living-bodies", "Who lives blocks no place", "every body near a blocked place keeps it blocked"),
        *(
            "protocol/membership/occupancy.py",
            "for j, x in sensed.items() if j not in living]",
            "for x in sensed.values()]",
        ),
        f"{T_SURVEY}::test_who_is_known_to_live_blocks_no_place",
    ),
    Mutant(
        *("signs-of-life", "A counter alone is no sign of life", "who was heard of once counts as living"),
        *(LIVENESS, "newer & (self._beats > BODY)", "newer"),
        f"{T_SURVEY}::test_a_place_on_which_somebody_stands_is_left_to_those_who_know_who_that_is",
    ),
    Mutant(
        *("watching", "Somebody sees a blocked place come free", "who has no place stays where it is"),
        *("protocol/agent.py", "if owner == BLOCKED]", "if owner < BLOCKED]"),
        f"{T_SURVEY}::test_a_robot_without_a_place_goes_to_see_whether_a_blocked_one_has_come_free",
    ),
    Mutant(
        *("stamp", "The mission of highest stamp is in force", "the last one heard is"),
        *(
            TALKS,
            "self._consider(message, proofs) if message.mission > self.stamp",
            "self._consider(message, proofs) if True",
        ),
        f"{T_TALKS}::test_of_two_missions_the_higher_stamp_is_in_force_whichever_comes_first",
    ),
    Mutant(
        *("radio-limits", "No message changes a robot's limits", "a mission need not be what its digest stands for"),
        *(SPEECH, "if said.digest != message.mission.digest:", "if False:"),
        f"{T_AGENT}::test_a_refused_message_is_counted_and_changes_nothing",
    ),
    Mutant(
        *("radio-fields", "No message names a robot's limits", "any field of a mission is taken"),
        *(SPEECH, "if not fields.keys() <= MISSION_FIELDS:", "if False:"),
        f"{T_AGENT}::test_a_refused_message_is_counted_and_changes_nothing",
    ),
    Mutant(
        *("plan-mission", "A plan counts only with its mission", "plans for other missions are heard"),
        *(TALKS, "if message.mission != self.stamp:", "if False:"),
        f"{T_TALKS}::test_a_plan_counts_only_with_its_mission",
    ),
    Mutant(
        *("plan-digest", "Who names another plan is told one's own", "it is not"),
        *(SPEECH, "any(m.plan_digest != digest for m in others)", "False"),
        f"{T_SPEECH}::test_a_plan_is_spelled_out_when_it_was_just_taken_up_and_to_who_follows_another",
    ),
    Mutant(
        *("table-digest", "Who names another table is told one's own", "it is not"),
        *(SPEECH, "and m.table_digest != whole.table_digest for m", "and False for m"),
        f"{T_SPEECH}::test_where_digests_differ_small_tables_are_spelled_out_and_large_ones_once_a_round",
    ),
    Mutant(
        *("frame", "A plan is kept in the frame of its mission", "it is kept in the world's"),
        *("protocol/agent.py", "if isinstance(answer, PlanAnswer) and ahead:", "if False:"),
        f"{T_TALKS}::test_a_plan_for_a_moving_centre_is_kept_in_its_frame",
    ),
    # ---------------------------------------------------------------- messages
    Mutant(
        *("reorder", "An older message does not replace a newer one", "the one that arrives last is kept"),
        *("protocol/messages/inbox.py", "message.sequence >= known.sequence", "True"),
        f"{T_AGENT}::test_an_older_message_does_not_replace_a_newer_one",
    ),
    Mutant(
        *("own-id", "Nobody speaks in a robot's own name", "messages with the own id are taken"),
        *(TALKS, "if message.sender == self._robot:", "if False:"),
        f"{T_AGENT}::test_a_refused_message_is_counted_and_changes_nothing",
    ),
    Mutant(
        *("oversized", "Messages are bounded in size", "any size is read"),
        *("protocol/messages/codec.py", "if len(payload) > max_payload_bytes(n_robots):", "if False:"),
        "unit/test_messages.py::test_unacceptable_messages_are_refused_by_name",
    ),
    # ---------------------------------------------------------------- safe flight
    Mutant(
        *("half-margin", "No pair is nearer than the safe distance", "the cell is shrunk by half as much"),
        *(SHIELD, "(gap - safe_distance) / 2.0 - margin", "(gap - safe_distance / 2.0) / 2.0 - margin"),
        f"{T_SHIELD}::test_head_on_robots_stop_at_the_safe_distance",
    ),
    Mutant(
        *("whole-room", "Each takes half of the room between two", "each takes all of it"),
        *(SHIELD, "(gap - safe_distance) / 2.0 - margin", "(gap - safe_distance) - margin"),
        f"{T_SHIELD}::test_no_pair_comes_too_near_whatever_everybody_wants",
    ),
    Mutant(
        *("noise", "Bounded noise widens the margin", "it does not"),
        *(SHIELD, "noise_bound * (1.0 + 4.0 * max_step / gap)", "0.0"),
        f"{T_SHIELD}::test_no_pair_comes_too_near_with_bounded_noise",
    ),
    Mutant(
        *("step-limit", "No step is longer than allowed", "the shield drops the limit"),
        *(SHIELD, "relaxed_move(wish, sides, longest)", "relaxed_move(wish, sides, 1e9)"),
        f"{T_SHIELD}::test_a_long_step_is_clipped",
    ),
    Mutant(
        *("eased", "Only broken limits are eased", "all are, together with them"),
        *(PROJECTION, "min(side.room, 0.0)) if side.violated else side", "side.room)"),
        "unit/test_projection.py::test_a_side_that_is_not_violated_is_never_eased",
    ),
    Mutant(
        *("skipping", "Rules are asked whenever something is new", "where the robot is does not count"),
        *(TALKS, "self.neighbors, self._position, self._sensed)", "self.neighbors)"),
        f"{T_TALKS}::test_rules_that_have_nothing_more_to_say_are_asked_again_only_when_something_is_new",
    ),
    Mutant(
        *("stale-repeat", "A new mission voids what was heard", "what is repeated still counts"),
        *("protocol/messages/inbox.py", "self._newest = {}\n        self._understood.clear()\n", "self._newest = {}\n"),
        f"{T_TALKS}::test_what_is_repeated_counts_only_for_the_mission_that_it_was_said_for",
    ),
    Mutant(
        *("unheard", "Rules hear all that is said of other tables", "a table is known once its digest is"),
        *(
            "protocol/agreement/precedent.py",
            "message.table_digest == table_digest or message.table == before.table",
            "True",
        ),
        f"{T_TALKS}::test_rules_are_asked_again_about_what_is_spelled_out_of_another_table_and_not_of_the_own",
    ),
    Mutant(
        *("repeating", "What is new is said", "a change is not said a second time"),
        *(
            "protocol/messages/dissemination.py",
            "whole.positions is not None or any(self._changed) or",
            "whole.positions is not None or",
        ),
        f"{T_SPEECH}::test_what_was_said_is_repeated_only_while_nothing_is_new",
    ),
    Mutant(
        *("age", "A sighting's age widens the margin", "the age is left out"),
        *(ASYNC, "speed * (other.age_s + period_s)", "speed * period_s"),
        "property/test_shield_async.py::test_age_and_error_widen_the_margin_and_too_much_of_them_is_standing_still",
    ),
    Mutant(
        *("progress", "A blocked robot makes a detour", "the progress timer never fires"),
        *("protocol/motion/progress.py", "idle=progress.idle + 1", "idle=progress.idle"),
        "unit/test_safety.py::test_two_robots_that_meet_head_on_pass_each_other",
    ),
    Mutant(
        *("path", "Every step of a path goes through the shield", "foreseen steps do not"),
        *(PILOT, "        if self._safety is not None:\n            flight = self._safety.step("),
        "        if self._safety is not None and not self.on_path:\n            flight = self._safety.step(",
        "unit/test_agent_on_event.py::test_no_step_is_flown_unverified_or_unshielded",
    ),
    Mutant(
        *("lone-release", "Nobody raises a version alone", "one robot's word, said twice, frees a place"),
        *(LEDGER, "len({robot for robot, _ in grant.words}) >= WITNESSES and all(", "all("),
        f"{T_SIGNED}::test_places_of_the_living_are_not_released_by_one",
    ),
    Mutant(
        *("lone-word", "Nobody raises a version alone", "one robot's word is enough"),
        *(LEDGER, "elif len(words) >= WITNESSES:", "elif words:"),
        f"{T_SIGNED}::test_places_of_the_living_are_not_released_by_one",
    ),
    Mutant(
        *("last-claim", "Only a robot's last claim counts", "all of them do"),
        *(LEDGER, "if place < self._last.get(owner, place):", "if place < (0, 0):"),
        f"{T_SIGNED}::test_one_message_takes_one_place",
    ),
    Mutant(
        *("unsigned-claim", "Claims are signed by their owner", "the signature is not looked at"),
        *(
            LEDGER,
            "return owner < 0 or self.signed_by(owner, statement, certificate.signature)",
            "return bool(statement)",
        ),
        f"{T_SIGNED}::test_what_others_signed_cannot_be_changed_on_the_way",
    ),
    Mutant(
        *("one-sided-exchange", "An exchange is signed by both", "by its maker only"),
        *(LEDGER, "and self.signed_by(done.to, acceptance_statement(self._page, done), done.accepted)", ""),
        f"{T_SIGNED}::test_exchanges_need_both",
    ),
    Mutant(
        *("forged-origin", "A plan is signed by its proposer", "by nobody"),
        *(
            SIGNING,
            "if not self._authenticator.check(origin.proposer, origin_statement(origin, plan), signature):",
            "if False:",
        ),
        f"{T_TALK}::test_a_plan_in_the_name_of_another_is_refused",
    ),
    Mutant(
        *("forged-heartbeat", "Heartbeats are signed by whose they are", "by nobody"),
        *(SIGNING, "count if count > known[j] and self._beat(", "count if count > known[j] or self._beat("),
        f"{T_TALK}::test_hearts_are_neither_stopped_nor_kept_beating_by_others",
    ),
    Mutant(
        *("replay", "An envelope is opened once", "as often as it comes"),
        *(ENVELOPE, 'return "replayed" if behind >= 0 and self.taken >> behind & 1 else None', "return None"),
        f"{T_ENVELOPE}::test_what_is_sealed_is_opened_once",
    ),
    Mutant(
        *("sensing", "A team that senses too little is refused", "the shield flies with any sensing range"),
        *("mission.py", "self.safe_distance + 2 * self.max_step", "self.safe_distance"),
        "unit/test_mission.py::test_the_shield_needs_to_see_far_enough",
    ),
)
