"""Keys of a team in a folder: made once, each member's part handed to its machine.

    DIR/team.json         name of the team and everybody's public keys; public
    DIR/ca.pem            the team's certificate authority; public
    DIR/authority/ca.key  signs certificates; nobody needs it in flight
    DIR/robot-3/          sign.key, tls.key: secret, that robot's alone; tls.pem: its certificate

A robot's machine needs team.json, ca.pem and its own folder, and nothing else.
"""

from __future__ import annotations

import datetime
import json
import os
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from llm_flock.errors import InputError
from llm_flock.mission import MAX_ROBOTS
from llm_flock.trust.members import member_name, members

SIGNATURE_BYTES = 64
PRIVATE = 0o600
PRIVATE_FOLDER = 0o700
PUBLIC = 0o644


@dataclass(frozen=True, slots=True, kw_only=True)
class Keyring:
    """What one member holds: its own secret key and everybody's public ones.

    Attributes:
        swarm: name of the team, drawn when its keys were made; part of every signature.
        member: own id.
        public: public keys by member id.
    """

    swarm: bytes
    member: int
    public: Mapping[int, Ed25519PublicKey]
    _secret: Ed25519PrivateKey = field(repr=False)

    def sign(self, statement: bytes) -> bytes:
        """The own signature on a statement of this team."""
        return self._secret.sign(self.swarm + statement)

    def check(self, member: int, statement: bytes, signature: bytes) -> bool:
        """Whether a member signed this statement."""
        key = self.public.get(member)
        if key is None:
            return False
        try:
            key.verify(signature, self.swarm + statement)
        except InvalidSignature:
            return False
        return True

    @property
    def robots(self) -> int:
        """How many robots the team has keys for."""
        return sum(member >= 0 for member in self.public)


def make_keys(folder: Path, n_robots: int, *, days: int = 365) -> None:
    """Make the keys and certificates of a team; nothing that exists is ever written over.

    Args:
        folder: where to; may exist if it is empty.
        n_robots: team size N.
        days: how long the certificates are valid.

    Raises:
        InputError: too many robots, or the folder holds something.
    """
    if not 1 <= n_robots <= MAX_ROBOTS:
        raise InputError("robots", n_robots, f"1 to {MAX_ROBOTS}")
    if not 1 <= days <= 3650:
        raise InputError("days", days, "1 to 3650")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError("folder", str(folder), "a new or empty folder: keys are never written over")
    _folder(folder)
    swarm = secrets.token_bytes(16)
    authority = ec.generate_private_key(ec.SECP256R1())
    issuer = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"llm-flock {swarm.hex()[:8]}")])
    ends = datetime.datetime.now(datetime.UTC) + datetime.timedelta(days=days)
    _write(_folder(folder / "authority") / "ca.key", _pem(authority), PRIVATE)
    _write(folder / "ca.pem", _authority_certificate(authority, issuer, ends), PUBLIC)
    public: dict[str, str] = {}
    for member in members(n_robots):
        name = member_name(member)
        own = _folder(folder / name)
        signing, tls = Ed25519PrivateKey.generate(), ec.generate_private_key(ec.SECP256R1())
        _write(own / "sign.key", _pem(signing), PRIVATE)
        _write(own / "tls.key", _pem(tls), PRIVATE)
        _write(own / "tls.pem", _member_certificate(name, tls, authority, issuer, ends), PUBLIC)
        public[name] = signing.public_key().public_bytes_raw().hex()
    team = {"version": 1, "swarm": swarm.hex(), "robots": n_robots, "public": public}
    _write(folder / "team.json", json.dumps(team, indent=1).encode(), PUBLIC)


def load_keyring(folder: Path, member: int) -> Keyring:
    """What a member needs in flight.

    Raises:
        InputError: a file is missing, damaged, does not fit the others, or is a secret that others can read.
    """
    path = folder / "team.json"
    try:
        team = cast("dict[str, Any]", json.loads(path.read_bytes()))
        swarm, robots = bytes.fromhex(team["swarm"]), int(team["robots"])
        keys = {j: bytes.fromhex(team["public"][member_name(j)]) for j in members(robots)}
        public = {j: Ed25519PublicKey.from_public_bytes(key) for j, key in keys.items()}
        known = team["version"] == 1 and len(swarm) == 16
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError("keys", str(path), f"the public keys that `llm-flock keys` writes ({error!r})") from None
    if not known or member not in public:
        raise InputError("keys", str(path), f"keys of version 1 with one for {member_name(member)}")
    path = folder / member_name(member) / "sign.key"
    try:
        if path.stat().st_mode & 0o077:
            raise InputError("keys", str(path), "a file that nobody else may read: chmod 600")
        secret = serialization.load_pem_private_key(path.read_bytes(), password=None)
    except (OSError, ValueError, TypeError) as error:
        raise InputError("keys", str(path), f"the secret key that `llm-flock keys` writes ({error!r})") from None
    if not isinstance(secret, Ed25519PrivateKey) or secret.public_key() != public[member]:
        raise InputError("keys", str(path), f"the secret half of {member_name(member)}'s key in team.json")
    return Keyring(swarm=swarm, member=member, public=public, _secret=secret)


def next_session(folder: Path, member: int, clock_s: float) -> int:
    """A number for this start of a member, higher than that of every start before, whatever its clock says.

    Args:
        folder: of the keys; the number is kept beside the member's own.
        member: own id.
        clock_s: Unix time [s].
    """
    path = folder / member_name(member) / "session"
    try:
        last = int(path.read_text(encoding="ascii"))
    except FileNotFoundError:
        last = 0
    except ValueError:
        raise InputError("keys", str(path), "one whole number") from None
    session = max(last + 1, int(clock_s))
    fresh = path.with_suffix(".new")
    fresh.write_text(str(session), encoding="ascii")
    fresh.replace(path)
    return session


def _folder(path: Path) -> Path:
    path.mkdir(mode=PRIVATE_FOLDER, parents=True, exist_ok=True)
    return path


def _write(path: Path, content: bytes, mode: int) -> None:
    # Created with its final mode: there is no moment in which others could open a secret.
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    with os.fdopen(descriptor, "wb") as file:
        file.write(content)


def _pem(key: Ed25519PrivateKey | ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, ends: datetime.datetime
) -> x509.CertificateBuilder:
    # Clocks of robots may be behind: a certificate is good from a day ago on.
    begins = datetime.datetime.now(datetime.UTC) - datetime.timedelta(days=1)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(begins)
        .not_valid_after(ends)
    )


def _usage(*, authority: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not authority,
        key_cert_sign=authority,
        crl_sign=authority,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _authority_certificate(key: ec.EllipticCurvePrivateKey, name: x509.Name, ends: datetime.datetime) -> bytes:
    certificate = (
        _builder(name, name, key, ends)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(authority=True), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .sign(key, hashes.SHA256())
    )
    return certificate.public_bytes(serialization.Encoding.PEM)


def _member_certificate(
    name: str,
    key: ec.EllipticCurvePrivateKey,
    authority: ec.EllipticCurvePrivateKey,
    issuer: x509.Name,
    ends: datetime.datetime,
) -> bytes:
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    roles = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    certificate = (
        _builder(subject, issuer, key, ends)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(authority=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(roles), critical=False)
        .add_extension(x509.SubjectAlternativeName([x509.DNSName(name)]), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(authority.public_key()), critical=False)
        .sign(authority, hashes.SHA256())
    )
    return certificate.public_bytes(serialization.Encoding.PEM)
