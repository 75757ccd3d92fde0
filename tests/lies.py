"""A library of lies: what members with valid keys may send, alone or together. See docs/reference/security.md.

A gang hears what the honest send, so its lies are nearly true. It signs only as its own members.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from gang import Entries, Gang, Said
from lies_about_plans import (
    a_plan_in_one_place,
    another_plan_to_each_half,
    plan_after_plan,
    plans_for_ever,
    plans_of_its_own,
)
from mangled import mangled
from signed_team import SignedTeam
from toy_keys import ToyKeys

from llm_flock.arrays import Point
from llm_flock.message import (
    BLOCKED,
    MAX_LEVEL,
    MAX_STOPS,
    NO_OWNER,
    UNSAID,
    Course,
    Message,
    MissionStamp,
    Offer,
    encode,
)
from llm_flock.mission import Mission, mission_text
from llm_flock.protocol._agreement.auction import rank
from llm_flock_swarm._signed.certificates import (
    Certificate,
    Proofs,
    WitnessStatement,
    drawn_bid,
    most_claims,
    most_exchanges,
    wrap,
)

FRAMES_EACH = 8
"""Communication rounds from one claim that is told to the framed robot alone to the next."""

MOVES_EACH = 3
"""Communication rounds from one move to the next of those that move on."""


def claims_everything(gang: Gang, member: int) -> list[Said]:
    return [gang.message(member, {slot: gang.claim(member, slot) for slot in gang.places}, slot=0)]


def huge_versions(gang: Gang, member: int) -> list[Said]:
    return [gang.message(member, {slot: gang.claim(member, slot, version=2**39) for slot in gang.places})]


def claims_for_others(gang: Gang, member: int) -> list[Said]:
    """Each honest robot gets another place, by a claim in its name."""
    owners = gang.honest[:]
    gang.rng.shuffle(owners)
    wrong = {
        slot: gang.claim(member, slot, version=gang.version(slot) + 1, owner=owner)
        for slot, owner in zip(gang.places, owners, strict=False)
    }
    return [gang.message(member, wrong)]


def frees(gang: Gang, member: int) -> list[Said]:
    """Every place is free; with enough members, they take what they have freed."""
    words = tuple(gang.word(member, slot, NO_OWNER) for slot in gang.places)
    said = [gang.message(member, words=words)]
    slot = gang.rng.choice(gang.places)
    grant = gang.release(slot, NO_OWNER)
    if grant is not None:
        at = gang.version(slot) + 1
        gang.grants[slot, at] = grant
        said.append(gang.message(member, {slot: gang.claim(member, slot, version=at)}))
    return said


def _states(gang: Gang, member: int, owner: int) -> list[Said]:
    """Every place is free or blocked; with all the words that this needs, if there are enough members."""
    entries: Entries = {}
    for slot in gang.places:
        grant = gang.release(slot, owner)
        if grant is not None:
            entries[slot] = (gang.version(slot) + 1, 0.0, owner), Certificate(number=0, grant=grant)
    words = tuple(gang.word(member, slot, owner) for slot in gang.places)
    return [gang.message(member, entries, words=words)]


def frees_all_the_time(gang: Gang, member: int) -> list[Said]:
    """Every place is given to no robot, as often as possible."""
    return _states(gang, member, NO_OWNER)


def blocks(gang: Gang, member: int) -> list[Said]:
    """Every place is blocked by a body."""
    return _states(gang, member, BLOCKED)


def exchanges_what_others_own(gang: Gang, member: int) -> list[Said]:
    """Two members exchange two places with each other, which are others'. One alone signs for both."""
    partner = next((other for other in gang.members if other != member), gang.honest[0])
    give, take = gang.rng.sample(gang.places, 2) if len(gang.places) > 1 else (0, 0)
    return [gang.message(member, gang.exchange(member, partner, give, take))]


