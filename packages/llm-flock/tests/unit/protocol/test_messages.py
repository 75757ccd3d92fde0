"""Messages from the radio are accepted exactly, or refused with a stable reason."""

import math
from typing import Any

import msgspec.structs
import numpy as np
import pytest
from msgspec.structs import astuple, replace
from tables import told

from llm_flock.bounds import MAX_ROBOTS, max_payload_bytes, max_places, mission_room
from llm_flock.errors import MessageError
from llm_flock.message import (
    BLOCKED,
    LAST_ROUND,
    LATEST,
    MAX_STOPS,
    UNSAID,
    WIRE_VERSION,
    Course,
    Message,
    MissionStamp,
    Offer,
    Provenance,
    decode,
    encode,
)
from llm_flock.mission import Mission
from llm_flock.plan import Drawing, Plan
from llm_flock.protocol._geometry import ideal_plan
from llm_flock.shapes import rotated

PLAN = Plan.of([[1.0, 2.0], [3.5, -4.25]])
ORIGIN = Provenance(mission=0, mission_digest="ab" * 8, epoch=0, degree=1, proposer=1, sequence=0)
TABLE = ((0, -1.5, 1), UNSAID)
FULL = Message(
    sender=1,
    sequence=3,
    degree=1,
    mission_text='{"shape": "circle"}',
    plan=PLAN,
    provenance=ORIGIN,
    slot=0,
    **told(TABLE),
    offer=Offer(to=0, give=0, take=1, give_version=0, take_version=3, bid=-2.5),
    course=Course(level=3, of=0, path=((1.5, 2.0), (4.0, -3.25))),
    beats=(7, 3),
    positions={0: (0, (1.0, 2.0), ()), 1: (9, (3.5, 4.25), (3.0, 4.0))},
)
FIELDS = list(Message.__struct_fields__)
ORIGIN_FIELDS = Provenance.__struct_fields__
OFFER = [0, 0, 1, 0, 3, -2.5]


def spoiled(version: int = WIRE_VERSION, **changes: Any) -> bytes:
    """The full message with some fields replaced, as an enemy would send it."""
    wire = dict(zip(FIELDS, msgspec.msgpack.decode(encode(FULL)[1:]), strict=False))
    return bytes([version]) + msgspec.msgpack.encode(list((wire | changes).values()))


def provenance(**changes: Any) -> list[Any]:
    return list((dict(zip(ORIGIN_FIELDS, msgspec.structs.astuple(ORIGIN), strict=True)) | changes).values())


@pytest.mark.parametrize(
    "message",
    [
        FULL,
        Message(sender=0, sequence=0, degree=0),
        Message(sender=0, sequence=0, degree=0, stamp=MissionStamp(4, "cd" * 8)),
        Message(sender=0, sequence=1, degree=1, plan_digest=PLAN.digest, places=2, provenance=ORIGIN, slot=1),
        Message(
            sender=0,
            sequence=1,
            degree=1,
            plan=PLAN,
            provenance=ORIGIN,
            **told((UNSAID, (3, 0.0, BLOCKED)), b"\x0f" * 8),
        ),
    ],
)
def test_encoded_message_is_decoded_unchanged(message: Message) -> None:
    assert decode(encode(message), 2, 2) == message


@pytest.mark.parametrize(("shape", "dim", "size"), [("letters:H", 2, 111), ("sphere", 3, 126)])
def test_the_plan_of_a_program_costs_no_bytes_for_places(shape: str, dim: int, size: int) -> None:
    """The sizes that docs/reference/wire.md names."""
    sizes, as_points = list[int](), list[int]()
    arena = ((0.0,) * dim, (1000.0,) * dim)
    for n in (10, 30, 100):
        mission = Mission(shape=shape, n_robots=n, spacing=5.0, comm_range=60.0, center=(500.0,) * dim, arena=arena)
        plan = ideal_plan(mission, 0.3, (0.1, -0.1))
        said = Message(sender=0, sequence=0, degree=0, plan=plan, provenance=ORIGIN, slot=1)
        read = decode(encode(said), n, mission.dim)
        assert (
            read.plan is not None
            and read.plan == plan
            and read.plan.points == plan.points
            and read.places == len(plan.points) == n
        )
        assert np.allclose(plan.array, Plan.of(rotated(np.array(mission.ideal), mission.center, 0.3)).array, atol=0.2)
        sizes.append(len(encode(said)))
        as_points.append(len(encode(replace(said, plan=Plan(plan.points)))))
    assert sizes == [size] * 3
    assert dim == 3 or as_points == [230, 612, 1942]


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"program": "{}"}, "malformed"),
        ({"program": '{"draw":[{"shape":"cube"}]}'}, "malformed"),
        ({"program": "x" * 4000}, "malformed"),
        ({"scale": 1e8}, "malformed"),
        ({"scale": math.nan}, "malformed"),
        ({"center": (math.nan, 0.0)}, "malformed"),
        ({"places": 0}, "malformed"),
        ({"places": 1500}, "wrong_length"),
        ({"center": (1.0, 2.0, 3.0)}, "wrong_length"),
    ],
)
def test_a_drawing_from_a_stranger_is_checked(changes: dict[str, Any], reason: str) -> None:
    good = Drawing(program='{"draw":[{"shape":"circle"}]}', places=5, spacing=2.0, center=(1.0, 2.0))
    said = Message(sender=0, sequence=0, degree=0, plan=Plan(drawing=good), provenance=ORIGIN)
    assert decode(encode(said), 2, 2) == said
    with pytest.raises(MessageError) as caught:
        decode(encode(replace(said, plan=Plan(drawing=replace(good, **changes)))), 2, 2)
    assert caught.value.reason == reason
    both = [PLAN.points, astuple(good)]
    with pytest.raises(MessageError, match="positions or a drawing"):
        decode(spoiled(plan=both), 2, 2)


