"""Starts the processes of a swarm by forking: what they all import is imported once, and shared.

It takes one line of JSON for each process to start, and tells of each start and each end by a line of JSON. It has one
thread and no session. Whoever it started dies with it, and it dies with the launcher.
"""

from __future__ import annotations

import gc
import json
import logging
import os
import select
import signal
import sys
from pathlib import Path
from typing import Any

from llm_flock.errors import FlockError
from llm_flock.runtime.network.config import SwarmConfig
from llm_flock.runtime.network.process import end_with, run
from llm_flock.runtime.network.robot import run_robot
from llm_flock.runtime.network.watch import run_watch
from llm_flock.runtime.network.world import run_world
from llm_flock.runtime.team import Thinkers

REAP_S = 0.05

ANY = {"mission": {"shape": "circle", "n_robots": 1}}
"""Any swarm: with its model come the prompts and the price lists that each robot would read on its own."""


def main() -> None:
    """Serve until the launcher closes the line."""
    end_with(os.getppid())
    children: dict[int, str] = {}
    Thinkers(SwarmConfig.model_validate(ANY))
    gc.freeze()  # a collection in a child would look through all that was imported, and copy every page of it
    _tell(ready=True)
    while True:
        readable, _, _ = select.select([sys.stdin.buffer], [], [], REAP_S)
        if readable:
            line = sys.stdin.buffer.readline()
            if not line:
                break
            order = json.loads(line)
            pid = os.fork()
            if pid == 0:
                os._exit(_child(order))
            children[pid] = order["name"]
            _tell(name=order["name"], pid=pid)
        _reap(children)
    for pid in children:
        os.kill(pid, signal.SIGKILL)


def _reap(children: dict[int, str]) -> None:
    while children:
        pid, status = os.waitpid(-1, os.WNOHANG)
        if not pid:
            return
        _tell(name=children.pop(pid), ended=os.waitstatus_to_exitcode(status))


def _tell(**what: Any) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


def _child(order: dict[str, Any]) -> int:
    """Be the process that was ordered; its exit code."""
    end_with(os.getppid())
    quiet = os.open(os.devnull, os.O_RDWR)
    os.dup2(quiet, 0)
    os.dup2(2, 1)
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    config = SwarmConfig.model_validate(order["config"])
    kind = order["kind"]
    try:
        if kind == "world":
            run(run_world(config, Path(order["ready"]).touch))
        elif kind == "robot":
            run(run_robot(config, order["id"]))
        else:
            run(run_watch(config, Path(order["record"])))
    except FlockError as error:
        sys.stderr.write(f"error: {order['name']}: {error}\n")
        return 2
    except BaseException:
        logging.getLogger(__name__).exception("%s ended", order["name"])
        return 1
    return 0


if __name__ == "__main__":
    main()
