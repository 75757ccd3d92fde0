"""What radios have to carry: addresses, loads and warnings; and the model of a radio that stand-ins share."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from command_line import flock
from flights import STARTS, flight_config

from llm_flock.errors import InputError
from llm_flock_flight._crazyflie.radios import (
    EXCHANGE_S,
    LAST_IN_BAND,
    MAX_SHARE,
    SETTING_S,
    RadioAddress,
    address_of,
    capacity_hz,
    exchanges_of,
    plan_radios,
    proposed_uris,
    radios_for,
    wifi_over,
)
from llm_flock_flight._flight.preflight import radio_checks, radio_plan
from llm_flock_flight._testing.crtp.radio import MAX_LAG_S, QUEUE_LENGTH, SLOW_POLL_S, ModelledRadio

ROOT = Path(__file__).parents[4]
TRAFFIC = exchanges_of(round_s=3.0)


def drones(uris: list[str]) -> list[tuple[str, str]]:
    return [(f"cf{k}", uri) for k, uri in enumerate(uris)]


def on(n: int, *, radio: int = 0, channel: int = 80, rate: str = "2M", first: int = 1) -> list[str]:
    return [f"radio://{radio}/{channel}/{rate}/E7E7E7E7{first + k:02X}" for k in range(n)]


@pytest.mark.parametrize(
    ("uri", "found"),
    [
        ("radio://0/80/2M/E7E7E7E701", RadioAddress("0", 80, "2M", "E7E7E7E701")),
        ("radio://1/80/250K/e7e7e7e7ab?rate_limit=100", RadioAddress("1", 80, "250K", "E7E7E7E7AB")),
        ("radio://E7C6A5B4D3/0/1M/1", RadioAddress("E7C6A5B4D3", 0, "1M", "0000000001")),
        ("radio://0", RadioAddress("0", 2, "2M", "E7E7E7E7E7")),
        ("radio://0/90", RadioAddress("0", 90, "2M", "E7E7E7E7E7")),
        ("udp://127.0.0.1:19850", None),
        ("usb://0", None),
    ],
)
def test_addresses_are_read_as_cflib_reads_them(uri: str, found: RadioAddress | None) -> None:
    assert address_of(uri) == found


@pytest.mark.parametrize(
    "uri",
    [
        "radio://0/126/2M/E7E7E7E701",
        "radio://0/-1/2M/E7E7E7E701",
        "radio://0/x/2M/E7E7E7E701",
        "radio://0/80/3M/E7E7E7E701",
        "radio://0/80/2M/E7E7E7E7011",
        "radio://0/80/2M/E7E7E7E7XY",
        "radio://0/80/2M/E7E7E7E701/9",
    ],
)
def test_malformed_address_is_a_fault_of_the_plan(uri: str) -> None:
    assert plan_radios([("cf1", uri)], TRAFFIC).faults[0].startswith(f"cf1: {uri}: expected ")


def test_exchange_is_slower_with_changing_settings_or_low_rate() -> None:
    def capacity(*uris: str) -> float:
        return capacity_hz([found for uri in uris if (found := address_of(uri)) is not None])

    assert capacity(*on(1)) == pytest.approx(1 / EXCHANGE_S)
    assert capacity(*on(4)) == pytest.approx(1 / (EXCHANGE_S + SETTING_S))
    assert capacity(*on(2), *on(2, channel=82, first=3)) == pytest.approx(1 / (EXCHANGE_S + 2 * SETTING_S))
    assert capacity(*on(4)) > capacity(*on(4, rate="1M")) > capacity(*on(4, rate="250K"))
    assert 500 < capacity(*on(20)) < 600, "of the size of Bitcraze's own figures"


def test_the_exchanges_of_a_drone() -> None:
    assert pytest.approx(42.4) == TRAFFIC
    assert exchanges_of(round_s=3.0, pose_hz=100.0) == pytest.approx(110.4), "poses outweigh the logs"


def test_twenty_drones_are_too_many_for_one_radio_not_for_four() -> None:
    def loads(n_radios: int) -> Any:
        return plan_radios(drones(proposed_uris(20, n_radios)), TRAFFIC)

    one, four = loads(1), loads(4)
    assert one.loads[0].share > 1.0 and one.loads[0].turn_s == pytest.approx(20 * (EXCHANGE_S + SETTING_S))
    assert [len(load.drones) for load in four.loads] == [5] * 4 and max(load.share for load in four.loads) < 0.5
    assert len(one.warnings) == 1 and "3 radios would carry 20 drones" in one.warnings[0] and not four.warnings
    assert radios_for(20, TRAFFIC) == 3
    assert max(load.share for load in loads(3).loads) <= MAX_SHARE < max(load.share for load in loads(2).loads)


def test_proposed_radios_have_no_fault_and_warn_only_of_load() -> None:
    for n_radios in range(1, 6):
        uris = proposed_uris(n_radios * 3, n_radios)
        found = plan_radios(drones(uris), TRAFFIC)
        assert not found.faults and not found.warnings and len(set(uris)) == len(uris)
    for wrong in ((0, 1), (256, 1), (3, 0), (3, 99)):
        with pytest.raises(ValueError, match="1 to "):
            proposed_uris(*wrong)


@pytest.mark.parametrize(
    ("uris", "says"),
    [
        ([*on(1), *on(1, channel=82, first=2)], "serves channels 80, 82"),
        ([*on(1), *on(1, radio=1, first=2)], "radios 0 and 1 share the air of channels 80 and 80"),
        ([*on(1), *on(1, radio=1, channel=81, first=2)], "radios 0 and 1 share the air of channels 80 and 81"),
        (on(1, channel=12), "channel 12 lies in Wi-Fi channel 1"),
        (on(1, channel=100), "channel 100 is above 2.4835 GHz"),
        (on(20), "radio 0 needs 144%"),
    ],
)
def test_radio_plan_warns_of_bad_channels_and_load(uris: list[str], says: str) -> None:
    found = plan_radios(drones(uris), TRAFFIC)
    assert not found.faults and [says in warning for warning in found.warnings] == [True]


def test_channels_beside_wi_fi() -> None:
    free = [channel for channel in range(LAST_IN_BAND + 1) if wifi_over(channel) is None]
    assert free == [0, 24, 25, 49, 50, *range(74, LAST_IN_BAND + 1)]
    assert (wifi_over(12), wifi_over(37), wifi_over(62)) == (1, 6, 11)


@pytest.mark.parametrize(
    ("one", "two"),
    [
        ("radio://0/80/2M/E7E7E7E701", "radio://0/80/2M/e7e7e7e701"),
        ("radio://0/80/2M/E7E7E7E701", "radio://1/80/2M/E7E7E7E701"),
        ("radio://0/80/2M", "radio://0/80/2M/E7E7E7E7E7"),
    ],
)
def test_two_drones_that_would_answer_at_once_are_refused(one: str, two: str) -> None:
    rows = [
        {"name": f"d{k}", "uri": uri, "start": at} for k, (uri, at) in enumerate(zip((one, two), STARTS, strict=False))
    ]
    rows += [{"name": f"d{k}", "start": STARTS[k]} for k in (2, 3)]
    with pytest.raises(InputError, match="d0 and d1: both have the address") as raised:
        flight_config(drones=rows)
    assert raised.value.field == "drones"
    assert not plan_radios(drones([one, two.replace("/80", "/82")]), TRAFFIC).faults


def test_the_preflight_and_the_dry_run_tell_the_loads() -> None:
    rows = [{"name": f"d{k}", "uri": uri, "start": STARTS[k]} for k, uri in enumerate(on(4))]
    quiet = flight_config(drones=rows, robot="crazyflie")
    assert [str(check) for check in radio_checks(quiet)] == [
        f"radio 0: radio: {radio_plan(quiet).loads[0]}, at most 70%"
    ]
    busy = flight_config(drones=rows, robot="crazyflie", pose_source="udp", pose_rate_hz=120)
    (check,) = radio_checks(busy)
    assert check.passed and check.found.startswith("WARNING: 4 drones on channel 80: ")
    assert radio_checks(flight_config(drones=rows)) == [], "simulated drones are not called"
    fly = ["fly", "--config", str(ROOT / "examples" / "flight.toml"), "--dry-run"]
    table = flock(*fly, "--origin-m", "0,0", cwd=ROOT)
    assert "radios" in table.stdout and "588" in table.stdout and "warning" not in table.stderr
    done = flock(*fly, "--json", cwd=ROOT)
    (load,) = json.loads(done.stdout)["radios"]
    assert load["drones"] == ["cf1", "cf2", "cf3", "cf4"] and load["needed_hz"] < 0.4 * load["capacity_hz"]


# ------------------------------------------------------------------ the model of a radio


def run(radio: ModelledRadio, n: int, seconds: float, up_hz: float, down_hz: float) -> Counter[tuple[int, str]]:
    """Packets that came through, by drone and way, where each drone sends and is sent that number."""
    came = Counter[tuple[int, str]]()
    due = {(k, way): 0.0 for k in range(n) for way in ("up", "down")}
    rates = {"up": up_hz, "down": down_hz}
    for step in range(int(seconds * 500)):
        now = 10.0 + step / 500
        for (k, way), at in due.items():
            if rates[way] and now - 10.0 >= at:
                due[k, way] = at + 1 / rates[way]
                radio.put(k, way, b"x", now)  # type: ignore[arg-type]
        for drone, way, _ in radio.step(now):
            came[drone, way] += 1
    return came


def test_modelled_radio_carries_what_it_can_and_shares_fairly() -> None:
    light = ModelledRadio(0.002)
    came = run(light, 4, 4.0, up_hz=10.0, down_hz=30.0)
    assert light.dropped == 0 and all(came[k, "down"] >= 115 and came[k, "up"] >= 38 for k in range(4))
    heavy = ModelledRadio(0.002)  # 500 exchanges a second for 20 drones with 40 packets each
    came = run(heavy, 20, 4.0, up_hz=10.0, down_hz=40.0)
    counts = [came[k, "down"] for k in range(20)]
    assert heavy.exchanges <= 2001 and heavy.dropped > 0 and max(counts) - min(counts) <= 2
    assert sum(counts) == pytest.approx(2000, rel=0.02)
    assert max(heavy.last_wait_s.values()) > 0.5 > 0.02 > max(light.last_wait_s.values())


def test_a_lost_exchange_is_repeated_and_loses_nothing() -> None:
    radio = ModelledRadio(0.002, loss=0.3, seed=1)
    came = run(radio, 2, 5.0, up_hz=20.0, down_hz=20.0)
    assert radio.dropped == 0 and all(count >= 99 for count in came.values()) and len(came) == 4


def test_a_drone_with_nothing_to_say_is_asked_less_often() -> None:
    radio = ModelledRadio(0.001)
    radio.put(0, "up", b"x", 10.0)
    assert radio.step(10.0021) == [(0, "up", b"x")]
    radio.step(11.0)
    asked = radio.exchanges
    radio.step(11.0 + 100 * SLOW_POLL_S)
    assert radio.exchanges - asked <= 101


def test_packets_beyond_queue_are_dropped_stalls_not_made_up() -> None:
    radio = ModelledRadio(0.01)
    for _ in range(QUEUE_LENGTH + 5):
        radio.put(0, "up", b"x", 10.0)
    assert radio.dropped == 5
    assert len(radio.step(100.0)) <= MAX_LAG_S / 0.01 + 1
