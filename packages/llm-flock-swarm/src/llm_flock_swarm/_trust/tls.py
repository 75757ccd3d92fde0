"""TLS certificates of a team, and the zenoh settings that demand them."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from llm_flock.errors import InputError
from llm_flock.members import member_name
from llm_flock_swarm._trust.files import check_private


def certificate(
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


def tls_config(folder: Path, member: int) -> dict[str, Any]:
    """The part of a zenoh configuration that admits only processes with a certificate of this team.

    Only members have one, so its name need not be that of the machine. The signature on each envelope names the sender.
    """
    own = folder / member_name(member)
    authority, own_certificate, key = folder / "ca.pem", own / "tls.pem", own / "tls.key"
    for path in (authority, own_certificate, key):
        if not path.is_file():
            raise InputError("keys", str(path), "a file that `llm-flock keys` writes")
    check_private(key)
    ends = x509.load_pem_x509_certificate(own_certificate.read_bytes()).not_valid_after_utc
    if ends < datetime.datetime.now(datetime.UTC):
        raise InputError("keys", str(own_certificate), f"one that has not ended, as this one did on {ends.date()}")
    return {
        "transport/link/protocols": ["tls"],
        "transport/link/tls": {
            "root_ca_certificate": str(authority),
            "listen_private_key": str(key),
            "listen_certificate": str(own_certificate),
            "connect_private_key": str(key),
            "connect_certificate": str(own_certificate),
            "enable_mtls": True,
            "verify_name_on_connect": False,
            "close_link_on_expiration": True,
        },
    }
