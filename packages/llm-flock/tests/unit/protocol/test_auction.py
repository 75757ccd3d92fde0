"""The auction: tables that merge, bids, exchanges, and what keeps two robots from one slot."""

import math

import pytest
from msgspec.structs import replace
from tables import told

from llm_flock.arrays import Point
from llm_flock.message import BidTable, Message, Offer, Provenance
from llm_flock.plan import Plan
from llm_flock.protocol._agreement.assignment import AssignmentInput, Claim
from llm_flock.protocol._agreement.auction import BOUND_ROUNDS, LAST_EXCHANGED, AuctionAssignment, gain, merge

PLAN = Plan.of([[0, 0], [10, 0], [20, 0]])
ORIGIN = Provenance(mission=0, mission_digest="0" * 16, epoch=0, degree=0, proposer=0, sequence=0)
RULE = AuctionAssignment()
FREE: BidTable = ((0, 0.0, -1), (0, 0.0, -1), (0, 0.0, -1))


def at(robot: int, x: float, *heard: Message, sensed: dict[int, Point] | None = None) -> AssignmentInput:
    return AssignmentInput(
        robot=robot,
        position=(x, 0.0),
        plan=PLAN,
        spacing=10.0,
        chosen=None,
        adopted=True,
        heard=heard,
        sensed=sensed or {},
    )


def says(sender: int, claim: Claim) -> Message:
    return Message(
        sender=sender,
        sequence=0,
        degree=0,
        plan=PLAN,
        provenance=ORIGIN,
        slot=claim.slot,
        offer=claim.offer,
        **told(claim.table),
    )


def crossed() -> tuple[Claim, Claim, dict[int, Point]]:
    """Robot 0 at the right owns the left slot, robot 1 at the left owns the middle: both had better exchange."""
    table: BidTable = ((0, -1.0, 0), (0, -1.0, 1), (0, 0.0, -1))
    bids = (-20.0, -10.0, 0.0)
    return (
        Claim(slot=0, table=table, bids=bids),
        Claim(slot=1, table=table, bids=(0.0, -10.0, -20.0)),
        {0: (12.0, 0.0), 1: (1.0, 0.0)},
    )


def test_merge_is_a_join() -> None:
    a: BidTable = ((0, -1.0, 0), (0, 0.0, -1), (2, -9.0, 1))
    b: BidTable = ((0, -1.0, 1), (0, -5.0, 2), (1, -1.0, 0))
    c: BidTable = ((1, 0.0, -1), (0, -4.0, 3), (2, -9.0, 0))
    assert merge(a, b) == merge(b, a) == ((0, -1.0, 0), (0, -5.0, 2), (2, -9.0, 1))
    assert merge(merge(a, b), c) == merge(a, merge(b, c))
    assert merge(a, a) is a


def test_an_outbid_robot_takes_the_best_slot_still_winnable() -> None:
    near, far = RULE.take(at(0, 10.5)), RULE.take(at(1, 12.0))
    assert near.slot == far.slot == 1
    near, far = RULE.update(near, at(0, 10.5, says(1, far))), RULE.update(far, at(1, 12.0, says(0, near)))
    assert (near.slot, far.slot) == (1, 2)


def test_a_bid_of_zero_has_no_sign() -> None:
    """Minus zero equals zero, but is signed as another number."""
    bids = RULE.take(at(0, 10.0)).bids
    assert bids is not None and math.copysign(1.0, bids[1]) == 1.0


def test_bids_stay_as_they_were_when_the_plan_was_taken_up() -> None:
    """Outbid on its way, a robot that has come to slot 2 still bids for it from where it began."""
    claim = RULE.take(at(0, 9.0))
    won: BidTable = ((0, 0.0, -1), (0, 0.0, 1), (0, -10.5, 2))
    claim = RULE.update(claim, at(0, 20.0, says(1, Claim(slot=1, table=won))))
    assert claim.bids == (-9.0, -1.0, -11.0)
    assert claim.slot == 0 and claim.table == ((0, -9.0, 0), (0, 0.0, 1), (0, -10.5, 2))