def test_slots_left_out_cost_nothing() -> None:
    table = ((1, -2.0, 0), *(UNSAID for _ in range(99)))
    plan = Plan.of([[float(k), 0.0] for k in range(100)])
    said = Message(sender=0, sequence=0, degree=0, plan=plan, provenance=ORIGIN, **told(table, b"\0" * 8))
    named = Message(
        sender=0,
        sequence=0,
        degree=0,
        plan_digest=plan.digest,
        places=100,
        provenance=ORIGIN,
        **told(table, b"\0" * 8),
    )
    assert len(encode(named)) < 100 < len(encode(said))
    assert decode(encode(named), 2, 2).table == table


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (b"", "version"),
        (bytes([WIRE_VERSION]), "malformed"),
        (bytes([WIRE_VERSION, 0xFF, 0]), "malformed"),
        (bytes([WIRE_VERSION]) + msgspec.msgpack.encode([1, 2]), "malformed"),
        (bytes([WIRE_VERSION]) + msgspec.msgpack.encode({"sender": 1}), "malformed"),
        (b"x" * (max_payload_bytes(2) + 1), "oversized"),
        (spoiled(WIRE_VERSION + 1), "version"),
        (b'{"v":1}', "version"),
        (spoiled(claims=[[0, 2**40, -1.0, 1]]), "malformed"),
        (spoiled(proposals=None, votes=None, plan_class=1, proofs=None), "malformed"),
        (spoiled(proposals=None, votes=None, plan_class=0, proofs=[]), "malformed"),
        (spoiled(proposals=None, votes=None, plan_class=0, proofs=None, extra=1), "malformed"),
        (spoiled(sender="1"), "malformed"),
        (spoiled(sender=-1), "malformed"),
        (spoiled(sequence=-1), "malformed"),
        (spoiled(sequence=2**60), "malformed"),
        (spoiled(plan_digest="short"), "malformed"),
        (spoiled(plan_digest="0" * 15 + "\n"), "malformed"),
        (spoiled(plan_digest="0" * 16 + "\n"), "malformed"),
        (spoiled(plan_digest=b"\0" * 8), "malformed"),
        (spoiled(provenance=provenance(mission=LATEST)), "malformed"),
        (spoiled(provenance=provenance(mission_digest="ABABABABABABABAB")), "malformed"),
        (spoiled(mission_text=b"\xff\xff"), "malformed"),
        (spoiled(sender=2), "unknown_id"),
        (spoiled(degree=2), "unknown_id"),
        (spoiled(claims=[[0, 0, -1.0, 7]]), "unknown_id"),
        (spoiled(claims=[[0, 0, -1.0, -3]]), "malformed"),
        (spoiled(provenance=provenance(proposer=9)), "unknown_id"),
        (spoiled(provenance=provenance(degree=2)), "unknown_id"),
        (spoiled(provenance=None), "malformed"),
        (spoiled(plan=None, plan_digest=None, provenance=None), "malformed"),
        (spoiled(plan=None, plan_digest=None), "malformed"),
        (spoiled(table_digest=None), "malformed"),
        (spoiled(places=0, plan=None, plan_digest=PLAN.digest), "wrong_length"),
        (spoiled(places=10**6), "malformed"),
        (spoiled(plan=[[[1.0, 2.0]]]), "wrong_length"),
        (spoiled(plan=[[[1.0, 2.0, 3.0]] * 2]), "wrong_length"),
        (spoiled(plan=[[[1.0, 2.0], [1.0, 2.0, 3.0]]]), "malformed"),
        (spoiled(plan=[[]]), "malformed"),
        (spoiled(slot=2), "wrong_length"),
        (spoiled(beats=[1]), "wrong_length"),
        (spoiled(positions={0: [0, [1.0], []]}), "wrong_length"),
        (spoiled(positions={0: [0, [1.0, 2.0], [1.0]]}), "wrong_length"),
        (spoiled(positions={2: [0, [1.0, 2.0], []]}), "unknown_id"),
        (spoiled(positions={0: [0, [1e300, 2.0], []]}), "malformed"),
        (spoiled(positions={0: [LAST_ROUND + 1, [1.0, 2.0], []]}), "malformed"),
        (spoiled(claims=[[2, 0, -1.0, 1]]), "wrong_length"),
        (spoiled(offer=[0, 2, *OFFER[2:]]), "wrong_length"),
        (spoiled(offer=[2, *OFFER[1:]]), "unknown_id"),
        (spoiled(offer=[*OFFER[:5], math.inf]), "malformed"),
        (spoiled(course=[0, 2, [[1.0, 2.0]]]), "unknown_id"),
        (spoiled(course=[0, 1, [[1.0, 2.0, 3.0]]]), "wrong_length"),
        (spoiled(course=[0, 1, [[1.0, 2.0], [1.0]]]), "wrong_length"),
        (spoiled(course=[0, 1, []]), "malformed"),
        (spoiled(course=[0, 1, [[1.0, 2.0]] * (MAX_STOPS + 1)]), "malformed"),
        (spoiled(course=[16, 1, [[1.0, 2.0]]]), "malformed"),
        (spoiled(course=[0, 1, [[1.0, math.nan]]]), "malformed"),
        (spoiled(course=[0, 1, [[1.0, 1e300]]]), "malformed"),
        (spoiled(plan=[[[math.nan, 2.0], [1.0, 2.0]]]), "malformed"),
        (spoiled(plan=[[[math.inf, 2.0], [1.0, 2.0]]]), "malformed"),
        (spoiled(plan=[[[1e300, 2.0], [1.0, 2.0]]]), "malformed"),
        (spoiled(claims=[[0, 0, math.nan, 1]]), "malformed"),
    ],
)
def test_unacceptable_messages_are_refused_by_name(payload: bytes, reason: str) -> None:
    with pytest.raises(MessageError) as caught:
        decode(payload, 2, 2)
    assert caught.value.reason == reason


