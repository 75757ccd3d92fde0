"""What a robot has heard: the newest of each, understood once, and never more than it can hold."""

from llm_flock.protocol.messages.inbox import NO_PROOFS, REMEMBERED, Inbox
from llm_flock.protocol.messages.message import Message, MissionStamp


def message(sender: int, sequence: int = 0) -> Message:
    return Message(sender=sender, sequence=sequence, neighbors=0, mission=MissionStamp(0, "0" * 16))


def test_the_newest_message_of_each_sender_is_handed_over_once() -> None:
    inbox = Inbox()
    for sender, sequence in ((2, 5), (1, 0), (2, 4)):
        inbox.take(message(sender, sequence), NO_PROOFS)
    assert inbox.drain()[0] == [message(1), message(2, 5)]
    assert inbox.drain()[0] == []


def test_what_is_repeated_is_taken_down_again_within_a_round() -> None:
    inbox = Inbox()
    inbox.take(message(1), NO_PROOFS, b"one")
    inbox.drain()
    assert inbox.again(b"one") == message(1) and inbox.again(b"two") is None
    assert inbox.drain()[0] == [message(1)]
    inbox.begin_round()
    assert inbox.again(b"one") is None


def test_a_flood_of_messages_is_not_remembered() -> None:
    inbox = Inbox()
    for k in range(3 * REMEMBERED):
        inbox.take(message(1, k), NO_PROOFS, b"%d" % k)
    assert sum(inbox.again(b"%d" % k) is not None for k in range(3 * REMEMBERED)) <= REMEMBERED
    assert inbox.again(b"%d" % (3 * REMEMBERED - 1)) is not None