def test_messages_without_a_table_teach_nothing() -> None:
    claim = RULE.take(at(0, 10.0))
    assert RULE.update(claim, at(0, 10.0, says(1, Claim(slot=1)))) == claim


def test_all_but_one_slot_are_released_with_a_raised_version() -> None:
    """A robot that finds itself on two slots, from an earlier life on this plan, keeps the better one."""
    claim = RULE.take(at(0, 0.0))
    old: BidTable = ((0, -50.0, 2), (0, -0.5, 0), (0, 0.0, -1))
    after = RULE.update(claim, at(0, 0.0, says(1, Claim(slot=None, table=old))))
    assert after.slot == 0
    assert after.table == ((0, 0.0, 0), (1, 0.0, -1), (0, 0.0, -1))


def test_without_a_winnable_slot_there_is_no_goal() -> None:
    won: BidTable = ((0, 0.0, 1), (0, 0.0, 2), (0, 0.0, 3))
    claim = RULE.take(at(5, 100.0, says(1, Claim(slot=0, table=won))))
    assert claim.slot is None
    freed: BidTable = ((0, 0.0, 1), (0, 0.0, 2), (1, 0.0, -1))
    assert RULE.update(claim, at(5, 100.0, says(1, Claim(slot=0, table=freed)))).slot == 2


def test_a_slot_with_a_raised_version_cannot_be_outbid() -> None:
    """Robot 5 stands on slot 1, but an exchange gave it to robot 1: it takes what is still free."""
    raised: BidTable = ((0, 0.0, 2), (1, -30.0, 1), (0, 0.0, -1))
    claim = RULE.take(at(5, 10.0, says(1, Claim(slot=1, table=raised))))
    assert claim.slot == 2


def test_a_robot_that_witnesses_took_for_dead_stays_at_its_place() -> None:
    """Its bid for slot 1 was better, but others may return to the places that were freed with its own."""
    claim = Claim(slot=2, table=((0, -9.0, 3), (0, -5.0, 4), (1, -11.0, 0)), bids=(-9.0, -1.0, -11.0))
    freed: BidTable = ((0, -9.0, 3), (1, 0.0, -1), (2, 0.0, -1))
    back = RULE.update(claim, replace(at(0, 20.0), granted=freed))
    assert back.slot == 2 and back.table == ((0, -9.0, 3), (1, 0.0, -1), (2, -11.0, 0))
    taken: BidTable = ((0, -9.0, 3), (1, 0.0, -1), (2, -12.0, 4))
    away = RULE.update(claim, replace(at(0, 20.0), granted=taken))
    assert away.slot == 1 and away.table == ((0, -9.0, 3), (1, -1.0, 0), (2, -12.0, 4))


@pytest.mark.parametrize(
    ("owners", "lots", "freed", "won"),
    [
        ("ab", (-7.0, -2.0), {0, 1}, 1),  # its first choice has drawn higher
        ("ab", (-1.0, -2.0), {0, 1}, 0),
        ("ab", (-1.0, -2.0), {1}, 1),  # nothing shows that the first one was freed
        ("ab", (-1.0, -2.0), set[int](), None),
        ("ab", (-7.0, -7.0), {0, 1}, None),
        ("-b", (-9.0, -2.0), {0, 1}, 0),  # a free place comes first, though it bids low there
        ("xb", (-1.0, -7.0), {0, 1}, None),  # a body has no lot
    ],
)
def test_lots_decide_about_a_freed_place_not_the_first_claim(
    owners: str, lots: tuple[float, float], freed: set[int], won: int | None
) -> None:
    """Without a free place, the robot outbids an owner with a worse lot: else liars that are told first keep it out."""
    of = {"a": (1, -5.0, 1), "b": (1, -5.0, 2), "-": (1, 0.0, -1), "x": (1, 0.0, -2)}
    table: BidTable = (of[owners[0]], of[owners[1]], (0, 0.0, 3))
    now = replace(at(4, 1.0), draw=lambda slot, _: lots[slot], freed=lambda slot, _: slot in freed)
    claim = RULE.update(Claim(slot=None, table=table, bids=(-1.0, -9.0, -19.0)), now)
    assert claim.slot == won and claim.table is not None
    if won is not None:
        assert claim.table[won] == (1, lots[won], 4)
    without_keys = RULE.update(Claim(slot=None, table=table, bids=(-1.0, -9.0, -19.0)), at(4, 1.0))
    assert without_keys.slot == (0 if owners[0] == "-" else None)