@pytest.mark.parametrize("digest", ["0" * 16, None])
def test_digest_of_a_spelled_out_plan_is_computed_on_receipt(digest: str | None) -> None:
    assert decode(spoiled(plan_digest=digest), 2, 2).plan_digest == PLAN.digest


def test_a_plan_says_for_which_mission_a_message_is() -> None:
    heard = decode(spoiled(stamp=[7, "cd" * 8]), 2, 2)
    assert heard.mission == ORIGIN.stamp and heard == FULL


@pytest.mark.parametrize(("n", "dim"), [(1, 2), (10, 3), (300, 2), (1000, 2), (MAX_ROBOTS, 3)])
@pytest.mark.parametrize("crowded", [False, True])
def test_the_longest_mission_fits_beside_all_else(n: int, dim: int, crowded: bool) -> None:
    places = min(max_places(n, dim), MAX_ROBOTS) if crowded else n
    plan = Plan.of([[12345.678901 + k, -98765.432109 - k, 0.123456][:dim] for k in range(places)])
    far = 2**40 - 1
    table = tuple((far, -123456.123456789, n - 1) for k in range(places))
    here = plan.points[0]
    message = Message(
        sender=n - 1,
        sequence=far,
        degree=n - 1,
        mission_text="x" * mission_room(n, places, dim),
        plan=plan,
        provenance=msgspec.structs.replace(
            ORIGIN, mission=2**60 - 1, epoch=far, degree=n - 1, proposer=n - 1, sequence=far
        ),
        slot=places - 1,
        **told(table),
        offer=Offer(to=n - 1, give=places - 1, take=0, give_version=far, take_version=far, bid=-0.1),
        course=Course(level=15, of=n - 1, path=(here,) * 4),
        beats=(far,) * n,
        positions=dict.fromkeys(range(n), (LAST_ROUND, here, here)),
    )
    payload = encode(message)
    assert decode(payload, n, dim) == message
    small_ids = 3 * 2 * (n + places) + 60 * (n < 1000)
    assert max_payload_bytes(n) - len(payload) <= small_ids, "what is left is what smaller numbers take less"


@pytest.mark.parametrize("first", [-0.0, 0.0])
def test_a_bid_of_zero_has_no_sign_whichever_was_read_first(first: float) -> None:
    """Otherwise the digest of a table, and whether a signature fits, would depend on what a robot has heard before."""
    version = int(math.copysign(77, first)) + 100  # not in the cache yet
    for bid in (first, -first):
        heard = decode(spoiled(claims=[[0, version, bid, 1]], offer=[*OFFER[:5], bid]), 2, 2)
        assert heard.table is not None and heard.offer is not None
        assert math.copysign(1.0, heard.table[0][1]) == math.copysign(1.0, heard.offer.bid) == 1.0
    assert heard.table == ((version, 0.0, 1), UNSAID) and heard.offer.bid == 0.0


def test_equal_plans_are_equal_after_rounding() -> None:
    assert Plan.of([[0.1 + 0.2, -0.0]]) == Plan.of([[0.3, 0.0]])
    assert Plan.of([[1.0, 2.0]]) != Plan.of([[2.0, 1.0]])
    assert Plan.of([[1.0, 2.0]]) != "plan"
    assert len({Plan.of([[1.0, 2.0]]), Plan.of([[1.0, 2.0]])}) == 1
