"""Starts the processes of a swarm by forking, so that everything they all import is imported once and shared.

It reads a line of JSON per process to start, and writes one per start and end, and one when it or the world is ready.
It has one thread and no network session. Its children end with it, and it with the launcher.
"""

from __future__ import annotations

import gc
import importlib
import json
import logging
import os
import select
import signal
import sys
from pathlib import Path
from typing import Any

from llm_flock.errors import FlockError
from llm_flock.printable import log_to_stderr, printable
from llm_flock.runtime import TeamPlanners, load_solvers
from llm_flock_swarm._network.config import SwarmConfig
from llm_flock_swarm._network.process import end_with_parent, run
from llm_flock_swarm._network.robot import run_robot
from llm_flock_swarm._network.watch import run_watch
from llm_flock_swarm._network.world import run_world

REAP_S = 0.05  # time between two checks for children that have ended [s]

EXAMPLE = {"mission": {"shape": "circle", "n_robots": 1}}
"""Building its planner loads the prompts that every robot would otherwise read by itself."""


def main() -> None:
    """Serve until the launcher closes standard input; the arguments name more modules to import and share."""
    end_with_parent()
    children: dict[int, str] = {}
    load_solvers()
    for name in sys.argv[1:]:
        importlib.import_module(name)
    TeamPlanners(SwarmConfig.model_validate(EXAMPLE))
    gc.freeze()  # else a collection in a child would touch, and so copy, every shared page
    _write(ready="forkserver")
    while True:
        readable, _, _ = select.select([sys.stdin.buffer], [], [], REAP_S)
        if readable:
            line = sys.stdin.buffer.readline()
            if not line:
                break
            order = json.loads(line)
            pid = _fork(order)
            children[pid] = order["name"]
            _write(name=order["name"], pid=pid)
        _reap(children)
    for pid in children:
        os.kill(pid, signal.SIGKILL)


def _reap(children: dict[int, str]) -> None:
    while children:
        pid, status = os.waitpid(-1, os.WNOHANG)
        if not pid:
            return
        _write(name=children.pop(pid), ended=os.waitstatus_to_exitcode(status))


def _write(**event: Any) -> None:
    sys.stdout.write(json.dumps(event) + "\n")
    sys.stdout.flush()


def _fork(order: dict[str, Any]) -> int:
    """Start a process; returns its id once it is sure to end with this one."""
    parent = os.getpid()
    bound, binding = os.pipe()
    pid = os.fork()
    if pid == 0:
        end_with_parent(parent)
        os.close(bound)
        os.close(binding)
        os._exit(_child(order))
    os.close(binding)
    os.read(bound, 1)  # nothing comes: the child closes its end
    os.close(bound)
    return pid


def _child(order: dict[str, Any]) -> int:
    """Do the work of the ordered process; returns its exit code."""
    null, answers = os.open(os.devnull, os.O_RDWR), os.dup(1)
    os.dup2(null, 0)
    os.dup2(2, 1)
    log_to_stderr()
    config = SwarmConfig.build(order["config"], base_url=order["base_url"])
    kind = order["kind"]
    try:
        if kind == "world":
            run(run_world(config, lambda: os.write(answers, b'{"ready": "world"}\n')))
        elif kind == "robot":
            run(run_robot(config, order["id"]))
        else:
            run(run_watch(config, Path(order["record"]), told=Path(order["told"])))
    except FlockError as error:
        sys.stderr.write(printable(f"error: {order['name']}: {error}\n"))
        return 2
    except BaseException:
        logging.getLogger(__name__).exception("%s ended", order["name"])
        return 1
    return 0


if __name__ == "__main__":
    main()