def test_gain_is_the_fall_of_the_sum_of_squares() -> None:
    assert gain(at(0, 12.0), (1.0, 0.0), 0, 1) == pytest.approx(144 + 81 - 4 - 1)


def test_far_slot_is_handed_on_along_a_ring_not_flown_across() -> None:
    ring = Plan.of([[100 * math.cos(k * math.tau / 60), 100 * math.sin(k * math.tau / 60)] for k in range(60)])
    chord = math.dist(ring.points[0], ring.points[1])
    now = replace(at(0, 99.0), plan=ring, spacing=chord)
    # As the crow flies, a robot that stands inside of its neighbour is the nearer to the slot on the other side.
    assert math.dist((99.0, 0.0), ring.points[30]) < math.dist(ring.points[1], ring.points[30])
    assert gain(now, ring.points[1], 30, 1) > chord**2


def test_acceptor_offers_next_in_the_same_communication_round() -> None:
    table: BidTable = ((0, 0.0, 1), (0, 0.0, 2), (0, -21.0, 0))
    zero = Claim(slot=2, table=table, bids=(-1.0, -11.0, -21.0))
    one = Claim(slot=0, table=table, bids=(0.0, -10.0, -20.0))
    two = Claim(slot=1, table=table, bids=(-10.0, 0.0, -10.0))
    sensed: dict[int, Point] = {0: (-1.0, 0.0), 1: (0.0, 0.0), 2: (10.0, 0.0)}
    near = {1: sensed[1]}
    zero = RULE.update(zero, at(0, -1.0, says(1, one), sensed=near))
    one = RULE.update(one, at(1, 0.0, says(0, zero), says(2, two), sensed=sensed))
    assert one.slot == 2
    assert one.offer == Offer(to=2, give=2, take=1, give_version=1, take_version=0, bid=-10.0)
    two = RULE.update(two, at(2, 10.0, says(1, one), sensed=sensed))
    assert two.slot == 2 and two.table == ((1, -1.0, 0), (1, -10.0, 1), (2, -10.0, 2))


def test_an_exchange_from_offer_to_acceptance() -> None:
    zero, one, sensed = crossed()
    zero = RULE.update(zero, at(0, 12.0, says(1, one), sensed=sensed))
    assert zero.offer == Offer(to=1, give=0, take=1, give_version=0, take_version=0, bid=-10.0)
    assert (zero.slot, zero.bound) == (0, BOUND_ROUNDS)
    one = RULE.update(one, at(1, 1.0, says(0, zero), sensed=sensed))
    assert one.slot == 0 and one.offer is None
    assert one.table == ((1, 0.0, 1), (1, -10.0, 0), (0, 0.0, -1))
    zero = RULE.update(zero, at(0, 12.0, says(1, one), sensed=sensed))
    assert zero.slot == 1 and zero.table == one.table
    # Slot 2 is nearer for neither: both are content, and nothing more is offered.
    assert zero.offer is None


