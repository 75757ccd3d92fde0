"""A drone belongs to one flight at a time: a second one is refused before it calls anybody."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from flights import STARTS, STOCK, flight_config, yes

from llm_flock.errors import InputError
from llm_flock_flight._flight.claims import claim_drones, claims_folder
from llm_flock_flight._flight.config import FlightConfig
from llm_flock_flight._flight.fleet import build_fleet
from llm_flock_flight._flight.flight import Flight

OWN = "flights:stock"
RADIOS = [f"radio://0/80/2M/E7E7E7E70{k}" for k in range(4)]
LISTEN = [f"udp://0.0.0.0:1454{k}" for k in range(4)]
OTHERS = [f"udp://0.0.0.0:1464{k}" for k in range(3)]


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


def config_of(uris: list[str], robot: str = OWN, **fields: Any) -> FlightConfig:
    ids = {"system_id": 7} if robot == "mavlink" else {}
    drones = [
        {"name": f"d{k}", "uri": uri, "start": start, **ids}
        for k, (uri, start) in enumerate(zip(uris, STARTS, strict=True))
    ]
    return flight_config(robot=robot, drones=drones, **fields)


def test_second_flight_of_a_drone_is_refused_the_first_goes_on(skipped_waits: None) -> None:
    """Both flight files list one drone, by two radios; the second flight calls no drone."""
    second = config_of([RADIOS[0].replace("//0", "//1"), *(f"radio://1/90/2M/E7E7E7E71{k}" for k in range(3))])
    called: list[str] = []
    refusals: list[str] = []

    async def intrude() -> None:
        robots = build_fleet(second)
        for robot in robots:
            robot.connect = lambda timeout_s, name=robot.name: called.append(name)  # type: ignore[method-assign]
        with pytest.raises(InputError) as refusal:
            await Flight(second, robots).run(yes)
        refusals.append(str(refusal.value))

    async def both() -> None:
        tasks: list[asyncio.Task[None]] = []

        def on_stage(stage: str) -> None:
            if stage == "flying":
                tasks.append(asyncio.get_running_loop().create_task(intrude()))

        config = config_of(RADIOS, **STOCK)
        result = await Flight(config, build_fleet(config), on_stage=on_stage).run(yes)
        assert tasks, [str(check) for check in result.report.checks if not check.passed]
        await asyncio.gather(*tasks)
        assert result.result is not None and result.result.summary.flight is not None
        assert result.result.summary.flight.ended == "mission" and result.result.summary.flight.safe

    asyncio.run(both())
    assert not called
    assert refusals == [
        "drones = 'd0': another flight on this computer flies radio://1/80/2M/E7E7E7E700: let it land first (l in its "
        "terminal), or give this flight other drones"
    ]
    assert not [*claims_folder().iterdir()], "all were given back"
    with claim_drones(second):
        pass


@pytest.mark.parametrize(
    ("robot", "first", "second", "refused"),
    [
        ("crazyflie", RADIOS, RADIOS, True),
        ("crazyflie", RADIOS, [uri.replace("/2M/", "/1M/") for uri in RADIOS], True),
        ("crazyflie", RADIOS, [uri.replace("/80/", "/90/") for uri in RADIOS], False),
        ("crazyflie", RADIOS, [uri.replace("E7E7E7E7", "e7e7e7e7") + "?safelink=0" for uri in RADIOS], True),
        ("crazyflie", [f"udp://127.0.0.1:1{k}" for k in range(4)], [f"udp://localhost:1{k}/" for k in range(4)], True),
        ("crazyflie", [f"udp://127.0.0.1:1{k}" for k in range(4)], [f"tcp://127.0.0.1:1{k}" for k in range(4)], False),
        ("mavlink", LISTEN, ["udpout://LocalHost:14540", *OTHERS], True),
        ("mavlink", LISTEN, ["udpin://[::]:14540", *OTHERS], True),
        (
            "mavlink",
            ["serial:///dev/stdin:57600", *OTHERS[1:], LISTEN[0]],
            ["serial:///proc/self/fd/0", *LISTEN[1:]],
            True,
        ),
        ("simulated", RADIOS, RADIOS, False),
        (
            "mavlink",
            [f"udp://0.0.0.0:1454{k}" for k in range(4)],
            [f"udp://0.0.0.0:1454{k}" for k in range(3, 7)],
            True,
        ),
        (
            "mavlink",
            [f"udp://0.0.0.0:1454{k}" for k in range(4)],
            [f"udp://0.0.0.0:1454{k}" for k in range(4, 8)],
            False,
        ),
    ],
)
def test_which_drones_are_the_same(robot: str, first: list[str], second: list[str], refused: bool) -> None:
    with claim_drones(config_of(first, robot)):
        if refused:
            with (
                pytest.raises(InputError, match="another flight on this computer"),
                claim_drones(config_of(second, robot)),
            ):
                pass
        else:
            with claim_drones(config_of(second, robot)):
                pass
    with claim_drones(config_of(second, robot)):
        pass


def test_a_host_by_its_name_is_the_one_by_its_number(monkeypatch: pytest.MonkeyPatch) -> None:
    def resolve(host: str, *_: object) -> list[Any]:
        if host != "drone1.lan":
            raise socket.gaierror(socket.EAI_NONAME, "unknown host")
        return [(socket.AF_INET, socket.SOCK_DGRAM, 17, "", ("192.0.2.7", 0))]

    monkeypatch.setattr(socket, "getaddrinfo", resolve)
    with claim_drones(config_of(["udpout://Drone1.lan:14550", *OTHERS], "mavlink")):
        same = config_of(["udpout://192.0.2.7:14550", *LISTEN[1:]], "mavlink")
        with pytest.raises(InputError, match=r"another flight on this computer flies udpout://192"), claim_drones(same):
            pass
        with claim_drones(config_of(["udpout://drone2.lan:14550", *LISTEN[1:]], "mavlink")):
            pass


def test_a_claim_ends_with_the_last_process_that_keeps_it() -> None:
    """The flight's process is killed; its deadman still lands the drones, and then they are free."""
    config = config_of(RADIOS)
    code = (
        "import subprocess, sys; from llm_flock_flight._flight.claims import claim_drones; "
        "from llm_flock_flight._flight.config import FlightConfig; "
        "claims = claim_drones(FlightConfig.model_validate_json(sys.stdin.read())); handles = claims.__enter__(); "
        "child = subprocess.Popen(['sleep', '60'], pass_fds=tuple(handles)); print(child.pid, flush=True); child.wait()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(config.model_dump_json(exclude_none=True))
        process.stdin.close()
        deadman = int(process.stdout.readline())
        try:
            with pytest.raises(InputError, match="another flight on this computer flies radio"), claim_drones(config):
                pass
            process.kill()
            process.wait()
            with pytest.raises(InputError, match="another flight on this computer flies radio"), claim_drones(config):
                pass
        finally:
            os.kill(deadman, signal.SIGKILL)
        for _ in range(100):
            try:
                with claim_drones(config):
                    break
            except InputError:
                process.stdout.read()  # until the last one that has it is gone
        else:
            raise AssertionError("never free again")


def test_without_a_folder_there_is_no_claim_but_a_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "file").touch()
    with claim_drones(config_of(RADIOS), tmp_path / "file") as handles:
        assert not handles
    assert "d0: another flight of it would not be noticed" in caplog.text