def raises_versions(gang: Gang, member: int) -> list[Said]:
    """Two members exchange places at versions that leave no higher one, or hardly any."""
    partner = next((other for other in gang.members if other != member), gang.honest[0])
    give, take = gang.rng.sample(gang.places, 2)
    versions = gang.rng.choice(((2**40 - 2, 2**40 - 2), (2**32 - 1, 2**32 - 1), (2**32 - 2, 0)))
    return [gang.message(member, gang.exchange(member, partner, give, take, versions, (1, 1)))]


def hunts_one(gang: Gang, member: int) -> list[Said]:
    """One honest robot is outbid wherever it goes, as long as numbers last; else it is said not to be there."""
    for slot in gang.owned(gang.honest[0]):
        entry, _ = gang.claim(member, slot, number=1)
        higher = rank(entry) > rank(gang.table[slot][0])
        if higher and gang.numbers[member] < most_claims(len(gang.places)):
            gang.numbers[member] += 1
            return [gang.message(member, {slot: gang.claim(member, slot, number=gang.numbers[member])})]
        return [gang.message(member, words=(gang.word(member, slot, NO_OWNER),))]
    return []


def takes_places_from_one(gang: Gang, member: int) -> list[Said]:
    """Two members exchange the place of one honest robot, wherever it goes, as long as their numbers last."""
    most, turn = most_exchanges(len(gang.places)), gang.members[gang.rounds % len(gang.members)]
    for slot in gang.owned(gang.honest[0]) if member == turn and len(gang.members) > 1 else ():
        partner = min((other for other in gang.members if other != member), key=lambda other: gang.numbers[other])
        if gang.hit == (slot, gang.version(slot)) or max(gang.numbers[member], gang.numbers[partner]) >= most:
            continue
        gang.hit = slot, gang.version(slot)
        gang.numbers.update((member, partner))
        other = gang.rng.choice([place for place in gang.places if place != slot])
        numbers = gang.numbers[member], gang.numbers[partner]
        return [gang.message(member, gang.exchange(member, partner, slot, other, numbers=numbers))]
    return []


def moves_on(gang: Gang, member: int) -> list[Said]:
    """It goes from place to place, and tells one honest robot first. That robot's word frees the place left a moment
    before others know of it, so that the gang is there again before anybody: more places than members stay unusable.
    """
    if gang.rounds % MOVES_EACH == 1 and (slot := _gained(gang, member)) is not None:
        gang.numbers[member] += 1
        entry, certificate = gang.claim(member, slot, number=gang.numbers[member])
        gang.moves[member], gang.table[slot] = (slot, entry, certificate), (entry, certificate)
        return [gang.message(member, {slot: (entry, certificate)}, slot=slot, hears=gang.honest[:1])]
    now = gang.moves.get(member)
    return [] if now is None else [gang.message(member, {now[0]: now[1:]}, slot=now[0])]


def _gained(gang: Gang, member: int) -> int | None:
    """A place that the member gets: a free one, or an honest robot's, if it has none or all of these have theirs."""
    owners = {slot: gang.table[slot][0][2] if slot in gang.table else NO_OWNER for slot in gang.places}
    for slot in gang.places:
        grant = gang.freed(slot)
        if grant is not None:
            at = gang.version(slot) + 1
            gang.grants[slot, at] = grant
            gang.table[slot] = (at, 0.0, NO_OWNER), Certificate(number=0, grant=grant)
            return slot
        if owners[slot] == NO_OWNER and (gang.version(slot) == 0 or (slot, gang.version(slot)) in gang.grants):
            return slot
    settled = set(gang.honest) <= set(owners.values())
    for slot, owner in owners.items() if settled or member not in gang.moves else ():
        at = gang.version(slot)
        bid = drawn_bid(gang.about, slot, at, member) if at else -1e-9
        granted = at == 0 or (slot, at) in gang.grants
        if owner in gang.honest and granted and rank((at, bid, member)) > rank(gang.table[slot][0]):
            return slot
    return None


