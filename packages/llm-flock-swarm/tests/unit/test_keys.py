"""Keys of a team: made once, secret to their owner, and refused where anything about them is wrong."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from typer.testing import CliRunner

from llm_flock.cli import app
from llm_flock.errors import InputError
from llm_flock.members import member_name, members
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.connection import load_keys
from llm_flock_swarm._trust.keys import Keyring, load_keyring, load_public_keys, make_keys
from llm_flock_swarm._trust.session import next_session


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("keys") / "team"
    make_keys(path, 3)
    return path


def test_secrets_are_for_their_owner_only(folder: Path) -> None:
    secrets = sorted(folder.rglob("*.key"))
    assert len(secrets) == 1 + 2 * 6
    assert {path.stat().st_mode & 0o777 for path in secrets} == {0o600}
    assert {path.stat().st_mode & 0o077 for path in folder.iterdir() if path.is_dir()} == {0}
    public = (folder / "team.json").read_text() + (folder / "ca.pem").read_text()
    assert "PRIVATE" not in public


def test_nothing_is_written_over(folder: Path) -> None:
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    with pytest.raises(InputError, match="never written over"):
        make_keys(folder, 3)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"folder = '.*file/keys': .*Not a directory"):
        make_keys(tmp_path / "file" / "keys", 3)


@pytest.mark.parametrize(
    ("robots", "days", "cause"), [(0, 365, "robots"), (10**6, 365, "robots"), (3, 0, "days"), (3, 4000, "days")]
)
def test_teams_and_times_without_sense_are_refused(tmp_path: Path, robots: int, days: int, cause: str) -> None:
    with pytest.raises(InputError, match=f"^{cause} = "):
        make_keys(tmp_path / "team", robots, days=days)
    assert not (tmp_path / "team").exists()


def test_every_certificate_is_team_signed_and_names_its_owner(folder: Path) -> None:
    authority = x509.load_pem_x509_certificate((folder / "ca.pem").read_bytes())
    for member in members(3):
        name = member_name(member)
        own = x509.load_pem_x509_certificate((folder / name / "tls.pem").read_bytes())
        own.verify_directly_issued_by(authority)
        assert own.subject.rfc4514_string() == f"CN={name}"
        assert isinstance(own.public_key(), ec.EllipticCurvePublicKey)
        assert not own.extensions.get_extension_for_class(x509.BasicConstraints).value.ca


def test_member_signs_only_as_itself(folder: Path, tmp_path: Path) -> None:
    rings = {member: load_keyring(folder, member) for member in members(3)}
    assert rings[0].robots == 3
    signature = rings[1].sign(b"here")
    assert rings[0].check(1, b"here", signature)
    assert not rings[0].check(2, b"here", signature)
    assert not rings[0].check(1, b"there", signature)
    assert not rings[0].check(1, b"here", b"")
    assert not rings[0].check(77, b"here", signature)
    make_keys(tmp_path / "others", 3)
    assert not load_keyring(tmp_path / "others", 0).check(1, b"here", signature)


def test_the_secret_is_not_shown(folder: Path) -> None:
    assert "secret" not in repr(load_keyring(folder, 0))


def damaged(folder: Path, tmp_path: Path, name: str, content: bytes) -> Path:
    import shutil

    copy = tmp_path / "copy"
    shutil.copytree(folder, copy)
    (copy / name).write_bytes(content)
    return copy


def test_damaged_keys_are_refused_by_name(folder: Path, tmp_path: Path) -> None:
    team = json.loads((folder / "team.json").read_bytes())
    wrong = {
        "": b"",
        "old": json.dumps({**team, "version": 0}).encode(),
        "short": json.dumps({**team, "swarm": "00"}).encode(),
        "fewer": json.dumps({**team, "robots": 1}).encode(),
        "more": json.dumps({**team, "robots": 9}).encode(),
        "two": json.dumps({**team, "robots": 2}).encode(),
        "endless": json.dumps({**team, "robots": 10**9}).encode(),
        "infinite": json.dumps({**team, "robots": 1}).replace(": 1,", ": 1e999,").encode(),
        "deep": b"[" * 100_000,
        "hex": json.dumps({**team, "public": {**team["public"], "robot-0": "zz"}}).encode(),
    }
    for case, content in wrong.items():
        path = damaged(folder, tmp_path / f"team{case}", "team.json", content)
        with pytest.raises(InputError, match=r"team\.json"):
            load_keyring(path, 2)
    other = (folder / "robot-1" / "sign.key").read_bytes()
    for case, content in {"other": other, "empty": b"", "tls": (folder / "robot-0" / "tls.key").read_bytes()}.items():
        path = damaged(folder, tmp_path / f"sign{case}", "robot-0/sign.key", content)
        with pytest.raises(InputError, match=r"sign\.key"):
            load_keyring(path, 0)
    with pytest.raises(InputError, match=r"team\.json"):
        load_keyring(tmp_path / "nowhere", 0)
    with pytest.raises(InputError, match="robot-3"):
        load_keyring(folder, 3)


def test_a_secret_that_others_can_read_is_refused(folder: Path, tmp_path: Path) -> None:
    path = damaged(folder, tmp_path, "robot-0/sign.key", (folder / "robot-0" / "sign.key").read_bytes())
    (path / "robot-0" / "sign.key").chmod(0o640)
    with pytest.raises(InputError, match="chmod 600"):
        load_keyring(path, 0)


def test_sessions_rise_even_where_the_clock_goes_back(folder: Path) -> None:
    assert next_session(folder, 0, 1000.9) == 1000
    assert next_session(folder, 0, 500.0) == 1001
    assert next_session(folder, 0, 500.0) == 1002
    assert next_session(folder, 1, 500.0) == 500
    (folder / "robot-1" / "session").write_text("many")
    with pytest.raises(InputError, match="session"):
        next_session(folder, 1, 501.0)
    with pytest.raises(InputError, match=r"session.*No such file"):
        next_session(folder, 7, 501.0)


def test_starts_at_the_same_time_get_different_sessions(folder: Path) -> None:
    with ThreadPoolExecutor(8) as pool:
        numbers = list(pool.map(lambda _: next_session(folder, 2, 500.0), range(160)))
    assert len(set(numbers)) == 160


def test_members_have_names() -> None:
    assert [member_name(m) for m in members(2)] == ["robot-0", "robot-1", "operator", "world", "watcher"]


def test_the_command_makes_keys_and_refuses_to_write_over(tmp_path: Path) -> None:
    made = CliRunner().invoke(app, ["keys", str(tmp_path / "k"), "--robots", "2"])
    assert made.exit_code == 0, made.output
    assert load_keyring(tmp_path / "k", 1).robots == 2
    again = CliRunner().invoke(app, ["keys", str(tmp_path / "k"), "--robots", "2"])
    assert isinstance(again.exception, InputError)


def test_a_signature_of_one_flight_is_none_in_another(folder: Path) -> None:
    """Claims, heartbeats and words of an earlier flight of the team would otherwise count in the next one."""
    keys, other = load_keyring(folder, 1), load_keyring(folder, 2)
    signature = keys.for_flight("monday").sign(b"a place is free")
    assert other.for_flight("monday").check(1, b"a place is free", signature)
    for name in ("tuesday", "monda", "mondaya", ""):
        assert not other.for_flight(name).check(1, b"a place is free", signature), name
    assert not other.check(1, b"a place is free", signature)
    assert load_public_keys(folder).for_flight("monday").check(1, b"a place is free", signature)


def test_a_swarm_signs_for_its_own_name_only(folder: Path) -> None:
    def keys_of(name: str) -> Keyring:
        options = {"shape": "triangle", "n_robots": 3, "model": "simulated:ideal", "keys": str(folder), "swarm": name}
        keys = load_keys(SwarmConfig.build({}, **options), 0)
        assert keys is not None
        return keys

    signature = keys_of("monday").sign(b"a place is free")
    assert keys_of("monday").check(0, b"a place is free", signature)
    assert not keys_of("tuesday").check(0, b"a place is free", signature)


@pytest.mark.parametrize("kept", ["abc", str(2**62), "9" * 30])
def test_a_session_that_no_envelope_holds_is_refused(kept: str, tmp_path: Path) -> None:
    (tmp_path / "robot-2").mkdir()
    (tmp_path / "robot-2" / "session").write_text(kept)
    with pytest.raises(InputError, match="one whole number"):
        next_session(tmp_path, 2, 1e9)
