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
import os
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self, cast

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from llm_flock.bounds import MAX_ROBOTS
from llm_flock.errors import InputError
from llm_flock.members import member_name, members

PRIVATE = 0o600
PRIVATE_FOLDER = 0o700
PUBLIC = 0o644


@dataclass(frozen=True, slots=True, kw_only=True)
class PublicKeys:
    """The public keys of all members of a team by their ids: enough to check what they have signed."""

    swarm: bytes  # name of the team, drawn when its keys were made, and of the flight; part of every signature
    public: Mapping[int, Ed25519PublicKey]

    def check(self, member: int, statement: bytes, signature: bytes) -> bool:
        key = self.public.get(member)
        if key is None:
            return False
        try:
            key.verify(signature, self.swarm + statement)
        except InvalidSignature:
            return False
        return True

    def of_flight(self, name: str) -> Self:
        """The same keys for one flight: what was signed in a flight of another name is then signed by nobody."""
        return replace(self, swarm=self.swarm + name.encode() + b"\0")

    @property
    def robots(self) -> int:
        return sum(member >= 0 for member in self.public)


@dataclass(frozen=True, slots=True, kw_only=True)
class Keyring(PublicKeys):
    """The keys of one member: its secret key, and the public keys of all."""

    member: int
    _secret: Ed25519PrivateKey = field(repr=False)

    def sign(self, statement: bytes) -> bytes:
        return self._secret.sign(self.swarm + statement)


def make_keys(folder: Path, n_robots: int, *, days: int = 365) -> None:
    """Make the keys of a team, and certificates that are valid for some days; never overwrites a file."""
    if not 1 <= n_robots <= MAX_ROBOTS:
        raise InputError("robots", n_robots, f"1 to {MAX_ROBOTS}")
    if not 1 <= days <= 3650:
        raise InputError("days", days, "1 to 3650")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError("folder", str(folder), "a new or empty folder: keys are never written over")
    _folder(folder)
    swarm = secrets.token_bytes(16)
    authority = ec.generate_private_key(ec.SECP256R1())
    issuer = f"llm-flock {swarm.hex()[:8]}"
    ends = datetime.datetime.now(datetime.UTC) + datetime.timedelta(days=days)
    _write(_folder(folder / "authority") / "ca.key", _pem(authority), PRIVATE)
    _write(folder / "ca.pem", _certificate(issuer, authority, issuer, authority, ends), PUBLIC)
    public: dict[str, str] = {}
    for member in members(n_robots):
        name = member_name(member)
        own = _folder(folder / name)
        signing, tls = Ed25519PrivateKey.generate(), ec.generate_private_key(ec.SECP256R1())
        _write(own / "sign.key", _pem(signing), PRIVATE)
        _write(own / "tls.key", _pem(tls), PRIVATE)
        _write(own / "tls.pem", _certificate(name, tls, issuer, authority, ends), PUBLIC)
        public[name] = signing.public_key().public_bytes_raw().hex()
    team = {"version": 1, "swarm": swarm.hex(), "robots": n_robots, "public": public}
    _write(folder / "team.json", json.dumps(team, indent=1).encode(), PUBLIC)


def load_public_keys(folder: Path) -> PublicKeys:
    """The public keys of a team; only `team.json` has to be there. InputError: it is missing or damaged."""
    path = folder / "team.json"
    try:
        team = cast("dict[str, Any]", json.loads(path.read_bytes()))
        swarm, robots = bytes.fromhex(team["swarm"]), int(team["robots"])
        if not 0 < robots < len(team["public"]):
            raise ValueError(f"{robots} robots, and {len(team['public'])} keys")
        keys = {j: bytes.fromhex(team["public"][member_name(j)]) for j in members(robots)}
        public = {j: Ed25519PublicKey.from_public_bytes(key) for j, key in keys.items()}
        known = team["version"] == 1 and len(swarm) == 16
    except (OSError, ValueError, OverflowError, KeyError, TypeError, RecursionError) as error:
        why = getattr(error, "strerror", None) or repr(error)[:200]
        raise InputError("keys", str(path), f"the public keys that `llm-flock keys` writes ({why})") from None
    if not known:
        raise InputError("keys", str(path), "keys of version 1")
    return PublicKeys(swarm=swarm, public=public)