def frames_one(gang: Gang, member: int) -> list[Said]:
    """One honest robot alone hears that it is outbid, by a claim that counts for no other, since they hear a later one.

    To them it leaves place after place without cause.
    """
    hunted, others = gang.honest[0], gang.honest[1:]
    own = next(iter(gang.owned(member)), None)
    for slot in gang.owned(hunted) if gang.rounds % FRAMES_EACH == gang.members.index(member) else ():
        at = gang.version(slot)
        bid = drawn_bid(gang.about, slot, at, member) if at else -1e-9
        granted = at == 0 or (slot, at) in gang.grants
        if own is None or not granted or rank((at, bid, member)) <= rank(gang.table[slot][0]):
            continue
        outbids = gang.claim(member, slot)  # before the next number is given to what the others hear
        stays = gang.claim(member, own, bid=gang.table[own][0][1])
        return [
            gang.message(member, {own: stays}, slot=own, hears=others),
            gang.message(member, {slot: outbids}, slot=slot, hears=[hunted]),
        ]
    if own is None:
        own = next((a for a in gang.places if a not in gang.table or gang.table[a][0] == UNSAID), None)
    return [] if own is None else [gang.message(member, {own: gang.claim(member, own)}, slot=own, hears=others)]


def raises_old_claims(gang: Gang, member: int) -> list[Said]:
    """It claims place after place, of which only the last counts, and bids ever more for all the others."""
    if member != gang.members[0]:
        return []
    here = min(gang.rounds // MOVES_EACH, len(gang.places) - 1)
    old = {a: gang.claim(member, a, version=0, number=2, bid=-0.5 + 1e-4 * gang.rounds) for a in range(here)}
    return [
        gang.message(member, {**old, here: gang.claim(member, here, version=0, number=5 + here, bid=-0.5)}, slot=here)
    ]


def much_to_check(gang: Gang, member: int) -> list[Said]:
    """As many statements as a message holds, each of which has a good signature, but of something else."""
    signature = gang.keys[member].sign(b"something else")
    words = tuple(
        WitnessStatement(witness, slot, gang.version(slot) + 1, owner, signature)
        for slot in gang.places
        for witness in gang.honest
        for owner in (NO_OWNER, BLOCKED)
    )[:180]
    return [gang.message(member, words=words)]


def offers_to_all(gang: Gang, member: int) -> list[Said]:
    """One place offered to everybody at once."""
    own = gang.owned(member) or [0]
    said: list[Said] = []
    for owner in gang.honest:
        for take in gang.owned(owner)[:1]:
            versions = gang.version(own[0]), gang.version(take)
            bid = drawn_bid(gang.about, take, versions[1] + 1, member)
            offer = Offer(to=owner, give=own[0], take=take, give_version=versions[0], take_version=versions[1], bid=bid)
            said.append(gang.message(member, offer=offer, offer_number=gang.number(), hears=[owner]))
    return said


def another_mission(gang: Gang, member: int) -> list[Said]:
    assert gang.known is not None
    mission = gang.mission.change(spacing=gang.mission.spacing + 1.0)
    stamp = MissionStamp(gang.known.mission.counter + gang.rounds, mission.digest)
    said = Message(sender=member, sequence=gang.rounds, degree=1, stamp=stamp, mission_text=mission_text(mission))
    return [(member, wrap(encode(said), Proofs(mission=gang.keys[member].sign(b"mission"))), None)]


def heartbeats(gang: Gang, member: int) -> list[Said]:
    """Others' hearts beat without end, or not at all."""
    n = gang.mission.n_robots
    return [gang.message(member, beats=((2**39,) * n, (0,) * n)[gang.rounds % 2])]


def speaks_for_others(gang: Gang, member: int) -> list[Said]:
    return [(member, payload, None) for payload in gang.payloads[-2:]]


def noise(gang: Gang, member: int) -> list[Said]:
    """Messages of the honest and its own, changed at random."""
    own = gang.message(member, {slot: gang.claim(member, slot) for slot in gang.places})[1]
    source = gang.rng.choice([own, *gang.payloads])
    return [(member, mangled(source, gang.rng, 1), None), (member, gang.rng.randbytes(200), None)]


def too_large(gang: Gang, member: int) -> list[Said]:
    return [(member, gang.payloads[-1][:1] + b"\xc6\x7f\xff\xff\xff" + bytes(200_000), None)]


def equivocates(gang: Gang, member: int) -> list[Said]:
    """One place to one half of the honest, another to the other."""
    half = len(gang.honest) // 2
    first, last = gang.places[0], gang.places[-1]
    return [
        gang.message(member, {slot: gang.claim(member, slot)}, hears=hears, slot=slot)
        for slot, hears in ((first, gang.honest[:half]), (last, gang.honest[half:]))
    ]


def asks_for_ways(gang: Gang, member: int) -> list[Said]:
    """The highest right to ways over places, in anybody's name; at times nothing, so as to be forgotten."""
    assert gang.known is not None and gang.known.plan is not None
    places = nearest_first(gang.known.plan.points, gang.members.index(member))
    path = gang.rng.choice((places[::2], places[1::2], gang.rng.sample(places, len(places))))[:MAX_STOPS]
    course = Course(level=MAX_LEVEL, of=gang.rng.choice((member, *gang.honest)), path=tuple(path))
    return [gang.message(member, course=None if gang.rounds % 165 >= 150 else course)]


def nearest_first(points: Sequence[Point], number: int) -> list[Point]:
    """All places, one first, another for each liar, then those next to it."""
    first = points[3 * number % len(points)]
    return sorted(points, key=lambda place: math.dist(place, first))


def silence(gang: Gang, member: int) -> list[Said]:
    """Nothing at all: it counts as dead."""
    return []


LIES: dict[str, Callable[[Gang, int], list[Said]]] = {
    "claims every place": claims_everything,
    "claims at huge versions": huge_versions,
    "claims in the name of others": claims_for_others,
    "frees every place and takes one": frees,
    "frees every place all the time": frees_all_the_time,
    "blocks every place": blocks,
    "exchanges what others own": exchanges_what_others_own,
    "raises versions": raises_versions,
    "hunts one robot": hunts_one,
    "takes the places of one robot": takes_places_from_one,
    "moves on before others know": moves_on,
    "frames one robot": frames_one,
    "raises old claims": raises_old_claims,
    "much to check": much_to_check,
    "offers one place to all": offers_to_all,
    "plans of its own": plans_of_its_own,
    "plan after plan": plan_after_plan,
    "plans for ever": plans_for_ever,
    "another plan to each half": another_plan_to_each_half,
    "a plan in one place": a_plan_in_one_place,
    "another mission": another_mission,
    "heartbeats of others": heartbeats,
    "speaks for others": speaks_for_others,
    "noise": noise,
    "far too large": too_large,
    "equivocates": equivocates,
    "asks for ways and stays": asks_for_ways,
    "asks for ways to and fro": asks_for_ways,
    "silence": silence,
}
EVERYTHING = "everything in turn"


def round_of_lies(gang: Gang, lie: str) -> list[Said]:
    """A communication round of this lie; nothing before the honest have a plan, where it needs one."""
    gang.rounds += 1
    if gang.known is None:
        return []
    kind = gang.rng.choice(sorted(LIES)) if lie == EVERYTHING else lie
    return [said for member in gang.members for said in LIES[kind](gang, member)]


def beside_lies(
    lie: str, mission: Mission, places: Sequence[Point], *, liars: int, rounds: int, tolerated: int | None = None
) -> SignedTeam:
    """A team that has flown beside its last robots, who lie together; their bodies are in a corner."""
    members = range(mission.n_robots - liars, mission.n_robots)
    team = SignedTeam(mission, places, liars=liars, tolerated=liars if tolerated is None else tolerated)
    gang, said = Gang({j: ToyKeys(j) for j in members}, mission), list[bytes]()
    for _ in range(rounds):
        team.begin()
        for _ in range(5):
            for payload in said:
                gang.hear(payload)
            said = team.comm_round(said_by=round_of_lies(gang, lie))
        team.end(moves={j: (5.0 * j, 2.0) for j in members})
    return team