@pytest.mark.parametrize("slot", [0, 1])
def test_places_of_the_last_versions_are_not_exchanged(slot: int) -> None:
    """Versions have to stay countable, so that witnesses can raise them."""
    for version in (LAST_EXCHANGED - 1, LAST_EXCHANGED):
        zero, one, sensed = crossed()
        assert zero.table is not None
        table = tuple((version * (a == slot), *entry[1:]) for a, entry in enumerate(zero.table))
        zero, one = replace(zero, table=table), replace(one, table=table)
        offer = RULE.update(zero, at(0, 12.0, says(1, one), sensed=sensed)).offer
        versions = [entry[0] for entry in table]
        asked = Offer(to=1, give=0, take=1, give_version=versions[0], take_version=versions[1], bid=-10.0)
        assert offer == (asked if version < LAST_EXCHANGED else None)
        zero = replace(zero, offer=asked, bound=BOUND_ROUNDS)
        one = RULE.update(one, at(1, 1.0, says(0, zero), sensed=sensed))
        assert one.slot == (0 if version < LAST_EXCHANGED else 1)


def test_robot_that_may_not_exchange_neither_offers_nor_accepts() -> None:
    zero, one, sensed = crossed()
    offered = RULE.update(zero, at(0, 12.0, says(1, one), sensed=sensed))
    assert offered.offer is not None
    assert RULE.update(zero, replace(at(0, 12.0, says(1, one), sensed=sensed), exchanges=False)).offer is None
    assert RULE.update(one, replace(at(1, 1.0, says(0, offered), sensed=sensed), exchanges=False)).slot == one.slot


def test_bound_robot_accepts_nothing_until_its_offer_expires() -> None:
    zero, one, sensed = crossed()
    zero = RULE.update(zero, at(0, 12.0, says(1, one), sensed=sensed))
    table: BidTable = ((0, -1.0, 0), (0, -1.0, 1), (0, -9.0, 2))
    rival = Claim(
        slot=2,
        table=table,
        bids=(0.0, 0.0, 0.0),
        offer=Offer(to=0, give=2, take=0, give_version=0, take_version=0, bid=-1.0),
    )
    there = {**sensed, 2: (-9.0, 0.0)}
    for _ in range(BOUND_ROUNDS - 1):
        zero = RULE.update(zero, at(0, 12.0, says(2, rival), sensed=there))
        assert zero.slot == 0 and zero.offer is not None
    zero = RULE.update(zero, at(0, 12.0, says(2, rival), sensed=there))
    assert zero.slot == 2


def test_offer_accepted_on_expiry_may_collide_and_is_resolved() -> None:
    """Robot 0 accepts the offer of robot 1, which is free again in that very communication round and accepts the offer
    of robot 2."""
    table: BidTable = ((0, 0.0, 0), (0, 0.0, 1), (0, 0.0, 2))
    places = {0: 25.0, 1: 12.0, 2: -1.0}
    bids = {i: tuple(-abs(x - 10.0 * a) for a in range(3)) for i, x in places.items()}
    offers = {
        1: Offer(to=0, give=1, take=0, give_version=0, take_version=0, bid=bids[1][0]),
        2: Offer(to=1, give=2, take=1, give_version=0, take_version=0, bid=bids[2][1]),
    }
    claims = {
        i: Claim(slot=i, table=table, bids=bids[i], offer=offers.get(i), bound=BOUND_ROUNDS if i == 2 else 1)
        for i in places
    }

    def comm_round() -> list[int | None]:
        said = [says(i, claims[i]) for i in places]
        for i, x in places.items():
            sensed: dict[int, Point] = {j: (y, 0.0) for j, y in places.items() if j != i}
            claims[i] = RULE.update(claims[i], at(i, x, *(m for m in said if m.sender != i), sensed=sensed))
        return [claims[i].slot for i in places]

    assert comm_round() == [1, 2, 2], "two acceptances about slot 1, of the same version"
    zeros, ones = claims[0].table, claims[1].table
    assert zeros is not None and ones is not None and zeros[1][0] == ones[1][0] == 1
    for _ in range(20):
        comm_round()
    assert comm_round() == [2, 1, 0]
    assert claims[0].table == claims[1].table == claims[2].table


