"""Mutual TLS between the processes of a team, as zenoh configuration."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from llm_flock.errors import InputError
from llm_flock.members import member_name


def tls_config(folder: Path, member: int) -> dict[str, Any]:
    """The part of a zenoh configuration that admits only processes with a certificate of this team.

    Endpoints are `tls/HOST:PORT`. Only the team's authority is trusted, and it signs only members, so the name in a
    certificate need not be that of the machine: any member may run anywhere. The signature on each envelope tells which
    member sent it.

    Args:
        folder: of the keys.
        member: own id.

    Returns:
        Keys are zenoh's paths into its configuration, values are plain.

    Raises:
        InputError: a file is missing, or other users can read the secret one.
    """
    own = folder / member_name(member)
    authority, certificate, key = folder / "ca.pem", own / "tls.pem", own / "tls.key"
    for path in (authority, certificate, key):
        if not path.is_file():
            raise InputError("keys", str(path), "a file that `llm-flock keys` writes")
    if key.stat().st_mode & 0o077:
        raise InputError("keys", str(key), "a file that nobody else may read: chmod 600")
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
