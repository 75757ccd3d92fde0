"""Keys of a team in a folder: made once, then each member's part is copied to its machine.

    DIR/team.json         name of the team and the public keys of all members; public
    DIR/ca.pem            the team's certificate authority; public
    DIR/authority/ca.key  signs certificates; not needed in flight
    DIR/robot-3/          sign.key, tls.key: secret, for that robot only; tls.pem: its certificate

A robot's machine needs team.json, ca.pem and its own folder, and nothing else.
"""

from __future__ import annotations

import datetime
import json
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal, Self

import msgspec
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from llm_flock.bounds import MAX_ROBOTS
from llm_flock.errors import InputError
from llm_flock.members import member_name, members
from llm_flock_swarm._trust.files import PRIVATE, PUBLIC, check_private, make_folder, pem, write_new
from llm_flock_swarm._trust.tls import certificate


@dataclass(frozen=True, slots=True, kw_only=True)
class PublicKeys:
    """The public keys of all members of a team by their ids: enough to check what they have signed."""

    context: bytes  # prefix of every signed statement: random id of the team, then the flight's name
    public: Mapping[int, Ed25519PublicKey]

    def check(self, member: int, statement: bytes, signature: bytes) -> bool:
        key = self.public.get(member)
        if key is None:
            return False
        try:
            key.verify(signature, self.context + statement)
        except InvalidSignature:
            return False
        return True

    def for_flight(self, name: str) -> Self:
        """The same keys for one flight: signatures from other flights are then invalid."""
        return replace(self, context=self.context + name.encode() + b"\0")

    @property
    def robots(self) -> int:
        return sum(member >= 0 for member in self.public)


@dataclass(frozen=True, slots=True, kw_only=True)
class Keyring(PublicKeys):
    """The keys of one member: its secret key, and the public keys of all."""

    member: int
    _secret: Ed25519PrivateKey = field(repr=False)

    def sign(self, statement: bytes) -> bytes:
        return self._secret.sign(self.context + statement)


def make_keys(folder: Path, n_robots: int, *, days: int = 365) -> None:
    """Make the keys of a team, and certificates that are valid for some days; never overwrites a file."""
    if not 1 <= n_robots <= MAX_ROBOTS:
        raise InputError("robots", n_robots, f"1 to {MAX_ROBOTS}")
    if not 1 <= days <= 3650:
        raise InputError("days", days, "1 to 3650")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError("folder", str(folder), "a new or empty folder: keys are never written over")
    make_folder(folder)
    swarm = secrets.token_bytes(16)
    authority = ec.generate_private_key(ec.SECP256R1())
    issuer = f"llm-flock {swarm.hex()[:8]}"
    ends = datetime.datetime.now(datetime.UTC) + datetime.timedelta(days=days)
    write_new(make_folder(folder / "authority") / "ca.key", pem(authority), PRIVATE)
    write_new(folder / "ca.pem", certificate(issuer, authority, issuer, authority, ends), PUBLIC)
    public: dict[str, str] = {}
    for member in members(n_robots):
        name = member_name(member)
        own = make_folder(folder / name)
        signing, tls = Ed25519PrivateKey.generate(), ec.generate_private_key(ec.SECP256R1())
        write_new(own / "sign.key", pem(signing), PRIVATE)
        write_new(own / "tls.key", pem(tls), PRIVATE)
        write_new(own / "tls.pem", certificate(name, tls, issuer, authority, ends), PUBLIC)
        public[name] = signing.public_key().public_bytes_raw().hex()
    team = {"version": 1, "swarm": swarm.hex(), "robots": n_robots, "public": public}
    write_new(folder / "team.json", json.dumps(team, indent=1).encode(), PUBLIC)


class _TeamFile(msgspec.Struct):
    version: Literal[1]
    swarm: Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{32}$")]
    robots: Annotated[int, msgspec.Meta(ge=1, le=MAX_ROBOTS)]
    public: dict[str, str]


def load_public_keys(folder: Path) -> PublicKeys:
    """The public keys of a team; only `team.json` has to be there. InputError: it is missing or damaged."""
    path = folder / "team.json"
    try:
        team = msgspec.json.decode(path.read_bytes(), type=_TeamFile)
        names = {member: member_name(member) for member in members(team.robots)}
        if set(team.public) != set(names.values()):
            raise ValueError("public keys and number of robots differ")
        keys = {member: bytes.fromhex(team.public[name]) for member, name in names.items()}
        public = {member: Ed25519PublicKey.from_public_bytes(key) for member, key in keys.items()}
        return PublicKeys(context=bytes.fromhex(team.swarm), public=public)
    except (OSError, ValueError, RecursionError) as error:
        why = getattr(error, "strerror", None) or repr(error)[:200]
        raise InputError("keys", str(path), f"the public keys that `llm-flock keys` writes ({why})") from None


def load_keyring(folder: Path, member: int) -> Keyring:
    """The keys of a member; an InputError if a file is missing, damaged, or secret but readable by other users."""
    team = load_public_keys(folder)
    if member not in team.public:
        raise InputError("keys", str(folder / "team.json"), f"keys that include {member_name(member)}")
    path = folder / member_name(member) / "sign.key"
    try:
        check_private(path)
        secret = load_pem_private_key(path.read_bytes(), password=None)
    except (OSError, ValueError, TypeError) as error:
        why = getattr(error, "strerror", None) or repr(error)
        raise InputError("keys", str(path), f"the secret key that `llm-flock keys` writes ({why})") from None
    if not isinstance(secret, Ed25519PrivateKey) or secret.public_key() != team.public[member]:
        raise InputError("keys", str(path), f"the secret half of {member_name(member)}'s key in team.json")
    return Keyring(context=team.context, member=member, public=team.public, _secret=secret)