def test_of_two_crossing_offers_the_lower_ids_stands() -> None:
    zero, one, sensed = crossed()
    zero, one = (
        RULE.update(zero, at(0, 12.0, says(1, one), sensed=sensed)),
        RULE.update(one, at(1, 1.0, says(0, zero), sensed=sensed)),
    )
    assert zero.offer is not None and one.offer is not None
    zero, one = (
        RULE.update(zero, at(0, 12.0, says(1, one), sensed=sensed)),
        RULE.update(one, at(1, 1.0, says(0, zero), sensed=sensed)),
    )
    assert (zero.slot, one.slot) == (0, 0)
    zero = RULE.update(zero, at(0, 12.0, says(1, one), sensed=sensed))
    assert (zero.slot, one.slot) == (1, 0)


@pytest.mark.parametrize(
    "changes",
    [{"give_version": 1}, {"take_version": 1}, {"take": 2}, {"to": 2}, {"give": 2}],
)
def test_an_offer_about_something_else_is_not_accepted(changes: dict[str, int]) -> None:
    zero, one, sensed = crossed()
    fields = {"to": 1, "give": 0, "take": 1, "give_version": 0, "take_version": 0, "bid": -10.0, **changes}
    zero = Claim(slot=0, table=zero.table, bids=zero.bids, offer=Offer(**fields))
    after = AuctionAssignment().update(one, at(1, 1.0, says(0, zero), sensed=sensed))
    assert after.slot == 1


def test_a_robot_exchanges_only_places_that_it_owns() -> None:
    """Robot 2 stands where robot 0 would, and speaks of the place of another as its own."""
    zero, one, _ = crossed()
    offer = Offer(to=1, give=0, take=1, give_version=0, take_version=0, bid=-10.0)
    offered = says(2, Claim(slot=0, table=zero.table, bids=zero.bids, offer=offer))
    assert RULE.update(one, at(1, 1.0, offered, sensed={2: (12.0, 0.0)})).slot == 1
    claimed = says(2, Claim(slot=1, table=zero.table, bids=one.bids))
    assert RULE.update(zero, at(0, 12.0, claimed, sensed={2: (1.0, 0.0)})).offer is None


def test_exchange_needs_a_gain_and_a_robot_in_sight() -> None:
    zero, one, _ = crossed()
    assert RULE.update(zero, at(0, 12.0, says(1, one))).offer is None
    settled = {0: (1.0, 0.0), 1: (9.0, 0.0)}
    assert RULE.update(zero, at(0, 1.0, says(1, one), sensed=settled)).offer is None
    offering = Claim(
        slot=0,
        table=zero.table,
        bids=zero.bids,
        offer=Offer(to=1, give=0, take=1, give_version=0, take_version=0, bid=0.0),
    )
    assert RULE.update(one, at(1, 9.0, says(0, offering), sensed=settled)).slot == 1


def test_without_swaps_nothing_is_offered() -> None:
    zero, one, sensed = crossed()
    assert AuctionAssignment(swaps=False).update(zero, at(0, 12.0, says(1, one), sensed=sensed)).offer is None


def test_an_offer_that_was_overtaken_is_dropped() -> None:
    zero, one, sensed = crossed()
    zero = RULE.update(zero, at(0, 12.0, says(1, one), sensed=sensed))
    taken: BidTable = ((0, -1.0, 0), (1, -5.0, 2), (1, -5.0, 1))
    zero = RULE.update(zero, at(0, 12.0, says(2, Claim(slot=1, table=taken)), sensed=sensed))
    assert zero.offer is None and zero.slot == 0


def test_the_best_partner_is_asked() -> None:
    table: BidTable = ((0, -1.0, 0), (0, -1.0, 1), (0, -1.0, 2))
    zero = Claim(slot=0, table=table, bids=(-19.0, -9.0, -1.0))
    sensed = {1: (5.0, 0.0), 2: (3.0, 0.0)}
    peers = [
        says(1, Claim(slot=1, table=table)),
        says(2, Claim(slot=2, table=table)),
        says(3, Claim(slot=None, table=table)),
    ]
    asked = RULE.update(zero, at(0, 19.0, *peers, sensed=sensed))
    assert asked.offer is not None and asked.offer.to == 2
    assert math.isclose(asked.offer.bid, -1.0)