def load_keyring(folder: Path, member: int) -> Keyring:
    """The keys of a member; an InputError if a file is missing, damaged, or secret but readable by other users."""
    team = load_public_keys(folder)
    swarm, public = team.swarm, team.public
    if member not in public:
        raise InputError("keys", str(folder / "team.json"), f"keys with one for {member_name(member)}")
    path = folder / member_name(member) / "sign.key"
    try:
        _check_private(path)
        secret = serialization.load_pem_private_key(path.read_bytes(), password=None)
    except (OSError, ValueError, TypeError) as error:
        why = getattr(error, "strerror", None) or repr(error)
        raise InputError("keys", str(path), f"the secret key that `llm-flock keys` writes ({why})") from None
    if not isinstance(secret, Ed25519PrivateKey) or secret.public_key() != public[member]:
        raise InputError("keys", str(path), f"the secret half of {member_name(member)}'s key in team.json")
    return Keyring(swarm=swarm, member=member, public=public, _secret=secret)


def next_session(folder: Path, member: int, clock_s: float) -> int:
    """The session number of this start of a member: higher than every one before, whatever the Unix time `clock_s`."""
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


def tls_config(folder: Path, member: int) -> dict[str, Any]:
    """The part of a zenoh configuration that admits only processes with a certificate of this team.

    Only members have one, so its name need not be that of the machine; the signature on each envelope tells who sent
    it.
    """
    own = folder / member_name(member)
    authority, certificate, key = folder / "ca.pem", own / "tls.pem", own / "tls.key"
    for path in (authority, certificate, key):
        if not path.is_file():
            raise InputError("keys", str(path), "a file that `llm-flock keys` writes")
    _check_private(key)
    return {
        "transport/link/protocols": ["tls"],
        "transport/link/tls": {
            "root_ca_certificate": str(authority),
            "listen_private_key": str(key),
            "listen_certificate": str(certificate),
            "connect_private_key": str(key),
            "connect_certificate": str(certificate),
            "enable_mtls": True,
            "verify_name_on_connect": False,
            "close_link_on_expiration": True,
        },
    }


def _check_private(path: Path) -> None:
    if os.name == "posix" and path.stat().st_mode & 0o077:  # elsewhere, the mode does not tell
        raise InputError("keys", str(path), "a file that nobody else may read: chmod 600")


def _folder(path: Path) -> Path:
    try:
        path.mkdir(mode=PRIVATE_FOLDER, parents=True, exist_ok=True)
    except OSError as error:
        raise InputError("folder", str(path), f"a folder that can be made ({error.strerror})") from None
    return path


def _write(path: Path, content: bytes, mode: int) -> None:
    # Created with its final mode: other users cannot open a secret at any moment.
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    with os.fdopen(descriptor, "wb") as file:
        file.write(content)


def _pem(key: Ed25519PrivateKey | ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _certificate(
    name: str,
    key: ec.EllipticCurvePrivateKey,
    issuer: str,
    authority: ec.EllipticCurvePrivateKey,
    ends: datetime.datetime,
) -> bytes:
    """A certificate signed by the authority, for itself or a member."""
    is_authority = name == issuer
    # Clocks of robots may be behind: a certificate is valid from a day ago on.
    begins = datetime.datetime.now(datetime.UTC) - datetime.timedelta(days=1)
    usage = x509.KeyUsage(
        digital_signature=not is_authority,
        key_cert_sign=is_authority,
        crl_sign=is_authority,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )
    builder = (
        x509.CertificateBuilder()
        .subject_name(_common_name(name))
        .issuer_name(_common_name(issuer))
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(begins)
        .not_valid_after(ends)
        .add_extension(x509.BasicConstraints(ca=is_authority, path_length=0 if is_authority else None), critical=True)
        .add_extension(usage, critical=True)
    )
    extensions: list[x509.ExtensionType] = [x509.SubjectKeyIdentifier.from_public_key(key.public_key())]
    if not is_authority:
        extensions = [
            x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]),
            x509.SubjectAlternativeName([x509.DNSName(name)]),
            x509.AuthorityKeyIdentifier.from_issuer_public_key(authority.public_key()),
        ]
    for extension in extensions:
        builder = builder.add_extension(extension, critical=False)
    return builder.sign(authority, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)


def _common_name(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
